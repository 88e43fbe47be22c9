"""Goals over a hill that vehicles and planner know: copters lead over it or around it, follow it, come home, and what
would be too low is refused with the height that is needed.
"""

from __future__ import annotations

import array
import math
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from agents.planner.live.field import FleetField, check_field
from agents.planner.live.settings import PlannerSettings
from agents.planner.model.ground import GroundMap
from tests.agents.planner.execute.fleet import NEAR, ORIGIN, Watch
from tests.agents.planner.live.led import Field, led
from tests.waiting import until
from zmav import geo
from zmav.config import Failsafe, Geofence
from zmav.errors import BadInput
from zmav.terrain import Piece, Terrain, corner_of, names_within, pack
from zmav.wire import swarm

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.timeout(400)]
LEAST, SIDE = 10.0, 121
NAMES = ["quad1", "quad2", "quad3"]
STARTS = [(0.0, 0.0), (0.0, 9.0), (0.0, 18.0)]
HIGH, WIDE, TOP = 24.0, 25.0, (45.0, 9.0)
"""m of the hill, and its place"""
BEHIND = 90.0
"""m north: behind it"""
LONG_S = 180.0
HEARD_LATE = 0.3
"""m by which a copter may truly be below where it should be"""


def hill(north: float, east: float) -> float:
    """m above the origin."""
    return HIGH * math.exp(-((north - TOP[0]) ** 2 + (east - TOP[1]) ** 2) / WIDE**2)


def pieces() -> dict[str, Piece]:
    found = {}
    (south, west), (north, east) = (geo.to_global(ORIGIN, (s, s, 0.0))[:2] for s in (-1200.0, 1200.0))
    for name in names_within(south, west, north, east):
        row, column = corner_of(name)
        heights = array.array("h")
        for r in range(SIDE):
            for c in range(SIDE):
                place = (row + 1 - r / (SIDE - 1)) / 60, (column + c / (SIDE - 1)) / 60
                up = hill(*geo.to_ned(ORIGIN, *place, 0.0)[:2])
                heights.append(round(ORIGIN.alt_amsl + up))
        found[name] = Piece(SIDE, heights)
    return found


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Field]:
    cache, ground = tmp_path_factory.mktemp("ground"), pieces()
    for name in NAMES:
        terrain = Terrain(Path(cache) / "demo" / f"{name}.terrain")
        for piece, heights in ground.items():
            terrain.put(piece, pack(heights))
    fence = Geofence(above_ground=LEAST)
    failsafe = Failsafe(land_after=4.0, action="land", returns="together")
    known = GroundMap(ground, ORIGIN)
    settings = PlannerSettings(name="ground", patience=1.0, field=FleetField(fence, {}, ORIGIN), ground=known)
    async with led(STARTS, 14.0, settings, cache=str(cache), geofence=fence, failsafe=failsafe, body=NEAR) as field:
        yield field


def up(field: Field, north: float, east: float) -> float:
    """m of the ground above the origin, as the tiles have it."""
    ground = field.agent.context.settings.ground
    assert ground is not None
    height = ground.height(*geo.to_global(ORIGIN, (north, east, 0.0))[:2])
    assert height is not None
    return height - ORIGIN.alt_amsl


def least(field: Field, watch: Watch) -> float:
    """m above the ground, of all of them at any time."""
    return min(-down - up(field, north, east) for _, places in watch.rows for north, east, down in places.values())


def refused(field: Field) -> list[str]:
    return [event.text for event in field.agent.context.events if event.severity in ("warning", "error")]


async def ended(field: Field, name: str) -> None:
    """Once the goal is done."""
    goals = field.agent.context.ledger

    def found() -> bool:
        (entry,) = [each for each in goals.goals if each.id == name]
        assert entry.state not in ("failed", "cancelled"), entry
        return entry.state == "done"

    await until(found, name, LONG_S)


async def fly(field: Field, goal: swarm.Goal) -> Watch:
    async with field.fleet.watch() as watch:
        name = await field.submit(goal)
        await ended(field, name)
    return watch


