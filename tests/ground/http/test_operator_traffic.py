"""Aircraft that are not of the fleet, on the operator's page: on the map, in the list, with who is nearest."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from tests.ground.http.browser import Fleet, Tab
from tests.ground.http.test_operator import at, opened
from zmav import keys, wire
from zmav.traffic import FORGET_S

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served


@pytest.mark.asyncio(loop_scope="module")
async def test_an_aircraft_is_on_the_map_and_in_the_list_until_it_is_gone(
    tab: Tab, served: Served, fleet: Fleet
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    hostile = "<I>&X"
    told = asyncio.create_task(_tell(served, hostile))
    await tab.until("document.querySelectorAll('#aircraft li').length === 2")
    words = await tab.run("document.querySelector('#aircraft li').textContent")
    assert words.startswith("DEABC 1.0 km from quad1, ")
    assert "+250 m" in words
    assert "by gs" in words
    assert await tab.run("document.querySelectorAll('.aircraft svg').length") == 2
    turned = await tab.run("document.querySelector('.aircraft svg').style.transform")
    assert turned.startswith("rotate(1.57")
    assert hostile in await tab.run("document.getElementById('aircraft').textContent")
    assert await tab.run("document.querySelectorAll('#aircraft i').length") == 0
    told.cancel()
    _put(served, hostile, FORGET_S - 1.0)  # as if nothing had come of them for so long
    await tab.until("document.getElementById('traffic').hidden && !document.querySelector('.aircraft')")


async def _tell(served: Served, hostile: str) -> None:
    while True:
        _put(served, hostile, 0.0)
        await asyncio.sleep(0.5)


def _put(served: Served, hostile: str, age: float) -> None:
    near = wire.Aircraft(
        icao="3c4b12",
        callsign="DEABC",
        lat_deg=-35.3 + 1000 / 110940,
        lon_deg=149.1,
        age=age,
        alt=850.0,
        alt_from="geometric",
        velocity=(0.0, 1.0, 0.0),
    )
    other = wire.Aircraft(icao="3c4b13", callsign=hostile, lat_deg=-35.2, lon_deg=149.1, age=age)
    report = wire.Traffic(t=time.time(), source="gs", instance=1, serves="x", aircraft=[near, other])
    served.session.put(keys.TRAFFIC.key("demo"), wire.encode(report))
