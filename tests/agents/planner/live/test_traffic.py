"""The planner and aircraft that are not of the fleet: as obstacles that grow with age, and flown among."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

import zmav
from agents.planner.cli.asking import books, find
from agents.planner.goals.steps import FleetView, PlanTo, VehicleView
from agents.planner.live.fleet import Hearing
from agents.planner.live.plan import LATER, SOON, Margins, Planned, Planner
from agents.planner.live.settings import PlannerSettings
from agents.planner.live.traffic import MOST, RENEWED, TrafficWatch
from agents.planner.live.world import Passing, World
from agents.planner.model.errors import PlanError
from ground.traffic.feeds import Feed
from ground.traffic.program import TrafficProgram, TrafficSettings
from tests.agents.planner.execute.fleet import ORIGIN
from tests.agents.planner.live.led import led
from tests.sbs import MadeUp, SbsSource
from tests.waiting import until
from zmav import geo, wire
from zmav.config import body_of
from zmav.errors import BadInput
from zmav.waiting import within
from zmav.wire import swarm

PATIENCE_S = 90.0
RADIUS = 15.0
PLACE = wire.GlobalPosition(lat_deg=ORIGIN.lat_deg, lon_deg=ORIGIN.lon_deg, alt_amsl=ORIGIN.alt_amsl + 10, alt_rel=10.0)


def state() -> wire.VehicleState:
    """Of a vehicle 10 m above the fleet's origin."""
    return wire.VehicleState(t=0.0, fleet="demo", name="quad1", instance="i", position=PLACE, local=(0.0, 0.0, -10.0))


def told(*aircraft: wire.Aircraft) -> bytes:
    return wire.encode(
        wire.Traffic(t=time.time(), source="gs", instance=1, serves="x", qnh=1013.25, aircraft=list(aircraft))
    )


def craft(icao: int, north: float, **more: object) -> wire.Aircraft:
    lat, lon, alt = geo.to_global(ORIGIN, (north, 0.0, -50.0))
    known = {"alt": alt, "age": 0.0, "alt_from": "geometric", "velocity": (40.0, 30.0, 0.0), **more}
    return wire.Aircraft(icao=f"{icao:06x}", lat_deg=lat, lon_deg=lon, **known)  # type: ignore[arg-type]


def test_an_aircraft_is_a_ball_that_moves_and_grows_with_its_age() -> None:
    watch, world = TrafficWatch(100.0), World()
    watch.hear(told(craft(1, 1000.0)))
    now = time.monotonic()
    young, old = (watch.obstacles([state()], now + age, 100.0)[0].obstacle.what for age in (0.0, 10.0))
    assert isinstance(young, swarm.Ball)
    assert isinstance(old, swarm.Ball)
    assert young.center == pytest.approx((1000.0, 0.0, -50.0), abs=10.0)
    assert old.center == pytest.approx((1400.0, 300.0, -50.0), abs=10.0)
    assert young.radius == pytest.approx(160.0, abs=2.0), "its height may be off by 60 m"
    assert old.radius == pytest.approx(100.0 + 0.4 * 50.0 * 10.0, abs=2.0)
    world.traffic = watch.obstacles([state()], now, 100.0)
    (mover,) = world.pieces(102.0).movers
    assert mover.motion[0][1:].tolist() == pytest.approx([60.0, 1080.0, 50.0], abs=20.0)
    assert (world.obstacles, world.revision) == ([], 0), "a standby need not be told of it"
    assert watch.obstacles([state()], now + 60.0, 100.0) == []


def test_a_plan_keeps_clear_of_what_an_aircraft_grows_to_until_it_is_heard_again() -> None:
    """Else it would be stopped within a second, and made again, and again."""
    watch, world = TrafficWatch(100.0), World()
    watch.hear(told(craft(1, 1000.0)))
    now = time.monotonic()

    def radii(lasting: bool) -> list[float]:
        return [mover.radius for mover in world.pieces(100.0, lasting).movers]

    world.traffic = watch.obstacles([state()], now, 100.0)
    assert radii(True) == radii(False), "its height is off by more"
    world.traffic = watch.obstacles([state()], now + 3.0, 100.0)
    planned, flown = radii(True), radii(False)
    world.traffic = watch.obstacles([state()], now + 3.0 + RENEWED, 100.0)
    assert radii(False) == pytest.approx(planned, abs=0.01)
    assert planned[0] == pytest.approx(flown[0] + 20.0 * RENEWED, abs=1.0), "two fifths of its speed"


