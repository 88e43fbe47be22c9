"""Who may move the vehicle: leases, pilot, watchdog and setpoints, put together."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable

from zmav import wire
from zmav.autopilots import Autopilot, Target
from zmav.autopilots.base import mode_of
from zmav.autopilots.safety import changes_mode
from zmav.config import Failsafe, PilotSwitch, check_failsafe
from zmav.errors import Forbidden, Refused, ZmavError
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.control import Control, Mover
from zmav.services.authority.gcs_traffic import GcsTraffic, TakenByStation
from zmav.services.authority.leader import PositionLeader
from zmav.services.authority.lease import Leases, severity_of
from zmav.services.authority.may_move import MayMove, SetpointCounts
from zmav.services.authority.pilot import Pilot, TakenByPilot
from zmav.services.authority.setpoints import Setpoints
from zmav.services.authority.steps import Aside, ModeRequested, StreamGivenUp
from zmav.services.authority.stream import ActiveStream
from zmav.services.authority.watchdog import LATE_MODE, StreamWatchdog
from zmav.services.companion import Companion
from zmav.services.orders.command import Commander
from zmav.trust.certificate import Role
from zmav.trust.gate import Origin
from zmav.trust.proof import WINDOW
from zmav.trust.roster import Roster
from zmav.verbs import Access, Verb
from zmav.waiting import on_loop
from zmav.wire.orders import OTHER

TOLD = 1.5
"""s in which a mode that was entered is told"""
MOVING_NOTHING = ("arm", "disarm", "mission_current")
"""orders that end a stream and put nothing in its place: the vehicle holds"""
HALTING = ("hold", "land", "rtl")
"""orders after which nothing moves it but they themselves"""
ASKED_FOR = 30.0
"""s for which an order that gets no answer is sent again at most, and some more"""
HOLDING_FIRST = (*MOVING_NOTHING, "command", "mission_start")
"""... and those that may put something there, sooner or later"""
BESIDE = ("disarm", "mission_current", "command")
"""orders after which the one before is still the last that moves the vehicle: what ends with its lease"""


class Authority:
    """One vehicle's. Lives on the event loop. Raises :class:`~zmav.errors.BadConfig` for a bad failsafe.

    ``guard`` raises while nobody may command the vehicle at all (a clash of names or ids), ``accept`` where the
    autopilot's parameters do not let it follow a setpoint. ``aside``: what to fly instead for a moment. ``sealed``:
    only setpoints with the seal of their lease are read. ``param``: the autopilot's parameter of that name, if known.
    """

    def __init__(
        self,
        companion: Companion,
        commander: Commander,
        bounds: Bounds,
        counts: SetpointCounts,
        control: Control,
        *,
        failsafe: Failsafe,
        pilot_switch: PilotSwitch | None,
        guard: MayMove[[]],
        accept: MayMove[[Autopilot, Target]],
        aside: Aside,
        sealed: bool,
        param: Callable[[str], float | None],
    ) -> None:
        self._identity, self._events = companion.identity, companion.events
        self._commander, self._guard = commander, guard
        self._failsafe, self._param, self.bounds = check_failsafe(failsafe), param, bounds
        self.control = control
        self.pilot = Pilot(companion, commander, pilot_switch, control)
        self.leases = Leases(companion, may_take=control.check_pilot)
        self.leader = PositionLeader(companion, control, bounds)
        self.watchdog = StreamWatchdog(
            companion, failsafe, counts, control, allowed=self.pilot.allowed, near=self.leader.near, aside=aside
        )
        self.gcs_traffic = GcsTraffic(companion, self.leases, guard)
        self.setpoints = Setpoints(
            companion,
            self.leases,
            self.pilot,
            self.watchdog,
            bounds,
            counts,
            control,
            may_move=guard,
            accept=accept,
            sealed=sealed,
        )
        self._bus = companion.port.bus
        self._calmed: dict[Origin, float] = {}
        """UTC at which each member signed its last order that makes safe"""
        self._safe_given: dict[Origin, float] = {}
        """monotonic s at which each member gave its last such order, however long that was under way"""
        self._halted: dict[Origin, float] = {}
        """the same of its last hold, land or return"""
        self.taken_from = ""
        """what ended the last order that the pilot ended"""
        self._handing: asyncio.Task[None] | None = None
        self._asked = -math.inf
        """monotonic s at which the watchdog asked for a mode last"""
        self._ordered_under = 0
        """the number of the lease under which the last such order was given; 0: it needed none, or is open to all"""
        self._ordered_by: Origin | None = None
        """whose that order was, where it is proven; None: nobody's, or it is open to all"""
        self._out: frozenset[str] = frozenset()
        """fingerprints, hexadecimal, of whom the fleet has turned out: maybe while an order of theirs was judged"""

    def start(self) -> None:
        bus = self._bus
        bus.on(wire.LeaseEnd, self._on_lease_end)
        bus.on(TakenByPilot, self._on_pilot)
        bus.on(TakenByStation, lambda told: self.taken(told.text))
        bus.on(ModeRequested, self._on_mode_requested)
        bus.on(StreamGivenUp, on_loop(asyncio.get_running_loop(), self._end_given_up))
        self.leases.start()
        self.pilot.start()
        self.gcs_traffic.start()
        self.watchdog.start()
        self.setpoints.start()

    def close(self) -> None:
        """End; a vehicle that follows a stream is told to hold."""
        if self._handing is not None:
            self._handing.cancel()
        self.setpoints.close()
        self.watchdog.close()
        self.leader.close()
        self.pilot.close()
        self.leases.close()

    def allow(self, verb: Verb, args: wire.Order, origin: Origin | None) -> None:
        """Raise where somebody may not give an order now. Nothing is changed by it.

        A clash of names or ids stops all that changes something, but nothing that makes safe: that reaches both of the
        two, or the one whose uid the order names; one that does not know its own yet takes what makes it safe.
        """
        mine = self._identity.uid
        if args.uid and args.uid != mine and not (mine is None and verb.access is Access.OPEN):
            text = f"the order is for the autopilot {args.uid}; this one is {mine or 'not known yet'}"
            raise Refused(text, field="uid", value=args.uid, reason=OTHER)
        if verb.access not in (Access.OPEN, Access.READ) or verb.name == "lease":
            self._guard()
        if isinstance(args, wire.Forced) and args.force and origin is not None and origin.role is not Role.OPERATOR:
            raise Forbidden(f"{verb.name} with force is an operator's, and {origin.name} is none", reason="role")
        if origin is not None:
            if self._is_out(origin):
                raise Forbidden(f"the fleet turned {origin.name} out", reason="revoked", origin=origin.name)
            self._check_order(verb, args, origin)
        if verb.access in (Access.CHANGE, Access.MOVE):
            self.leases.allow(args.lease, origin)
        if verb.access in (Access.OPEN, Access.MOVE) and verb.name not in ("disarm", "revoke"):
            self.control.check_pilot()

    def begin(self, verb: Verb, args: wire.Order, origin: Origin | None) -> ActiveStream | None:
        """Let an order begin that is allowed and can be done: what it takes the place of ends.

        Returns the stream that it ended, for :meth:`failed`.
        """
        if verb.access is Access.OPEN and origin is not None:
            self._keep_order(verb, args, origin)
        if verb.access not in (Access.OPEN, Access.MOVE) or verb.name == "revoke":
            return None
        self.taken_from = ""
        if verb.name in HOLDING_FIRST:
            self.watchdog.hold_now(f"{verb.name} was ordered", severity="info")
        flown = None if moves_nothing(verb, args) else self.watchdog.stop()
        self.leader.stop()
        if verb.name not in BESIDE:
            moving = verb.access is Access.MOVE
            self._ordered_under = self.leases.number if self.leases.holder and moving else 0
            self._ordered_by = origin if moving else None
        self.pilot.order_begins(_named(args.command) if isinstance(args, wire.RunCommand) else verb.name)
        if verb.access is Access.OPEN and not self.leases.holds(args.lease, origin):  # his next setpoint would undo it
            self.leases.end("revoked", f"lease of {self.leases.holder} revoked: {verb.name} was ordered")
        return flown

    def _check_order(self, verb: Verb, args: wire.Order, origin: Origin) -> None:
        """Raise :class:`Refused` for an order that its giver has overtaken by one that makes safe.

        A relay may hold a proven order back, and a bad link may have it sent again and again; it is not let loose on
        who has ordered a halt since. What halts must pass: it is judged by how long it waited alone, not by its clock.
        """
        late = f"{verb.name} was given before the last order of {origin.name} that makes it safe"
        calmed = self._calmed.get(origin, 0.0)
        if verb.name in HALTING and _given(args, origin) < self._halted.get(origin, -math.inf):
            raise Refused(f"{late}, and comes after it: overtaken", verb=verb.name)
        if verb.access is Access.MOVE and (
            _given(args, origin) < self._safe_given.get(origin, -math.inf)
            or origin.t < calmed <= origin.t + 2 * WINDOW  # else its clock was set
        ):
            raise Refused(f"{late}: overtaken", verb=verb.name)

    def _keep_order(self, verb: Verb, args: wire.Order, origin: Origin) -> None:
        """Remember when one that makes safe was given."""
        given = _given(args, origin)
        self._calmed[origin] = max(self._calmed.get(origin, 0.0), origin.t)
        self._safe_given[origin] = max(self._safe_given.get(origin, -math.inf), given)
        if verb.name in HALTING:
            self._halted[origin] = given

    def failed(self, flown: ActiveStream | None, verb: Verb) -> None:
        """An order came to nothing: the stream it ended is not flown on, where the vehicle still would."""
        idle = not self.control.claimed(Mover.ORDER, Mover.TARGET)
        if flown is not None and idle and self._identity.mode in (flown.mode, mode_of(flown.autopilot.hold_mode)):
            self.watchdog.hold(flown, f"{verb.name} came to nothing")

    def taken(self, text: str) -> ActiveStream | None:
        """The pilot wins, as does the autopilot itself: everything of ours lets go, and nothing takes it back.

        Returns the stream that it ended.
        """
        if self._handing is not None:
            self._handing.cancel()
        ours = self.control.ours or self.leases.holder is not None
        flown = self.watchdog.stop(taken=True)
        self.leader.stop()
        self._commander.ordered = None  # if the pilot goes back to that mode, it is his
        if self._commander.under_way:
            self.taken_from = text
            self._commander.supersede()
        if ours:
            self._events.emit("pilot", "warning", f"{text}: released")
        self.leases.end("pilot", f"{text}: the lease has ended")
        return flown

    def taken_over(self) -> Refused:
        """What the order that the pilot ended is answered."""
        text = f"taken over: {self.taken_from}"
        return Refused(text, vehicle=self.leases.vehicle, mode=self._identity.mode)

    def _on_pilot(self, told: TakenByPilot) -> None:
        flown = self.taken(told.text)
        if flown is not None and self._identity.mode in flown.autopilot.stream_lost:
            self._handing = asyncio.get_running_loop().create_task(self._hold_lost(flown))
        if told.by_switch:
            self._to_autopilot()

    async def _hold_lost(self, flown: ActiveStream) -> None:
        """Order the hold where the autopilot has lost the stream: it would go back to it with the next setpoint, of
        any agent. Only it tells that from a pilot who has changed the mode, and only after the change. Where a
        failsafe, a battery's, may wait in that hold for its pilot, it is waited for: what it enters then stays.
        """
        who, (param, usual) = self._identity, flown.autopilot.failsafe_waits
        if who.mode == flown.autopilot.hold()[0]:
            waits = self._param(param)
            await asyncio.sleep((usual if waits is None else waits) + TOLD)
        with contextlib.suppress(ZmavError):
            if who.intended is None:
                await self._commander.until_heartbeat(
                    lambda: who.intended is not None, "it does not say what it intends"
                )
        lost = who.mode in flown.autopilot.stream_lost and who.intended == flown.mode and bool(who.armed)
        if lost and self.control.mover is Mover.NOBODY:
            await self._hand(flown.autopilot.hold()[0])

    def _to_autopilot(self) -> None:
        """The switch ends the stream, but the autopilot would wait for more of it for seconds: it is told to fly."""
        autopilot = self._identity.autopilot
        if autopilot is None or not self._identity.armed or self._identity.mode is None:
            return
        if self._identity.mode == mode_of(lambda: autopilot.guided):
            switch = self.pilot.switch
            mode = (switch.mode if switch else None) or autopilot.loiter()
            self._handing = asyncio.get_running_loop().create_task(self._hand(mode))

    async def _hand(self, mode: str) -> None:
        try:
            await self._commander.enter(mode)
        except ZmavError as e:
            self._events.emit("pilot", "error", f"it cannot be handed to the autopilot: {e}")

    def changed(self) -> None:
        """It shows another mode or arming, or is another autopilot."""
        self.pilot.changed()
        self.bounds.changed()
        if self.control.mover is Mover.PILOT and time.monotonic() - self._asked < LATE_MODE:
            self._to_autopilot()  # granted after he took it: nobody streams
        if not self._identity.armed:
            self.watchdog.stop()

    def add_to_state(self, state: wire.VehicleState) -> None:
        state.lease, state.lease_end = self.leases.info(), self.leases.last_end
        state.pilot, state.mover, state.segment = self.control.pilot, self.control.mover.value, self.setpoints.segment
        state.setpoints = dict(self.setpoints.counts)

    def _on_lease_end(self, end: wire.LeaseEnd) -> None:
        """The one who flew it does so no more: a hold, and what follows a hold where nobody meant the end."""
        lost = end.reason in ("expired", "gone", "clock")
        if end.reason in ("pilot", "failsafe") or (lost and self.control.claimed(Mover.SEGMENT)):
            return  # a lost network delays the next plan, and not the segment that the vehicle flies by itself
        self.watchdog.hold_now(end.text, goes_on=lost, severity=severity_of(end.reason))
        if not lost and self._ordered_under == end.number:
            movers = (Mover.ORDER,) if end.reason == "released" else (Mover.ORDER, Mover.TARGET)
            self._end_order(end.text, end.number, movers)

    def take_roster(self, roster: Roster) -> None:
        """The authority's newest: whom it has turned out commands no more. A lease of theirs ends, and what they
        ordered to move the vehicle, with a lease or without one.
        """
        self._out = frozenset(roster.revoked)
        by = self.leases.origin
        if by is not None and self._is_out(by):
            self.leases.end("revoked", f"lease of {self.leases.holder} ended: the fleet turned {by.name} out")
        by = self._ordered_by
        if by is not None and self._is_out(by):
            self._end_order(f"the fleet turned {by.name} out", 0, (Mover.ORDER, Mover.TARGET))

    def _is_out(self, origin: Origin) -> bool:
        return origin.fingerprint.hex() in self._out

    def _end_order(self, why: str, lease: int, movers: tuple[Mover, ...]) -> None:
        """What was ordered ends with the right to it where somebody meant that end: the vehicle holds for the next."""
        if not self.control.claimed(*movers):
            return
        self._ordered_under, self._ordered_by = 0, None
        self._commander.supersede()
        self.leader.stop()
        who, now = self._identity, time.monotonic()
        if who.autopilot is not None and who.source is not None:
            still = Target(vel=(0.0, 0.0, 0.0))
            flown = ActiveStream(who.autopilot, who.source, lease, still, who.mode or "", now, goes_on=False)
            self.watchdog.hold(flown, why)

    def _on_mode_requested(self, told: ModeRequested) -> None:
        """In the watchdog's thread: what it asks for is no pilot's mode, not even for a moment."""
        self._commander.ordered, self._asked = told.mode, time.monotonic()

    def _end_given_up(self, told: StreamGivenUp) -> None:
        if told.lease == self.leases.number:
            self.leases.end("failsafe", f"no setpoint for {self._failsafe.land_after} s: the lease has ended")


def _given(args: wire.Order, origin: Origin) -> float:
    """Monotonic seconds at which its giver first gave it. One that waited longer than anybody asks again was given by a
    clock that was set since: it counts from now.
    """
    waited = origin.t - (args.given or origin.t)
    return time.monotonic() - (waited if 0.0 <= waited <= ASKED_FOR else 0.0)


def moves_nothing(verb: Verb, args: wire.Order) -> bool:
    """What is held or acted on when it is given goes on: a speed, a camera, arming."""
    if isinstance(args, wire.RunCommand):
        name = _named(args.command)
        return not (changes_mode(name) or name.startswith("MAV_CMD_GUIDED_CHANGE"))
    return verb.name in MOVING_NOTHING


def _named(command: str) -> str:
    """As the dialect names it, however it was written."""
    return "MAV_CMD_" + command.upper().removeprefix("MAV_CMD_")