async def test_a_search_follows_the_ground(field: Field) -> None:
    area = [(5.0, 0.0), (45.0, 0.0), (45.0, 20.0), (5.0, 20.0)]
    height = 16.0
    goal = swarm.Search(vehicles=NAMES[:2], polygon=area, height=height, above_ground=True)
    preview = await (await field.planner()).order("preview", swarm.Preview(goal=goal))
    (lanes,) = [step for step in preview["steps"] if "figures" in step]
    assert lanes["above_ground"] > height - 1.5, "SRTM's heights are whole metres"
    downs = [-row[3] for track in lanes["tracks"].values() for row in track]
    assert max(downs) - min(downs) > HIGH / 3.0, "it goes up and down with the hill"
    async with field.fleet.watch() as watch:
        name = await field.submit(goal)
        await ended(field, name)
    assert not [text for text in refused(field) if "not as prepared" in text]
    assert least(field, watch) > LEAST - HEARD_LATE
    with pytest.raises(BadInput, match="10 m are asked for"):
        low = swarm.Search(vehicles=NAMES[:1], polygon=area, height=8.0, above_ground=True)
        await (await field.planner()).order("preview", swarm.Preview(goal=low))


async def test_what_would_be_too_low_is_refused_with_the_height_that_is_needed(field: Field) -> None:
    planner = await field.planner()
    top = up(field, *TOP)
    low = swarm.GoTo(vehicles=NAMES[:1], to=[(*TOP, -top - 6.0)])
    with pytest.raises(
        BadInput, match=r"goal.to\[0\]: [5-7]\.\d m above the ground, where 10 m are asked for"
    ) as caught:
        await planner.order("submit", swarm.Submit(goal=low))
    needed = float(caught.value.message.rpartition("must be ")[2].split()[0])
    assert top + LEAST < needed < top + LEAST + 5.0
    with pytest.raises(BadInput, match="under the ground"):
        await planner.order("submit", swarm.Submit(goal=swarm.GoTo(vehicles=NAMES[:1], to=[(*TOP, -14.0)])))
    far = swarm.GoTo(vehicles=NAMES[:1], to=[(1000.0, 5000.0, -40.0)])
    wide = FleetField(Geofence(above_ground=LEAST, radius=9000.0), {}, ORIGIN)
    context = field.agent.context
    with pytest.raises(BadInput, match="not known here"):
        check_field(far, context.fleet.view(), wide, context.settings.ground, 1.5, lambda name: None)
    watch = await fly(field, swarm.GoTo(vehicles=NAMES[:1], to=[(*TOP, -needed)]))
    assert least(field, watch) > LEAST - HEARD_LATE


async def test_three_copters_come_across_the_hill_and_home_over_it_when_their_planner_is_gone(field: Field) -> None:
    """The last one here: its planner says nothing more."""
    across = swarm.GoTo(vehicles=NAMES, to=[(BEHIND, east, -16.0) for _, east in STARTS])
    preview = await (await field.planner()).order("preview", swarm.Preview(goal=across))
    assert LEAST <= preview["above_ground"] < 15.0
    watch = await fly(field, across)
    assert least(field, watch) > LEAST - HEARD_LATE
    assert watch.least(1.5) > 2.0
    states = [field.me.vehicle(name).last_state for name in NAMES]
    assert not any(state and state.setpoints.get("ground") for state in states), "no vehicle refused any of it"

    def stored() -> bool:
        states = [field.me.vehicle(name).last_state for name in NAMES]
        return all(state and state.segment and state.segment.home is not None for state in states)

    async with field.fleet.watch() as watch:
        aside = swarm.Formation(vehicles=NAMES, shape="line", at=(BEHIND, 17.0, -16.0), spacing=9.0)
        name = await field.submit(aside)
        await field.until(name, lambda entry: entry.state == "flying")
        await until(stored, "ways home are kept", LONG_S)
        field.agent.context.z.session.close()  # nothing is sent any more
        await until(lambda: all(-down < 0.5 for _, _, down in watch.rows[-1][1].values()), "on the ground", LONG_S)
    in_the_air = Watch(field.fleet)
    column = 3.0
    in_the_air.rows = [
        (t, {n: p for n, p in places.items() if min(math.dist(p[:2], s) for s in STARTS) > column})
        for t, places in watch.rows
    ]
    assert least(field, in_the_air) > LEAST - HEARD_LATE
    assert watch.least(1.5) > 2.0
    for name, start in zip(NAMES, STARTS, strict=True):
        assert math.dist(field.fleet.places()[name][:2], start) < 2.0
