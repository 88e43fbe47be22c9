"""``zmav agent run follower --vehicle quad1``: stays above a pad that somebody sees, and lands on it when asked."""

from __future__ import annotations

import asyncio
import contextlib
import statistics
import time
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, ClassVar

import zmav
from agents.follower.guide import Guide, TargetFix
from agents.follower.place import HZ, LATE_GAIN, Here
from agents.follower.slot import Slot
from agents.follower.tracker import Tracker
from zmav import keys, wire
from zmav.agent import Tunable
from zmav.errors import NotHolder, Refused, Stale
from zmav.flying import PATIENCE, FlightSettings, FlyingAgent, Started
from zmav.subscription import document
from zmav.trust.gate import Origin
from zmav.verbs import Access, Verb
from zmav.waiting import alongside, together

TICK = 0.05
"""s between two setpoints"""
VALID = 0.4
"""s until a setpoint is flown no more, and the vehicle holds"""
SLOT = "above"
"""its place relative to the target: one vehicle keeps it"""
OLD = 10.0
"""s after which what the target said of its place is not relied upon"""
MOST_LATE = 1.0
"""s from the vehicle to us that are believed"""
OFTEN = 3
"""landings stopped by gusts from which on each one is told of as a warning"""
DELAYS = 50
"""of which the median from shutter to setpoint is told"""