class Stubborn(Planner):
    """Has no plan while the aircraft is there, and takes longer to find that out each time."""

    def __init__(self, world: World, *takes: float) -> None:
        context = SimpleNamespace(
            world=world,
            settings=PlannerSettings(),
            kin=lambda goal: set(),
            airspace=SimpleNamespace(others=lambda kin: []),
            fleet=SimpleNamespace(hearing=lambda: Hearing(frozenset(), frozenset())),
        )
        super().__init__(context, "g1-1", SimpleNamespace())  # type: ignore[arg-type]
        self.takes, self.tried = list(takes), list[float]()

    async def next_to(self, step: PlanTo, view: FleetView, margins: Margins = ()) -> Planned:
        self.tried.append(time.monotonic())
        await asyncio.sleep(self.takes.pop(0))
        raise PlanError("unreachable", ["quad1"], "no way")


async def test_while_one_passes_no_plan_is_asked_for_all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each time took all of a processor, which other goals' plans wait for."""
    world, now, said, near = World(), 0.0, list[str](), []
    for each in (craft(1, 1000.0), craft(2, 200.0, velocity=(-20.0, 0.0, 0.0))):
        watch = TrafficWatch(100.0)
        watch.hear(told(each))
        near.append(watch.obstacles([state()], time.monotonic(), time.time()))
    world.traffic = near[0]

    async def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(time, "monotonic", lambda: now)
    monkeypatch.setattr(asyncio, "sleep", sleep)
    planner, asked = Stubborn(world, 0.1, 15.0, 2.0, 40.0), list[float]()

    async def margins() -> Margins:
        asked.append(now)
        return [(0.5, 1.0)]

    fleet = FleetView({"quad1": VehicleView("quad1", "copter", body_of("copter"), (0.0, 0.0, -50.0))})
    with pytest.raises(PlanError, match="no way"):
        await planner.patiently(PlanTo(("quad1",), np.zeros((1, 3))), fleet, margins, said.append)
    assert planner.tried == pytest.approx([0.0, 0.1 + SOON, 16.1 + LATER, 23.1 + 2.0])
    assert said == ["waits for room beside traffic 000001: no way"] * 3
    waited = [each for each in asked if 16.1 <= each <= 16.1 + LATER]
    assert waited == pytest.approx([16.1 + SOON * k for k in range(6)]), "who wants it to end is heard meanwhile"
    # Nor at all while one is about to pass over who rests, and nobody has time to fly out of its way.
    begun, said, planner.takes, planner.tried = now, list[str](), [0.1], []

    def passes(text: str) -> None:
        said.append(text)
        if len(said) == 3:
            world.traffic = []

    world.traffic = near[1]
    with pytest.raises(PlanError, match="no way"):
        await planner.patiently(PlanTo(("quad1",), np.zeros((1, 3))), fleet, margins, passes)
    assert said == ["waits for room beside traffic 000002: it is about to pass"] * 3
    assert planner.tried == pytest.approx([begun + 3.0 * SOON])


@pytest.mark.parametrize(
    ("aside", "away", "speed", "in_vain"),
    [
        (155.0, 600.0, 40.0, False),
        (100.0, 600.0, 40.0, False),
        (0.0, 600.0, 40.0, True),
        (155.0, 0.0, 40.0, True),
        (155.0, -600.0, 40.0, False),
        (0.0, 180.0, 3.0, False),  # slower than the copter
    ],
)
async def test_a_plan_is_tried_where_there_is_time_to_get_out_of_an_aircraft_s_way(
    aside: float, away: float, speed: float, in_vain: bool
) -> None:
    """One is ``away`` m from passing the copter at ``aside`` m: a ball of 160 m, the copter does 5 m/s."""
    world = World()
    ball = swarm.Ball(center=(away, aside, -50.0), radius=160.0, velocity=(-speed, 0.0, 0.0))
    world.traffic = [Passing(swarm.Obstacle(name="traffic 1", t=time.time(), what=ball), 0.0)]
    planner = Stubborn(world, 0.0)

    class Ended(Exception):
        pass

    def say(text: str) -> None:
        raise Ended(text)

    async def margins() -> Margins:
        return [(0.5, 1.0)]

    fleet = FleetView({"quad1": VehicleView("quad1", "copter", body_of("copter"), (0.0, 0.0, -50.0))})
    with pytest.raises(Ended, match="it is about to pass" if in_vain else "no way"):
        await planner.patiently(PlanTo(("quad1",), np.zeros((1, 3))), fleet, margins, say)


