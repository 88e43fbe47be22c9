"""``zmav agent run my_controller.py --vehicle hex1``: a controller in place of a part of the autopilot's cascade.

The supervisor runs in a process of its own beside the controller's. It decides who flies: the pilot's switch and mode
first, then the controller while it is engaged and keeps to the envelope, else the autopilot.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any, ClassVar

import zmav
from agents.controllers import loading
from agents.controllers.cycle import Cycles, Phase
from agents.controllers.estimate import HEARD, RATES_HZ, Estimate
from agents.controllers.inject import Inject
from agents.controllers.readiness import check_parameters, check_ready
from agents.controllers.reloading import ControllerReloader
from agents.controllers.settings import TUNABLES, ByStick, ControllerSettings, FollowSegment, GoTo, slug
from agents.controllers.types import LEVELS
from agents.controllers.worker import Loaded, Worker, WorkerEvents
from zmav import keys, wire
from zmav.autopilots import autopilot_named
from zmav.direct import direct
from zmav.errors import BadConfig, BadInput, Refused, ZmavError
from zmav.trust.gate import Origin
from zmav.vehicle.lease import Lease
from zmav.verbs import Access, Verb
from zmav.waiting import alongside, on_loop, together, within

LOOK = 0.02
"""s between two looks at whether the autopilot's state still comes"""
SOON = 2.0
"""s that an order to engage waits for the autopilot's state"""
CONFIRMED = 1.5
"""s in which the vehicle's state shows that it follows, where the autopilot has acknowledged the mode"""
MODE_TOLD = 0.3
"""s in which a HEARTBEAT tells of the mode for certain: an older one may be of the engagement before"""
AGAIN = 0.5
"""s before a process that is gone is replaced"""
PATIENCE = 10.0
"""s for a vehicle that was not heard yet"""


