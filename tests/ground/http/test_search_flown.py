"""A search that is drawn on the page, planned by the planner and flown by three simulated copters and their agents."""

from __future__ import annotations

import asyncio
import contextlib
from collections import defaultdict

import pytest
from shapely import MultiPoint, Point, Polygon

import zmav
from tests.ground.http.browser import CHROMIUM
from tests.ground.http.flown_page import flown, flown_from_the_page, search

NO_FLY = ((0.47, 0.23), (0.54, 0.23), (0.54, 0.29), (0.47, 0.29))
AREA = ((0.36, 0.12), (0.72, 0.12), (0.68, 0.38), (0.32, 0.38))
CORNERS = "drawing.shapes.all.find((each) => each.kind === '{}').points.map((each) => [each.lat, each.lon])"


@pytest.mark.slow
@pytest.mark.timeout(400)
async def test_what_is_drawn_is_searched_and_what_is_closed_is_not_entered() -> None:
    if not CHROMIUM:
        pytest.skip("no Chromium is installed (Debian: chromium)")
    places = defaultdict[str, list[Point]](list)

    async def follow(z: zmav.Client) -> None:
        while await z.news(30.0):
            for vehicle in z.fleet():
                if vehicle.last_state is not None and (at := vehicle.last_state.position) is not None:
                    places[vehicle.name].append(Point(at.lat_deg, at.lon_deg))

    async with flown_from_the_page("line") as page, zmav.open(fleet="demo", connect=[page.router]) as z:
        following = asyncio.create_task(follow(z))
        await search(page, NO_FLY, AREA)
        area, closed = [Polygon(await page.tab.run(CORNERS.format(kind))) for kind in ("search", "no_fly")]
        await page.until("document.querySelector('#goals progress')?.value > 0.02", 120.0)
        await flown(page)
        following.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await following
        assert "failed" not in await page.tab.text("#goals")
    assert sorted(places) == ["quad1", "quad2", "quad3"]
    searched = MultiPoint([each for name in places for each in places[name] if area.contains(each)])
    assert all(any(area.contains(each) for each in places[name]) for name in places)
    assert not any(closed.contains(each) for name in places for each in places[name])
    low, high = searched.bounds[:2], searched.bounds[2:]
    for axis in (0, 1):  # they flew over nearly all of its extent
        extent = area.bounds[axis + 2] - area.bounds[axis]
        assert high[axis] - low[axis] > 0.6 * extent
