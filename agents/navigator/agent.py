"""``zmav agent run navigator --vehicle hex1``: flies routes, by the autopilot's own cascade or by a controller's."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from typing import Any, ClassVar

import numpy as np

from agents.navigator.outlets import TRIES, ByController, ByLease, Outlet
from agents.navigator.routes import SIZES, Route, check, shape
from agents.navigator.tracking import Summary, errors, summarise
from agents.navigator.trajectory import WINDOW, Limits, Trajectory
from zmav import keys, wire
from zmav.agent import Tunable
from zmav.errors import NotHolder, Refused, Stale, ZmavError
from zmav.flying import PATIENCE, FlyingAgent, Started
from zmav.trust.gate import Origin
from zmav.verbs import Access, Verb

TICK = 0.05
"""s between two looks"""
BEGIN = 0.5
"""s from an order until the way begins"""
LOST, SILENT = 1.5, 8.0
"""s without a position after which it is lost, and without a word of the vehicle after which it is given up"""
HZ = 20.0
"""positions a second"""
OVERLAP = 10.0
"""s before a segment would brake at which the next one is given: so long a network may be silent"""
NOTICE = 0.3
"""s from a word to stop until it brakes: what is given has to come there first"""


class Fly(wire.Order, kw_only=True):
    """``north``, ``east``, ``down``: where the route's middle is, m about the fleet's origin; by default where the
    vehicle is. Sizes in metres, of the routes that have them.
    """

    route: str = "ev3"
    """ev3, square, circle or lemniscate"""
    speed: float = 1.0
    """m/s at most"""
    controller: str = ""
    """the agent that flies it; empty: the autopilot's own cascade, under the navigator's lease"""
    north: float | None = None
    east: float | None = None
    down: float | None = None
    heading: float = 0.0
    """rad by which the route is turned clockwise"""
    yaw: float | None = None
    """rad; by default as it is"""
    dwell: float = 0.0
    """s at each corner"""
    side: float | None = None
    height: float | None = None
    radius: float | None = None
    length: float | None = None
    width: float | None = None


class Course:
    """A trajectory as it is flown from ``start`` (UTC s) on: what of it is due by the clock, and how it is stopped."""

    def __init__(self, trajectory: Trajectory, start: float) -> None:
        self.trajectory, self.start = trajectory, start
        self._until: float | None = None
        """s on the trajectory from which nothing is given yet; None: nothing of it is"""
        self._flown, self._stops = trajectory, False
        """what was taken of it last, as far as known; it is to come to rest"""

    def due(self, now: float) -> list[wire.SegmentPoint] | None:
        """The next segment, where it is time to give it (UTC s)."""
        t = now - self.start
        if self._until is not None:
            if t < self._until - OVERLAP or self._until >= self.trajectory.duration:
                return None
            self._flown = self.trajectory
        elif self._stops:  # from now on: where the brake before did not come there, the vehicle flies on without it
            self.trajectory = self._flown.braked(min(max(t + NOTICE, 0.0), self._flown.duration))
        begin = max(t, 0.0)
        self._until = min(begin + WINDOW, self.trajectory.duration)
        return self.trajectory.segment(begin, self.start)

    def again(self) -> None:
        """What was given last did not come there: the next segment is due at once."""
        self._until = None

    def brake(self) -> None:
        """Come to rest along the way; this is due at once."""
        self._stops = True
        self.again()

    def ended(self, now: float) -> bool:
        """It is over, and all of it was given."""
        given = self._until is not None and self._until >= self.trajectory.duration
        return given and now - self.start >= self.trajectory.duration

    def along(self, now: float) -> float:
        """m of the route, which is zero on the way to it."""
        s = float(self.trajectory.law.at(np.array([now - self.start]))[0][0])
        return max(0.0, s - self.trajectory.route.begins)

    def place(self, now: float) -> wire.Vector:
        """m NED where it should be"""
        north, east, down = map(float, self.trajectory.at(np.array([now - self.start])).pos[0])
        return north, east, down


class Navigator(FlyingAgent):
    """Flies a route with limited speed, acceleration and jerk, as segments that the vehicle flies by itself, or that a
    controller agent follows; tells how well it is followed, and where the greatest errors are.
    """

    name = "navigator"
    tunables: ClassVar = {
        "accel": Tunable(1.0, 0.05, 10.0, "m/s²", "at most, of the next way that is begun"),
        "jerk": Tunable(2.0, 0.05, 100.0, "m/s³", "at most, of the next way that is begun"),
        "settle": Tunable(2.0, 0.0, 30.0, "s", "at rest where the route begins"),
        "near": Tunable(1.5, 0.1, 20.0, "m", "from a corner within which an error is near it"),
        "astray": Tunable(5.0, 0.2, 100.0, "m", "off its reference at which it holds and goes on no more"),
    }
    verbs: ClassVar = {
        "fly": Verb("fly", Fly, Access.MOVE, "fly a route: returns when it has begun"),
        "abort": Verb("abort", wire.Order, Access.OPEN, "come to rest along the way, and give the vehicle back"),
    }

    def __init__(self, *args: Any, **rest: Any) -> None:
        super().__init__(*args, **rest)
        self.course: Course | None = None
        """what is flown"""
        self.times: list[float] = []
        self.positions: list[wire.Vector] = []
        """UTC s and m NED, heard since the course began"""
        self.last: Summary | None = None
        """of the last route that was flown to its end, or as far as it was"""
        self._order, self._route = Fly(), shape("ev3")
        self._ends = False
        self._now: dict[str, float] = {}

    # What it is asked.

    async def on_fly(self, args: Fly, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._check_free()
        await self.z.wait_for(self.vehicle.name, timeout=PATIENCE)
        self._check_free()  # again: another order may have waited for the vehicle beside this one
        self._check_airborne()
        here, route = self.vehicle.local, self._made(args)
        self._order, self._route, self._ends = args, route, False
        await self.begin_flight(lambda started: self._fly(here, started))
        return self._told()

    async def on_abort(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        course, flight = self.course, self.flight
        if course is None or flight is None or flight.done():
            raise Refused("it flies nothing: give it 'fly' first")
        if not self._ends:
            course.brake()
        self._ends = True
        await asyncio.wait({flight})
        return {}

    def _check_free(self) -> None:
        if self.flying:
            raise Refused(f"it flies {self._route.name} already: abort that first")

    def _check_airborne(self) -> None:
        state = self.vehicle.state
        if not state.armed or state.landed:
            raise Refused("it is not in the air: 'zmav fly takeoff' comes first", armed=state.armed)

    def _made(self, args: Fly) -> Route:
        Limits(args.speed, self["accel"], self["jerk"])
        if args.yaw is not None:
            check("yaw", args.yaw, -math.tau, math.tau, "rad")
        sizes = {name: getattr(args, name) for name in sorted({size for each in SIZES.values() for size in each})}
        given = (args.north, args.east, args.down)
        north, east, down = (a if b is None else b for a, b in zip(self.vehicle.local, given, strict=True))
        return shape(args.route, (north, east, down), args.heading, dwell=args.dwell, **sizes)

    # In flight.

    def _course(self, here: wire.Vector) -> Course:
        """From here to the route, and along it."""
        state = self.vehicle.last_state
        facing = state.attitude.yaw if state is not None and state.attitude is not None else 0.0
        yaw = facing if self._order.yaw is None else self._order.yaw
        limits = Limits(self._order.speed, self["accel"], self["jerk"])
        trajectory = Trajectory(self._route.reached_from(here, self["settle"]), limits, yaw)
        self.times, self.positions = [], []
        return Course(trajectory, time.time() + BEGIN)

    def _told(self) -> dict[str, Any]:
        course = self.course
        assert course is not None
        seconds = course.trajectory.duration
        return {"route": self._route.name, "length": round(self._route.length, 2), "seconds": round(seconds, 1)}

    async def _fly(self, here: wire.Vector, started: Started) -> str:
        """To the route's end, until it is aborted, or the vehicle is taken from us."""
        name, controller = self._route.name, self._order.controller
        async with contextlib.AsyncExitStack() as stack:
            outlet: Outlet
            if controller:
                outlet = told = ByController(self.vehicle, controller)
                stack.callback(told.close)
                await told.open()
            else:
                outlet = by = ByLease(self.vehicle, await stack.enter_async_context(self.lease()))
                listening = asyncio.create_task(self._listen(by))
                stack.callback(listening.cancel)
            course = await self._begun(outlet, here)
            started.set_result(None)
            self.say("fly", "info", f"flies {name}" + (f" by {controller}" if controller else ""), **self._told())
            await self._follow(outlet, course)
        return f"broken off at {course.along(time.time()):.1f} m" if self._ends else ""

    async def _begun(self, outlet: Outlet, here: wire.Vector) -> Course:
        """The course whose first segment is taken. Each try has one of its own, for the vehicle has not set off; before
        it is heard again nobody knows that, and nothing else is given.
        """
        name = self.vehicle.name
        for _ in range(TRIES):
            self.course = course = self._course(here)
            if self._ends:  # it was told to abort meanwhile
                course.brake()
            taken = await self._give(outlet, course)
            while taken is None and (self.vehicle.age or 0.0) <= SILENT:
                await asyncio.sleep(TICK)
                taken = await self._give(outlet, course)
            if taken:
                return course
            if taken is None:
                with contextlib.suppress(ZmavError):
                    await self.vehicle.hold()
                text = f"{name} was not heard after it was given its way, and may have set off: it was told to hold"
                raise Stale(text, vehicle=name)
        raise Stale(f"{name} did not take its way in {TRIES} tries: give 'fly' again", vehicle=name)

    async def on_broken_off(self, error: Exception, why: str) -> str:
        """A vehicle that nobody else has holds."""
        text = f"broken off: {why}"
        taken = isinstance(error, NotHolder) and error.detail.get("reason") in ("pilot", "preempted", "revoked")
        if not taken:
            try:
                await self.vehicle.hold()
                text += "; it holds"
            except ZmavError as e:
                text += f"; it was told to hold, but: {e.message}"
        self.say("flight", "error", f"{self._route.name} {text}")
        return text

    async def _follow(self, outlet: Outlet, course: Course) -> None:
        """Give what is due and look after it."""
        due = time.monotonic()
        while True:
            self._check_place(course)
            outlet.check()
            taken, now = await self._give(outlet, course), time.time()
            if taken and course.ended(now):
                return
            self._tell(course, now)
            due = max(due + TICK, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def _give(self, outlet: Outlet, course: Course) -> bool | None:
        """Give what is due. False: it did not come there, and is due again; None: nobody knows yet."""
        points = course.due(time.time())
        taken = outlet.settled() if points is None else await outlet.give(points)
        if taken is False:
            course.again()
        return taken

    def _check_place(self, course: Course) -> None:
        state, age = self.vehicle.last_state, self.vehicle.age
        assert state is not None
        assert age is not None
        if age > SILENT:  # until then the vehicle flies on by what it has
            raise Stale(f"{self.vehicle.name} was last heard {age:.1f} s ago", vehicle=self.vehicle.name, age=age)
        if state.local is None or state.ages.get("position", math.inf) > LOST:
            raise Stale("the position is lost", vehicle=self.vehicle.name)
        if self.times:
            off = math.dist(self.positions[-1], course.place(self.times[-1]))
            if off > self["astray"]:
                raise Refused(f"it is {off:.1f} m off its reference; at most {self['astray']:g} m are flown", off=off)

    async def listen(self) -> None:
        """Where it is, as often as it is told."""
        async with self.vehicle.places(HZ) as places:
            async for place in places:
                if self.course is not None:
                    self._note(min(place.t, time.time()), place.pos)

    def _note(self, t: float, place: wire.Vector) -> None:
        course = self.course
        assert course is not None
        self.times.append(t)
        self.positions.append(place)
        moment = course.trajectory.at(np.array([t - course.start]))
        off = np.array(place) - moment.pos[0]
        values = {"error": float(np.linalg.norm(off)), "along": course.along(t)}
        for what, row in (("off", off), ("reference", moment.pos[0]), ("reference_vel", moment.vel[0])):
            values |= {f"{what}.{axis}": float(x) for axis, x in zip("xyz", row, strict=True)}
        key = keys.AGENT_OUT.key(self.vehicle.fleet, self.vehicle.name, agent=self.name, topic="tracking")
        self.z.put(keys.AGENT_OUT, key, wire.Signals(t=t, values=values))
        self._now = values

    async def _listen(self, outlet: ByLease) -> None:
        """What the vehicle says of setpoints."""
        async with self.vehicle.events() as events:
            async for event in events:
                if event.kind == "setpoint":
                    outlet.hear(event)

    def _tell(self, course: Course, now: float) -> None:
        on_way = now - course.start < course.trajectory.begins
        phase = "approach" if on_way else "fly"
        along = course.along(now)
        corners = self._route.corners - self._route.begins
        ahead = corners[corners > along + 1e-6]
        detail: dict[str, Any] = {
            "route": self._route.name,
            "along": round(along, 2),
            "length": round(self._route.length, 2),
            "left_s": round(max(0.0, course.start + course.trajectory.duration - now), 1),
            "corner_in": round(float(ahead[0]) - along, 2) if len(ahead) else 0.0,
        }
        if "error" in self._now:
            detail["error"] = round(self._now["error"], 3)
        share = 100.0 * along / self._route.length
        self.status(phase, f"{self._route.name}: {share:.0f} %", **detail)

    # What it says of it.

    def on_ended(self, text: str) -> None:
        """Idle again, with what was flown of the course summed up."""
        name, course, self.course = self._route.name, self.course, None
        text = f"{name} {text}" if text else f"flew {name}"
        detail: dict[str, Any] = {}
        if course is not None and self.times:
            times = np.array(self.times) - course.start
            found = errors(times, np.array(self.positions), course.trajectory)
            if len(found.t):
                self.last = summarise(found, self._route, self["near"])
                detail = {"summary": self.last.document()}
                text = f"{text}: {self.last}"
                self.say("summary", "info", text)
        self.status("idle", text, **detail)