class Supervisor(zmav.Agent):
    """Runs a controller for a vehicle, watches over it, and hands back to the autopilot."""

    name = "controller"
    settings_type = ControllerSettings
    take_over = 6.0
    """s for the autopilot to follow: PX4 wants a second of the stream before"""
    check = staticmethod(loading.check)
    tunables: ClassVar = TUNABLES
    verbs: ClassVar = {
        "engage": Verb("engage", wire.Order, Access.MOVE, "take over from the autopilot, and stay where it is"),
        "release": Verb("release", wire.Order, Access.OPEN, "hand back to the autopilot"),
        "hold": Verb("hold", wire.Order, Access.OPEN, "under the controller, stay where it is"),
        "goto": Verb("goto", GoTo, Access.MOVE, "under the controller, fly to a place"),
        "follow": Verb("follow", FollowSegment, Access.MOVE, "under the controller, follow a trajectory"),
        "sticks": Verb("sticks", ByStick, Access.MOVE, "under the controller, follow the pilot's sticks"),
        "inject": Verb("inject", Inject, Access.MOVE, "add a step or a doublet to the reference"),
    }

    def __init__(self, z: zmav.Client, vehicle: str, settings: Any = None, tuned: Any = ()) -> None:
        assert isinstance(settings, ControllerSettings)
        self.name = keys.check_name(settings.name or slug(settings.controller), "name")
        self.wished = dict(tuned)
        """values of parameters to begin with; the controller's own are known when it has been loaded"""
        super().__init__(z, vehicle, settings)
        self.estimate = Estimate(settings.rc)
        self.cycles = Cycles(z.dialect, self.estimate)
        loop = asyncio.get_running_loop()
        because = on_loop(loop, lambda worker, text: self.say("controller", "error", text))
        events = WorkerEvents(self.cycles.on_answer, self._on_failed, because)
        self.reloader = ControllerReloader(settings.controller, self.cycles.fly_by, self._agree, events)
        self.handed_back_ms: float | None = None
        """from what ended the last engagement to the autopilot's having it"""
        self._failed_on_loop = on_loop(loop, self._failed)
        self._replacing: asyncio.Task[None] | None = None
        self._engaged: asyncio.Task[None] | None = None
        self._switched: asyncio.Task[None] | None = None
        self._wanted: object | None = None
        """the request to take over that counts, while it is looked into"""
        self._ending = False
        self.pilot_at = ""
        """the instance of the vehicle's agent that said last that the pilot has it; empty: he has it no more"""
        self._over = asyncio.Event()
        self.why = ""
        """for which the autopilot has it, or is to have it again"""
        self._began = 0.0
        self._refused: asyncio.Queue[str] = asyncio.Queue(maxsize=10)

    # Its life.

    async def run(self) -> None:
        """Wait for orders, for ever."""
        loop = asyncio.get_running_loop()
        self.cycles.on_trip = on_loop(loop, self._tripped)
        self.cycles.on_signals = lambda t, values: self.publish("signals", values, t)
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self.reloader.close)
            await self._load()
            for name, value in self.wished.items():
                self.tune(name, value)
            self.say("loaded", "info", f"{self._described()} is ready")
            await self.z.wait_for(self.vehicle.name, timeout=PATIENCE)
            for name, hz in RATES_HZ.items():
                stack.enter_context(self.vehicle.rates.want(name, hz or self.settings.rate_hz))
            for name in HEARD:
                key = keys.RX.key(self.vehicle.fleet, self.vehicle.name, sys="*", comp="1", msg=name)
                # On Zenoh's own thread: with a thread each, an attitude would overtake the position beside it.
                subscriber = self.z.session.declare_subscriber(key, direct(self.cycles.on_frame))
                stack.callback(subscriber.undeclare)
            try:
                await together(self._look(), self._watch_file(), self._watch_events())
            finally:
                self._ending = True
                await self._release("the supervisor ends")

    async def _look(self) -> None:
        """Whether the state still comes, what the state says of places, and who flies."""
        while True:
            await asyncio.sleep(LOOK)
            self.cycles.watch()
            state = self.vehicle.last_state
            if state is not None:
                if state.sysid is not None and state.compid is not None:
                    self.cycles.source = state.sysid, state.compid
                if state.clock is not None:
                    self.cycles.set_clock(state.clock.boot_t)
                if self.idle:
                    self._locate(state)
                if self.turned_away(state) and self.settings.by_switch:
                    self._switched = asyncio.get_running_loop().create_task(self._by_switch())
            self._tell()

    def turned_away(self, state: wire.VehicleState) -> bool:
        """The pilot's switch, from him. An agent of the vehicle that has just begun does not know of it yet."""
        before, self.pilot_at = self.pilot_at, "" if state.pilot is None else state.instance
        if self.pilot_at:
            self._wanted = None  # what was asked for before he took it counts no more
        return before == state.instance and not self.pilot_at

    def _tell(self) -> None:
        """The status: who flies, and how it goes."""
        cycles, what, broken = self.cycles, self._described(), self.reloader.broken
        hz = 1.0 / self.estimate.period if self.estimate.period else 0.0
        detail: dict[str, Any] = {
            "controller": what,
            "hz": round(hz, 1),
            "cycles": cycles.counters.cycles,
            "late": cycles.counters.late,
            "clipped": cycles.counters.clipped,
            "handed_back_ms": self.handed_back_ms,
            "why": self.why,
            "broken": broken,
        }
        state = self.vehicle.last_state
        if cycles.phase is Phase.IN_FORCE:
            word, text = "controller", f"{what} flies, and follows {cycles.references.what}"
        elif cycles.phase is Phase.ENGAGING:
            word, text = "engaging", f"{what} takes over"
        elif state is not None and state.pilot:
            word, text = "pilot", f"the pilot has it: {state.pilot}"
        else:
            word, text = "autopilot", f"{what} is ready" + (f"; last: {self.why}" if self.why else "")
        if broken:
            text += f"; the file as saved is broken: {broken}"
        self.status(word, text, **detail)

    # What is loaded.

    async def _load(self, *, where_gone: bool = False) -> float:
        reloader = self.reloader
        given = {name: self[name] for name in (reloader.loaded.tunables if reloader.loaded is not None else ())}
        took = await reloader.load(given, where_gone=where_gone)
        if reloader.loaded is not None and reloader.worker is not None:
            self.declare({**self.tunables, **reloader.loaded.tunables})
            for name in given.keys() & reloader.loaded.tunables.keys():
                if self[name] != given[name]:  # changed while it was loaded
                    reloader.worker.tune(name, self[name])
        return took

    def _agree(self, loaded: Loaded) -> None:
        """Raises :class:`BadConfig` for what cannot take the place of what flies."""
        before = self.reloader.loaded
        if self.cycles.phase and before is not None and (loaded.level, loaded.gives) != (before.level, before.gives):
            text = f"it now takes over {loaded.level} and gives {loaded.gives}: release before changing that"
            raise BadConfig(text, field="level", value=loaded.level, expected=before.level)
        clash = sorted(self.tunables.keys() & loaded.tunables.keys())
        if clash:
            text = f"{loaded.loaded} has a parameter called {clash[0]}, which the supervisor has: call it otherwise"
            raise BadConfig(text, field=clash[0], value=clash[0], expected="another name")

    async def _watch_file(self) -> None:
        while True:
            await self.reloader.saved()
            with contextlib.suppress(Exception):  # said already; what flies goes on
                await self._load_again()

    async def _load_again(self) -> None:
        try:
            took = await self._load()
        except Exception as e:
            self.say("reload", "error", f"not loaded: {e}; what was loaded before goes on")
            raise
        self.say("reload", "notice", f"loaded again in {took:.0f} ms: {self._described()}", took_ms=took)

    def _described(self) -> str:
        loaded = self.reloader.loaded
        return "nothing" if loaded is None else f"{loaded.loaded} ({loaded.level} to {loaded.gives})"

    def _on_failed(self, worker: Worker, text: str) -> None:
        """A worker's thread: what it did is over before anybody hears of it."""
        self.cycles.on_failed(worker, text)
        self._failed_on_loop(worker)

    def _failed(self, worker: Worker) -> None:
        if self.reloader.gone(worker):
            self._replacing = asyncio.get_running_loop().create_task(self._replace())

    async def _replace(self) -> None:
        """Another process in place of one that is gone, for anyone who engages it again, unless he has one already."""
        await asyncio.sleep(AGAIN)  # one that dies of each cycle must not be all that is done here
        with contextlib.suppress(ZmavError):
            await self._load(where_gone=True)

    def tuned(self, name: str, value: float) -> None:
        reloader = self.reloader
        if reloader.loaded is not None and name in reloader.loaded.tunables:
            if reloader.worker is not None:
                reloader.worker.tune(name, value)
            return
        with self.cycles.lock:
            self.cycles.limits[name] = value

    # Who flies.

    async def _watch_events(self) -> None:
        """Why the vehicle drops setpoints of ours: said while it takes over."""
        async with self.vehicle.events() as events:
            async for event in events:
                if event.kind == "setpoint" and f"setpoint of {self.name} dropped" in event.text:
                    with contextlib.suppress(asyncio.QueueFull):
                        self._refused.put_nowait(event.text.partition("dropped: ")[2])

    async def on_engage(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        if self.cycles.phase is Phase.IN_FORCE:
            return {"state": "controller"}
        self._check_free()
        self._wanted = wanted = object()
        with contextlib.suppress(asyncio.TimeoutError):
            await within(SOON, self._estimated())
        slow = check_ready(self.vehicle.state, self.estimate, self.settings.rate_hz)
        if self.reloader.worker is None or not self.reloader.worker.alive:
            await self._load_again()
        await self._check_parameters()
        self._check_free()
        if self._wanted is not wanted:
            raise Refused("before it took over it was released, asked for again, or the pilot had it: ask again")
        self._over, self.why = asyncio.Event(), ""
        taken, begun = asyncio.Event(), time.monotonic()
        self._engaged = flight = asyncio.create_task(self._fly(taken))
        async with alongside(taken.wait()) as (waiting,):
            await asyncio.wait({waiting, flight}, return_when=asyncio.FIRST_COMPLETED)
        if not taken.is_set():
            await flight
            raise Refused(f"it did not take over: {self.why}", reason=self.why)
        took = (time.monotonic() - begun) * 1e3
        by = f", by {origin.name}" if origin else ""
        self.say("engaged", "notice", f"{self._described()} flies{by}{slow}", took_ms=took)
        return {"state": "controller", "took_ms": took, "hz": round(1.0 / self.estimate.period)}

    async def _by_switch(self) -> None:
        try:
            await self.on_engage(wire.Order(), None, None)
        except ZmavError as e:
            self.say("engaged", "error", f"the pilot's switch: {e}")

    async def _estimated(self) -> None:
        """Wait for the estimate: just after the start it is a matter of moments."""
        while (state := self.vehicle.last_state) is None or not self._locate(state).ready:
            await asyncio.sleep(LOOK)

    def _locate(self, state: wire.VehicleState) -> Estimate:
        """Have positions about the fleet's origin, where it is known: not while it flies, or it would seem to jump."""
        if state.position is not None and state.local is not None:
            self.estimate.anchor(state.position, state.local)
        return self.estimate

    @property
    def idle(self) -> bool:
        """No engagement is under way, nor its end."""
        return self._engaged is None or self._engaged.done()

    def _check_free(self) -> None:
        """Raises :class:`Refused` while an engagement is not over, and when there will be none any more."""
        if self._ending:
            raise Refused("the supervisor ends")
        if not self.idle:
            raise Refused("it is taking over or handing back just now: ask again in a moment")

    async def _check_parameters(self) -> None:
        gives = self.reloader.loaded.gives if self.reloader.loaded is not None else ""
        await check_parameters(self.vehicle, gives)

    async def _fly(self, taken: asyncio.Event) -> None:
        """One engagement, from the lease to the autopilot's having it again."""
        try:
            async with self.vehicle.lease(self.name, self.settings.lease_s, self.settings.priority) as lease:
                if not self._over.is_set() and await self._take_over(lease):
                    taken.set()
                    await self._over.wait()
                else:
                    self._began = time.monotonic()
                self.cycles.end()
                await self._hand_back(lease)
        except ZmavError as e:
            self.why = self.why or str(e)
        finally:
            self.cycles.end()

    async def _take_over(self, lease: Lease) -> bool:
        """Stream until the autopilot follows. False: it does not, and why is said."""
        state = self.vehicle.state
        guided = autopilot_named(state.autopilot, state.kind).guided
        height = state.position.alt_rel if state.position else 0.0
        while not self._refused.empty():
            self._refused.get_nowait()
        flown = state.setpoints.get("flown", 0)
        self.cycles.engage(lease, height)
        if state.mode == guided:  # it has followed somebody before, and does so at once
            self.cycles.presume()
        deadline = time.monotonic() + self.take_over
        presumed = 0.0
        while time.monotonic() < deadline and not self._over.is_set():
            now = self.vehicle.last_state
            presumed = presumed + LOOK / 4 if self.cycles.phase is Phase.IN_FORCE else 0.0
            if presumed > CONFIRMED:
                self.cycles.doubt()
            told = time.monotonic() > deadline - self.take_over + MODE_TOLD
            if told and now is not None and now.mode == guided and now.setpoints.get("flown", 0) > flown:
                return self.cycles.in_force()
            if told and not self._refused.empty():
                self.why = self._refused.get_nowait()
                return False
            await asyncio.sleep(LOOK / 4)
        refused = "" if self._refused.empty() else f": {self._refused.get_nowait()}"
        self.why = self.why or f"{guided} did not come within {self.take_over:g} s{refused}"
        return False

    def _tripped(self, text: str) -> None:
        """The engagement has ended by itself; no output goes out any more."""
        self.why = text
        self._over.set()
        if self.cycles.stuck and self.reloader.worker is not None:
            self.reloader.worker.kill()

    async def _hand_back(self, lease: Lease) -> None:
        """Have the autopilot fly, unless somebody else has taken the vehicle already."""
        began = max(self.cycles.tripped, self._began)
        reason = (lease.lost.detail.get("reason") if lease.lost else None) or ""
        if lease.lost is None:
            try:
                await self.vehicle.hold()
            except ZmavError as e:
                self.say("back", "error", f"the autopilot cannot be told to hold: {e}; the vehicle's own ladder will")
        self.handed_back_ms = (time.monotonic() - began) * 1e3
        who = "the pilot" if reason == "pilot" else "the autopilot"
        severity: wire.Severity = "notice" if self.why.startswith("release") else "warning"
        self.say(
            "back", severity, f"{self.why}: {who} has it", why=self.why, took_ms=self.handed_back_ms, reason=reason
        )

    async def _release(self, why: str) -> None:
        self._began, self._wanted = time.monotonic(), None
        if self._engaged is None or self.idle:
            return
        self.cycles.end()
        self.why = self.why or why
        self._over.set()
        await asyncio.gather(self._engaged, return_exceptions=True)

    async def on_release(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        by = f" by {origin.name}" if origin else ""
        await self._release(f"released{by}")
        return {"state": "autopilot", "took_ms": self.handed_back_ms}

    # What it follows.

    def _in_force(self) -> None:
        if self.cycles.phase is not Phase.IN_FORCE:
            why = f" ({self.why})" if self.why else ""
            raise Refused(f"{self.name} is not engaged{why}: 'zmav agent do {self.name} engage' first")

    async def on_hold(self, args: wire.Order, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._in_force()
        with self.cycles.lock:
            self.cycles.references.hold(self.estimate.state)
        return {}

    async def on_goto(self, args: GoTo, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._in_force()
        self._follows("position")
        for field, value, low, high in (("speed", args.speed, 0.05, 20.0), ("accel", args.accel, 0.05, 20.0)):
            if not low <= value <= high:
                raise BadInput.wrong(field, value, f"{low:g} to {high:g}")
        with self.cycles.lock:
            lasts = self.cycles.references.goto(args.pos, args.yaw, args.speed, args.accel, self.estimate.state)
        return {"seconds": lasts}

    async def on_follow(self, args: FollowSegment, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._in_force()
        self._follows("position")
        with self.cycles.lock:
            self.cycles.references.follow(args.segment, self.estimate.state)
            return {"ends": self.cycles.references.ends}

    async def on_sticks(self, args: ByStick, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._in_force()
        self._follows(args.level)
        with self.cycles.lock:
            self.cycles.references.by_sticks(args.level, self.estimate.state, self.estimate.trim.thrust)
        return {"level": args.level}

    async def on_inject(self, args: Inject, report: Any, origin: Origin | None) -> dict[str, Any]:
        self._in_force()
        with self.cycles.lock:
            self.cycles.references.inject(args, self.estimate.state)
        return {"level": self.cycles.references.level}

    def _follows(self, level: str) -> None:
        """Raises :class:`Refused` for a reference from further in than the controller begins."""
        loaded = self.reloader.loaded
        if loaded is not None and level in LEVELS and LEVELS.index(level) > LEVELS.index(loaded.level):
            text = f"{loaded.loaded} takes over from {loaded.level} on inwards: it cannot follow {level}"
            raise Refused(text, level=level, expected=loaded.level)