class FollowerSettings(FlightSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera: str = "*"
    """whose sights count, of the vehicle's own"""
    deck_m: float = 0.0
    """m of the pad above the target's reference point"""


class Follow(wire.Order, kw_only=True):
    target: str = ""
    """the vehicle that carries the pad; empty: any pad that is seen"""
    height: float = 5.0
    """m above the pad"""


class Follower(FlyingAgent):
    """Stays above a pad by position commands: goes to where the target says that it is, looks for it, follows it with
    the velocity that it has, goes on by prediction where it is hidden, looks again, and lands on it when asked.
    """

    name = "follower"
    settings_type = FollowerSettings
    tunables: ClassVar = {
        "lead": Tunable(0.1, 0.0, 2.0, "s", "ahead of now at which the target is aimed at: what the autopilot lags"),
        "coast": Tunable(3.0, 0.5, 20.0, "s", "without a sight for which the prediction is flown"),
        "score": Tunable(0.3, 0.0, 1.0, "", "least score of a sight of what it follows"),
        "begin": Tunable(0.8, 0.0, 1.0, "", "of the two sights with which it begins to; less, the longer it searches"),
        "accel": Tunable(0.3, 0.05, 10.0, "m/s²", "of the target, as its filter expects"),
        "speed": Tunable(5.0, 0.1, 20.0, "m/s", "at most fed forward"),
        "stiff": Tunable(0.8, 0.0, 2.0, "1/s", "of how far off it is, added to the velocity against gusts"),
        "damp": Tunable(0.5, 0.0, 1.0, "", "of how much slower than the target it is, added likewise"),
        "trim": Tunable(0.4, 0.0, 2.0, "1/s²", "of that distance's integral"),
        "sink": Tunable(0.4, 0.1, 2.0, "m/s", "of the descent onto the pad"),
        "gate": Tunable(0.12, 0.05, 2.0, "m", "off the pad's middle at which it goes lower"),
        "search_top": Tunable(10.0, 2.0, 50.0, "m", "above the pad to which a search rises"),
        "search_climb": Tunable(0.3, 0.0, 2.0, "m/s", "of a search"),
        "search_speed": Tunable(1.5, 0.2, 10.0, "m/s", "along its spiral"),
        "search_seconds": Tunable(180.0, 5.0, 3600.0, "s", "after which a search is given up, and it holds"),
        "search_radius": Tunable(12.0, 1.0, 100.0, "m", "of the spiral at most, before it begins again"),
    }
    verbs: ClassVar = {
        "follow": Verb("follow", Follow, Access.MOVE, "take off where need be, find the target, stay above it"),
        "hold": Verb("hold", wire.Order, Access.OPEN, "stay where it is, under the lease"),
        "land": Verb("land", wire.Order, Access.MOVE, "go down onto the pad"),
        "abort": Verb("abort", wire.Order, Access.OPEN, "hold, and give the vehicle back"),
    }

    def __init__(self, *args: Any, **rest: Any) -> None:
        super().__init__(*args, **rest)
        self.guide: Guide | None = None
        self.target = ""
        self._delays: deque[float] = deque(maxlen=DELAYS)
        self._sight = 0.0
        """when the last sight that was believed was taken (UTC s), until a setpoint has come of it"""
        self._late = self._state_t = 0.0
        self._here = Here(0.0)
        self._plane_told: float | None = None
        """how far down the pad is by what its carrier said last in this flight"""
        self._heading: float | None = None
        """rad: the vehicle's at the first setpoint, and kept: by itself it would turn along each of its swings"""

    # What it is asked.

    async def on_follow(self, args: Follow, report: Any, origin: Origin | None) -> dict[str, Any]:
        if not 0.5 <= args.height <= 100.0:
            raise Refused(f"height {args.height:g} m; expected 0.5 to 100", field="height", value=args.height)
        if args.target == self.vehicle.name:
            raise Refused(f"{args.target} cannot follow itself", field="target", value=args.target)
        await self.z.wait_for(self.vehicle.name, *([args.target] if args.target else []), timeout=PATIENCE)
        if self.flying:
            if args.target != self.target or self.guide is None:
                raise Refused(f"it follows {self.target or 'what it sees'} already: abort that first")
            self.guide.wanted, self.guide.height = "follow", args.height
            return {"target": self.target, "height": args.height}
        self.guide = guide = Guide(self.__getitem__, args.height, Tracker(self["accel"]))
        self.target = args.target
        await self.begin_flight(lambda started: self._fly(args, guide, started))
        return {"target": args.target, "height": args.height}

    async def on_hold(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._flying().wanted = "hold"
        return {}

    async def on_land(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        guide, flight = self._flying(), self.flight
        assert flight is not None
        guide.land()
        while not (await asyncio.wait({flight}, timeout=0.2))[0]:
            if self._called_off(guide):
                why = guide.why or "it was told otherwise"
                raise Refused(f"it does not land: {why}", phase=guide.phase, called_off=guide.called_off)
        if (error := flight.exception()) is not None:
            raise error
        return {"lost": guide.lost, "called_off": guide.called_off}

    async def on_abort(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._flying()
        await self.end_flight()  # also before it has taken off
        if not self.vehicle.state.landed:
            await self.vehicle.hold()
        return {}

    def _flying(self) -> Guide:
        if not self.flying or self.guide is None:
            raise Refused("it follows nobody: give it 'follow' first")
        return self.guide

    def _called_off(self, guide: Guide) -> bool:
        """Its landing is; not once it is down: setpoints would go to a vehicle that stands armed on a moving deck."""
        state = self.vehicle.last_state
        return guide.wanted != "land" and not (state is not None and state.landed)

    # In flight.

    async def _fly(self, args: Follow, guide: Guide, started: Started) -> str:
        """Under the slot and the lease, until it has landed, is ended, or the vehicle is taken from us."""
        lost, fleet, me = asyncio.Event(), self.vehicle.fleet, self.vehicle.name
        self._plane_told = self._heading = None

        def on_lost(who: str) -> None:
            self.say("slot", "warning", f"{who} keeps the place {SLOT} {args.target} since before us")
            lost.set()

        try:
            async with contextlib.AsyncExitStack() as stack:
                if args.target:
                    await stack.enter_async_context(
                        Slot(self.z.session, self.z.is_vehicle, fleet, me, args.target, SLOT, on_lost)
                    )
                lease = await stack.enter_async_context(self.lease())
                self.vehicle.local  # noqa: B018 - raises, and says why, where it has no place
                started.set_result(None)
                await self._take_off(guide, lost)
                self._here = Here(time.monotonic())
                async with alongside(together(self._see(guide), self._places(guide))) as (hearing,):
                    await self._follow(guide, lease, lost, hearing)
        finally:
            if self.guide is guide:
                self.guide, self.target = None, ""
        return "landed"

    async def _take_off(self, guide: Guide, lost: asyncio.Event) -> None:
        state = self.vehicle.state
        if not state.landed and state.armed:
            return
        self.status("takeoff", f"to {guide.height:g} m")
        await self.vehicle.arm()
        await self._unless(lambda: guide.wanted == "hold" or lost.is_set(), self.vehicle.takeoff(guide.height))

    async def _unless(self, otherwise: Callable[[], bool], order: Coroutine[Any, Any, None]) -> bool:
        """Whether the vehicle did it; it holds instead where it is told ``otherwise`` meanwhile."""
        async with alongside(order) as (doing,):
            while not (await asyncio.wait({doing}, timeout=0.1))[0]:
                if otherwise():
                    break
            else:
                doing.result()
                return True
        await self.vehicle.hold()  # once that has ended: an order whose answer does not come is sent again
        return False

    async def _see(self, guide: Guide) -> None:
        """Whatever is found in the vehicle's own pictures, wherever they are looked at."""
        key = keys.DETECTION.key(self.vehicle.fleet, self.vehicle.name, camera=self.settings.camera)
        async with self.z.subscribe(key, document(wire.Detections), depth=20) as sights:
            async for _, sight in sights:
                guide.tracker.accel = self["accel"]
                me = self._here.at(time.time())
                if me is not None and guide.see(time.time(), sight.t, sight.found, me, self._told(), self["score"]):
                    self._sight = sight.t

    async def _places(self, guide: Guide) -> None:
        """Where the vehicle is: more often than its states come, by the autopilot's own clock."""
        async with self.vehicle.places(HZ) as places:
            async for place in places:
                heard = time.monotonic()
                if self._here.feed(place, time.time(), heard):
                    guide.drift.feed(place.t, heard, place.pos, place.vel)

    async def _follow(self, guide: Guide, lease: zmav.Lease, lost: asyncio.Event, hearing: asyncio.Task[None]) -> None:
        said, stopped, armed, due = "", 0, False, time.monotonic()
        while not lost.is_set():
            if lease.lost is not None:
                raise lease.lost
            if hearing.done():
                hearing.result()
            state = self._known(guide)
            if state is not None:
                if armed and state.armed is False:  # whoever arms it next has not asked us to fly it
                    return
                armed = armed or state.armed is True
            if state is not None and state.local is not None and self._step(guide, lease, state):
                self.status("land", "on the pad")
                if await self._unless(lambda: self._called_off(guide), self.vehicle.land()):
                    return
            if guide.phase != said:
                said = guide.phase
                self.say("phase", "info", f"{said} {self.target}".strip(), phase=said)
            if guide.called_off != stopped:
                stopped = guide.called_off
                if stopped >= OFTEN:
                    self.say("landing", "warning", f"stopped {stopped} times by gusts near the pad: it tries again")
            due = max(due + TICK, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
        raise Refused("another one keeps the slot", target=self.target)

    def _known(self, guide: Guide) -> wire.VehicleState | None:
        """The state, where that and the vehicle's place can be relied on; else None, and the status says why: without
        setpoints the vehicle holds by itself. Raises :class:`Stale` where it has been heard for :data:`PATIENCE`, but
        not where it is.
        """
        now = time.monotonic()
        try:
            state = self.vehicle.state
        except Stale as e:
            self._here.unheard(now)
            why = e.message
        else:
            if not (why := self._here.known(time.time(), now)):
                return state
        self.status(guide.phase, why, target=self.target)
        return None

    def _step(self, guide: Guide, lease: zmav.Lease, state: wire.VehicleState) -> bool:
        """One setpoint; True where it is time to land."""
        self._hear(state)
        now, here = time.time(), self._here
        me = here.at(now)
        assert me is not None and here.last is not None
        command = guide.step(now, me, self._told(), self._plane(state), self._late, here.last.vel, here.late)
        if self._heading is None and state.attitude is not None:
            self._heading = state.attitude.yaw
        with contextlib.suppress(NotHolder):  # said by lease.lost
            lease.setpoint(pos=command.pos, vel=command.vel, yaw=self._heading, valid=VALID)
        if self._sight:
            self._delays.append(time.time() - self._sight)
            self._sight = 0.0
        self._tell(guide, me, now)
        return command.land

    def _hear(self, state: wire.VehicleState) -> None:
        """Of a new state how late it comes, smoothed: a setpoint takes as long back."""
        if state.t == self._state_t:
            return
        self._state_t = state.t
        since = self.vehicle.age or 0.0
        self._late += LATE_GAIN * (max(0.0, min(time.time() - since - state.t, MOST_LATE)) - self._late)

    def _told(self) -> TargetFix | None:
        """Where the target says that it is, where that is not old."""
        if not self.target:
            return None
        target = self.z.vehicle(self.target)
        state, age = target.last_state, target.age
        if state is None or state.local is None or age is None:
            return None
        age += state.ages.get("position", 0.0)
        return TargetFix(time.time() - age, state.local, state.velocity) if age < OLD else None

    def _plane(self, state: wire.VehicleState) -> float:
        """How far down the pad is: by the target's own height, also when it is silent now; else as our home is."""
        assert state.local is not None
        if (told := self._told()) is not None:
            self._plane_told = told.pos[2] - float(self.settings.deck_m)
        if self._plane_told is not None:
            return self._plane_told
        above = state.position.alt_rel if state.position is not None else 0.0
        return state.local[2] + above - float(self.settings.deck_m)

    def _tell(self, guide: Guide, me: wire.Vector, now: float) -> None:
        estimate = guide.target(now)
        detail: dict[str, Any] = {"target": self.target, "height": guide.height, "lost": guide.lost}
        if guide.wanted == "land":
            detail["called_off"] = guide.called_off
        if estimate is not None and guide.tracker.t is not None:
            north, east = map(float, estimate.pos)
            detail |= {
                "at": [round(north, 2), round(east, 2)],
                "vel": [round(float(v), 2) for v in estimate.vel],
                "sigma": round(estimate.sigma, 3),
                "off": round(((me[0] - north) ** 2 + (me[1] - east) ** 2) ** 0.5, 3),
                "unseen": round(now - guide.tracker.t, 2),
            }
        if self._delays:
            detail["delay_ms"] = round(1e3 * statistics.median(self._delays), 1)
        self.status(guide.phase, f"{guide.phase} {self.target}".strip(), **detail)