def test_what_is_far_or_stands_is_no_obstacle_and_the_nearest_are_few() -> None:
    watch = TrafficWatch(100.0)
    far, rolls = craft(1, 20_000.0), craft(2, 500.0, ground=True)
    watch.hear(told(far, rolls, *(craft(3 + i, 1000.0 + i) for i in range(25, 0, -1))))
    found = watch.obstacles([state()], time.monotonic(), 0.0)
    assert [each.obstacle.name for each in found] == [f"traffic {4 + i:06x}" for i in range(MOST)]
    assert watch.obstacles([], time.monotonic(), 0.0) == []


def test_a_height_that_is_not_known_is_the_vehicles_own() -> None:
    watch = TrafficWatch(100.0)
    watch.hear(told(craft(1, 500.0, alt=None, velocity=None)))
    (found,) = watch.obstacles([state()], time.monotonic(), 0.0)
    assert isinstance(found.obstacle.what, swarm.Ball)
    assert found.obstacle.what.center[2] == pytest.approx(-10.0)


def test_none_are_kept_clear_of_where_the_settings_say_so() -> None:
    watch = TrafficWatch(0.0)
    watch.hear(told(craft(1, 500.0)))
    assert watch.obstacles([state()], time.monotonic(), 0.0) == []
    with pytest.raises(BadInput):
        watch.hear(b"{")


async def _ended(z: zmav.Client, name: str) -> swarm.GoalEntry:
    async for book in books(z, PATIENCE_S):
        for entry in book.goals if book else []:
            if entry.id == name and entry.state in ("done", "failed", "cancelled"):
                return entry
    raise AssertionError("no book")


async def test_a_plan_in_flight_that_meets_one_stops_and_is_made_again() -> None:
    """From a feed by its socket to the copter: nothing else knows of the aircraft."""
    far = MadeUp(0x3C4B00, "FAR", (5000.0, 0.0, -900.0), (50.0, 0.0, 0.0))
    async with contextlib.AsyncExitStack() as stack:
        settings = PlannerSettings(name="ground", patience=1.0, traffic=RADIUS)
        field = await stack.enter_async_context(led([(0.0, 0.0)], 12.0, settings))
        fleet, agent, me = field.fleet, field.agent, field.me
        ground = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        source = await stack.enter_async_context(SbsSource(ORIGIN, [far]))
        feeds = TrafficSettings(feeds=(Feed("sbs", "127.0.0.1", source.port),), name="ground", qnh=1013.25)
        await stack.enter_async_context(TrafficProgram(ground, feeds, lambda said: None))
        await until(lambda: bool(agent.context.world.traffic), "the aircraft that is far", PATIENCE_S)
        planner = await find(me)
        north, east, down = fleet.places()["quad1"]
        goal = swarm.GoTo(vehicles=["quad1"], to=[(north + 130.0, east, down)])
        name = str((await planner.order("submit", swarm.Submit(goal=goal, when="now")))["goal"])

        def flies() -> bool:
            return fleet.places()["quad1"][0] - north > 15.0

        await until(flies, "the copter on its way", PATIENCE_S)
        # It comes from the west, and crosses the way some 95 m ahead, about when the copter would be there: where that
        # comes to rest it is not in its way, for which there would be no plan before it has passed.
        v, crosses = (0.0, 40.0, 0.0), time.monotonic() - source.began + 19.0
        crossing = MadeUp(0x3C4B12, "CROSS", (north + 110.0, east - v[1] * crosses, down), v)
        source.aircraft.append(crossing)
        nearest = math.inf

        async def watch() -> None:
            nonlocal nearest
            while True:
                place, _ = crossing.at(time.monotonic() - source.began)
                nearest = min(nearest, math.dist(place, fleet.places()["quad1"]))
                await asyncio.sleep(0.05)

        watching = asyncio.create_task(watch())
        ended = await within(PATIENCE_S, _ended(me, name))
        watching.cancel()
        said = [event.text for event in agent.context.events]
        assert ended.state == "done", (ended, said)
        assert any("traffic CROSS is about to cross the way of quad1" in text for text in said), said
        assert any("planned again" in text for text in said), said
        assert nearest > RADIUS, said
