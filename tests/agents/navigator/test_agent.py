"""The navigator among simulated copters: it flies, gives up, and says how it went."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import time
from collections.abc import AsyncIterator, Callable
from typing import Any, ClassVar

import pytest
import pytest_asyncio

import zmav
from agents.navigator.agent import OVERLAP, Course, Navigator
from agents.navigator.outlets import TAKEN, TRIES
from agents.navigator.trajectory import WINDOW
from tests.agents.navigator.behind import Behind
from tests.agents.planner.execute.fleet import BadClient, Fleet, airborne
from tests.waiting import until
from zmav import keys, wire
from zmav.config import Failsafe, Geofence
from zmav.errors import BadInput, Refused
from zmav.flying import FlightSettings
from zmav.trust.gate import Origin
from zmav.verbs import Access, Verb

PATIENCE_S = 60.0
pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.slow]


class Follow(wire.Order, kw_only=True):
    segment: list[wire.SegmentPoint]


class Controller(zmav.Agent):
    """One that follows segments, and has the autopilot fly them."""

    name = "ev1"
    verbs: ClassVar = {"follow": Verb("follow", Follow, Access.MOVE, "fly a segment")}

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.lease: zmav.Lease | None = None
        self.segments: list[list[wire.SegmentPoint]] = []

    async def on_follow(self, args: Follow, report: Any, origin: Origin | None) -> dict[str, Any]:
        if self.lease is None:
            raise Refused("it is not engaged")
        self.segments.append(args.segment)
        self.lease.segment(args.segment)
        return {}


class StalledClient(BadClient):
    """While ``held`` is a list, what is put of setpoints waits in it."""

    held: list[Callable[[], None]] | None = None
    breaks = False
    """nothing goes through any more once one waits"""

    async def __aenter__(self) -> StalledClient:
        await super().__aenter__()
        return self

    def put(self, channel: keys.Channel, *what: Any, **more: Any) -> None:
        put = functools.partial(super().put, channel, *what, **more)
        if self.held is None or channel is not keys.SETPOINT:
            put()
        else:
            self.held.append(put)
            self.cut = self.breaks

    def let_go(self, *, through: bool = False) -> None:
        """``through``: what waits, and nothing else, goes through a cut."""
        held, self.held = self.held, None
        cut, self.cut = self.cut, self.cut and not through
        for put in held or []:
            put()
        self.cut = cut


class Distant(Navigator):
    """One at the other end of a bad network."""

    name = "distant"


class Field:
    """A copter in the air with a navigator, and a client as people have it."""

    def __init__(self, fleet: Fleet, navigator: Navigator, controller: Controller, me: zmav.Vehicle) -> None:
        self.fleet, self.navigator, self.controller, self.me = fleet, navigator, controller, me
        self.words: list[wire.AgentStatus] = []

    async def fly(self, **arguments: Any) -> dict[str, Any]:
        """About a place at 5 m above the origin, wherever the copter is."""
        place = {"north": 0.0, "east": 0.0, "down": -5.0}
        return await self.me.tell("navigator", "fly", **{**place, **arguments})

    async def fly_from_here(self, side: float, **arguments: Any) -> dict[str, Any]:
        """A square whose first corner is where the copter is: there is no way to it."""
        north, east, down = self.me.local
        middle = {"north": north + 0.5 * side, "east": east + 0.5 * side, "down": down}
        return await self.fly(route="square", side=side, **middle, **arguments)

    @contextlib.asynccontextmanager
    async def distant(self) -> AsyncIterator[tuple[StalledClient, Distant]]:
        settings, tuned = FlightSettings(lease_s=20.0), {"settle": 0.0}
        async with StalledClient(self.fleet.endpoint, 0.0, (0.0, 0.0)) as z, contextlib.AsyncExitStack() as stack:
            distant = Distant(z, "quad1", settings, tuned)
            await stack.enter_async_context(distant)
            running = asyncio.create_task(distant.run())
            try:
                yield z, distant
            finally:
                running.cancel()
                await asyncio.gather(running, return_exceptions=True)

    async def circle(self) -> dict[str, Any]:
        return await self.me.tell("distant", "fly", route="circle", radius=8.0, north=0.0, east=0.0, down=-5.0)

    async def circling(self, distant: Distant, seconds: float) -> Course:
        """Until so many seconds after it has set off."""
        await self.circle()
        course = distant.course
        assert course is not None
        await until(lambda: time.time() > course.start + seconds, "", PATIENCE_S)
        return course

    async def rests(self, also: Callable[[wire.VehicleState], bool]) -> None:
        await self.me.wait_until(
            lambda s: also(s) and s.velocity is not None and math.hypot(*s.velocity) < 0.1, PATIENCE_S
        )

    async def until(self, true: Callable[[], bool], what: str) -> None:
        await until(true, lambda: f"{what}; {self.words[-1:]}", PATIENCE_S)

    async def ended(self, words: str) -> str:
        """How the flight did, in its own words, among which these are."""
        flight = self.navigator.flight
        assert flight is not None
        await asyncio.wait({flight}, timeout=PATIENCE_S)
        assert flight.done(), self.words[-1:]
        await self.until(lambda: self.words[-1].state == "idle" and words in self.words[-1].text, words)
        return self.words[-1].text

    async def hear(self) -> None:
        def convert(sample: Any) -> wire.AgentStatus:
            return wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "status")

        key = keys.AGENT_STATUS.key("demo", "quad1", agent="navigator")
        async with self.fleet.z.subscribe(key, convert) as heard:
            async for word in heard:
                self.words.append(word)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field() -> AsyncIterator[Field]:
    async with contextlib.AsyncExitStack() as stack:
        patient, fence = Failsafe(land_after="never"), Geofence(radius=60.0)
        fleet = await stack.enter_async_context(airborne([(0.0, 0.0)], 5.0, failsafe=patient, geofence=fence))
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        me = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        navigator = Navigator(z, "quad1", None, {"settle": 0.5, "accel": 2.0, "jerk": 6.0})
        controller = Controller(z, "quad1")
        for agent in (navigator, controller):
            await stack.enter_async_context(agent)
        (vehicle,) = await me.wait_for("quad1", timeout=PATIENCE_S)
        field = Field(fleet, navigator, controller, vehicle)
        running = [asyncio.create_task(each) for each in (navigator.run(), field.hear())]
        yield field
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"route": "octagon"}, "route"),
        ({"route": "circle", "side": 3.0}, "side"),
        ({"speed": 0.0}, "speed"),
        ({"speed": "fast"}, "speed"),
        ({"north": 1e9}, "north"),
        ({"sped": 1.0}, "sped"),
    ],
)
async def test_an_order_that_cannot_be_is_refused_by_its_field(
    field: Field, arguments: dict[str, Any], named: str
) -> None:
    with pytest.raises(BadInput) as refused:
        await field.fly(**arguments)
    assert refused.value.detail["field"] == named


async def test_who_flies_nothing_has_nothing_to_abort(field: Field) -> None:
    with pytest.raises(Refused, match="flies nothing"):
        await field.me.tell("navigator", "abort")


async def test_it_flies_to_the_end_and_says_how_well_it_followed(field: Field) -> None:
    navigator = field.navigator
    async with Behind(field.fleet.world) as behind:
        told = await field.fly(route="square", side=3.0, heading=0.5, speed=1.0)
        assert told["length"] == 12.0
        with pytest.raises(Refused, match="flies square already"):
            await field.fly(route="circle")
        await field.ended("flew square: 12.0 m")
    found = navigator.last
    assert found is not None
    assert found.samples > 200 - 20 * behind.whole
    assert found.rms < 0.3 + 1.0 * behind.most  # there is no wind
    assert found.peaks[0].error <= found.peak
    assert field.words[-1].detail["summary"]["length"] == 12.0
    state = await field.me.wait_until(lambda s: s.lease is None, PATIENCE_S)
    assert state.lease_end is not None
    assert state.lease_end.reason == "released"
    phases = [word.state for word in field.words]
    assert phases.index("approach") < phases.index("fly")


async def test_what_is_aborted_comes_to_rest_on_its_way_and_is_given_back(field: Field) -> None:
    navigator = field.navigator
    await field.fly_from_here(4.0, speed=1.5)
    await field.until(lambda: navigator.course is not None and navigator.course.along(time.time()) > 5.0, "half way")
    course = navigator.course
    assert course is not None
    await field.me.tell("navigator", "abort")
    await field.ended("square broken off at")
    await field.rests(lambda state: state.lease is None)
    assert course.ended(time.time())
    assert 5.0 < course.along(time.time()) < 8.0
    assert math.dist(field.me.local, course.place(time.time())) < 0.5


async def test_a_network_that_is_silent_for_seconds_ends_no_flight(field: Field) -> None:
    """It is while the second segment is due, and for longer than one that is heard has to take it."""
    async with field.distant() as (z, distant):
        await field.circling(distant, WINDOW - OVERLAP - 1.0)
        z.cut = True
        await asyncio.sleep((TRIES + 2) * TAKEN)
        with pytest.raises(Refused, match="flies circle already"):
            await field.circle()
        assert distant.flying
        z.cut = False
        await field.me.wait_until(lambda state: state.segment is not None and state.segment.seq > 1, PATIENCE_S)
        await field.me.tell("distant", "abort")
        assert distant.flight is not None
        assert distant.flight.exception() is None


async def test_a_segment_that_the_network_held_back_is_put_again(field: Field) -> None:
    before = field.me.state.setpoints.get("late", 0)
    async with field.distant() as (z, _):
        z.held = []
        flying = asyncio.create_task(field.circle())
        await until(lambda: z.held, "", PATIENCE_S)
        await asyncio.sleep(0.7 * TAKEN)  # longer than it is good for, and less than it is waited for
        z.let_go()
        await flying
        await field.me.wait_until(lambda state: state.setpoints.get("late", 0) > before, PATIENCE_S)
        await field.me.tell("distant", "abort")


async def test_a_way_whose_first_segment_is_lost_in_a_silence_is_begun_all_the_same(field: Field) -> None:
    async with field.distant() as (z, _):
        held: list[Callable[[], None]] = []
        z.held, z.breaks = held, True
        flying = asyncio.create_task(field.circle())
        await until(lambda: len(held) > 0, "", PATIENCE_S)
        await asyncio.sleep(1.5 * TAKEN)  # it is not heard, and nothing more is put
        assert len(held) == 1 and not flying.done()
        z.cut, z.held = False, None
        await flying
        await field.me.tell("distant", "abort")


async def test_what_is_aborted_in_a_silence_comes_to_rest_on_its_way_when_it_is_heard_again(field: Field) -> None:
    async with field.distant() as (z, distant):
        course = await field.circling(distant, 2.0)
        z.cut = True
        await asyncio.sleep(1.5 * TAKEN)  # it is not heard
        aborting = asyncio.create_task(field.me.tell("distant", "abort"))
        await asyncio.sleep(2.5 * TAKEN)
        assert distant.flying
        z.cut = False
        await aborting
        assert distant.flight is not None
        assert distant.flight.exception() is None
        await field.rests(lambda state: state.lease is None)
        assert math.dist(field.me.local, course.place(time.time())) < 0.5


async def test_what_came_to_rest_in_a_silence_does_not_set_off_again(field: Field) -> None:
    """Its brake came there, and no word of that came back."""
    async with field.distant() as (z, distant):
        course = await field.circling(distant, 2.0)
        z.held, z.breaks = [], True
        aborting = asyncio.create_task(field.me.tell("distant", "abort"))
        await until(lambda: z.cut, "", PATIENCE_S)
        z.let_go(through=True)
        await field.rests(lambda state: state.segment is not None)
        rests, flown = field.me.local, field.me.state.setpoints["flown"]
        await asyncio.sleep(1.2 * TAKEN)
        assert not aborting.done() and field.me.state.setpoints["flown"] == flown
        z.cut = False
        await aborting
        assert math.dist(field.me.local, rests) < 0.5
        assert math.dist(field.me.local, course.place(time.time())) < 0.5


async def test_a_route_beyond_the_fence_is_not_begun_and_the_vehicle_s_reason_is_told(field: Field) -> None:
    with pytest.raises(Refused, match="geofence"):
        await field.fly(route="square", north=70.0, speed=10.0)
    await field.ended("was not begun")
    await field.me.wait_until(lambda s: s.lease is None, PATIENCE_S)


async def test_a_controller_is_told_segments_that_follow_each_other(field: Field) -> None:
    controller = field.controller
    with pytest.raises(Refused, match="not engaged"):
        await field.fly(route="circle", radius=2.0, controller="ev1")
    await field.ended("it is not engaged")
    with pytest.raises(Refused, match="no agent nobody"):
        await field.fly(route="circle", controller="nobody")
    await field.ended("no agent nobody")
    async with field.me.lease("ev1") as lease:
        controller.lease = lease
        async with Behind(field.fleet.world) as behind:
            north, east, _ = field.me.local  # its northern end: there is no way to it
            await field.fly(route="circle", radius=3.5, controller="ev1", yaw=1.0, north=north - 3.5, east=east)
            await field.ended("flew circle: 22.0 m")
        assert lease.lost is None  # it is the controller's, and stays with it
    controller.lease = None
    found = field.navigator.last
    assert found is not None
    assert found.rms < 0.4 + 1.0 * behind.most
    first, second, *_ = controller.segments
    assert first[0].t < second[0].t < first[0].t + WINDOW < second[-1].t
    assert all(point.yaw == pytest.approx(1.0) for point in second[1:])
    assert second[0].vel is not None
    assert math.hypot(*second[0].vel) > 0.5


async def test_where_the_controller_refuses_the_vehicle_holds(field: Field) -> None:
    controller = field.controller
    async with field.me.lease("ev1") as lease:
        controller.lease = lease
        await field.fly(route="circle", radius=4.0, controller="ev1")
        controller.lease = None
        await field.ended("broken off")
        await field.me.wait_until(
            lambda s: s.lease is None and s.velocity is not None and math.hypot(*s.velocity) < 0.2, PATIENCE_S
        )


async def test_the_pilot_has_it_at_once_and_is_not_told_to_hold(field: Field) -> None:
    navigator = field.navigator
    await field.fly_from_here(4.0)
    await field.until(lambda: navigator.course is not None and navigator.course.along(time.time()) > 0.5, "under way")
    field.fleet.world.vehicles[0].pilot_mode("LOITER")
    text = await field.ended("square broken off")
    assert "LOITER" in text
    assert "it holds" not in text
    assert field.me.state.mode == "LOITER"


async def test_without_a_position_it_gives_the_vehicle_back(field: Field) -> None:
    navigator = field.navigator
    await field.fly_from_here(4.0)
    await field.until(lambda: navigator.course is not None and navigator.course.along(time.time()) > 0.5, "under way")
    world = field.fleet.world
    name = world.vehicles[0].spec.name
    assert name is not None
    world.fault(name, "gps-loss")
    await field.ended("broken off: the position is lost")
    world.clear()
