"""``setpoint/{agent}``: outer-loop commands, checked one by one, and handed to the watchdog that flies and guards them.

A setpoint is flown only under the lease in force, in order, before its deadline, inside the fence and the limits, by an
armed vehicle that neither the pilot nor an order has. Each that is not is counted by its reason, and said.
"""

from __future__ import annotations

import asyncio
import collections
import time
from typing import NamedTuple

import zenoh

from zmav import keys, wire
from zmav.autopilots import Autopilot, Target
from zmav.config import RETURN_LEAD
from zmav.errors import BadInput, Forbidden, LinkDown, NotHolder, Refused, ZmavError
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.control import Control
from zmav.services.authority.homeward import StoredReturn, read_way_home
from zmav.services.authority.lease import Leases
from zmav.services.authority.may_move import MayMove, SetpointCounts
from zmav.services.authority.pilot import Pilot
from zmav.services.authority.stream import ActiveStream
from zmav.services.authority.targets import resolve
from zmav.services.authority.trajectory import Segment
from zmav.services.authority.watchdog import StreamWatchdog
from zmav.services.companion import Companion
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached
from zmav.trust.seal import is_sealed
from zmav.waiting import on_loop

MAX_AHEAD = 5.0
"""s: a deadline farther away is a mistake or a clock that is off"""
MAX_SEGMENT = 60.0
"""s: no vehicle is committed for longer"""
LINGER_S = 2.0
"""s after a segment's end for which its last place is still given before the vehicle is told to hold: an autopilot that
follows late arrives, and what comes next meets it in its mode. PX4 drifts by a metre at each change of the mode"""
MOST_HEARD, MOST_WAITING = 64, 32
"""setpoints that are looked at in 5 ms, the newest; and of those that are to be flown, that wait for the event loop"""


class SegmentAccepted(NamedTuple):
    """The vehicle is committed to another segment: its sender waits to hear so. Told on the event loop."""


class Heard(NamedTuple):
    """A setpoint as it came."""

    agent: str
    payload: bytes
    secret: bytes
    """whose seal it has; empty where nothing is proven"""


class Setpoints:
    """Takes setpoints from the key space to the watchdog. Lives on the event loop; seals are looked at before it, on a
    thread, so that a flood of setpoints without one does not reach it.

    ``may_move()`` raises while nobody may command the vehicle (a clash of names or ids), ``control``
    while the pilot or an order moves it, ``accept`` where the autopilot's parameters do not let it
    follow such a target. ``sealed``: only what is sealed with the lease's secret is read. The
    port's bus is told of each :class:`SegmentAccepted`.
    """

    def __init__(
        self,
        companion: Companion,
        leases: Leases,
        pilot: Pilot,
        watchdog: StreamWatchdog,
        bounds: Bounds,
        counts: SetpointCounts,
        control: Control,
        *,
        may_move: MayMove[[]],
        accept: MayMove[[Autopilot, Target]],
        sealed: bool,
    ) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._leases = leases
        self._events, self._origin = companion.events, companion.origin
        self._pilot, self._watchdog, self._bounds = pilot, watchdog, bounds
        self.counts = counts
        self._may_move, self._control, self._accept = may_move, control, accept
        self._only_sealed = sealed
        self._segment: wire.swarm.SegmentInfo | None = None
        self._seq = -1
        self._lease = ""
        self._waiting: collections.deque[Heard] = collections.deque(maxlen=MOST_WAITING)
        self._judging = False
        self._intake: Intake | None = None

    def start(self) -> None:
        key = keys.SETPOINT.key(self._port.fleet, self._port.name, agent="*")
        wake = on_loop(asyncio.get_running_loop(), self._wake)

        def take(sample: zenoh.Sample) -> None:
            if (heard := self._sealed(sample)) is not None:
                self._waiting.append(heard)
                if len(self._waiting) == 1:  # else what came before has woken it, and it goes on to this one
                    wake()

        self._intake = Intake(self._session.declare_subscriber, key, take, MOST_HEARD)

    def close(self) -> None:
        if self._intake is not None:
            self._intake.close()
            self._intake = None

    def _sealed(self, sample: zenoh.Sample) -> Heard | None:
        """A setpoint with a seal that we know; None: dropped. On the intake's thread."""
        key, payload = str(sample.key_expr), sample.payload.to_bytes()
        agent = key.rpartition("/")[2]
        try:
            return Heard(agent, payload, self._check_seal(key, payload, attached(sample)) if self._only_sealed else b"")
        except Forbidden as e:
            self._drop(agent, e)
            return None

    def _wake(self) -> None:
        if not self._judging:
            self._next()

    def _next(self) -> None:
        """Judge one of those that wait, and the next when others have had their turn: a segment takes its time."""
        self._judging = bool(self._waiting) and self._intake is not None  # else nobody watches over it any more
        if not self._judging:
            return
        heard = self._waiting.popleft()
        asyncio.get_running_loop().call_soon(self._next)
        try:
            point = wire.decode(heard.payload, wire.Setpoint, f"setpoint of {heard.agent}")
            # Now and not when it came: the lease may have passed to another since.
            in_force = not self._only_sealed or (heard.secret != b"" and heard.secret == self._leases.secret)
            self.counts.add("flown" if self._fly(point, in_force) else "engaging")
        except ZmavError as e:
            self._drop(heard.agent, e)

    def _drop(self, agent: str, error: ZmavError) -> None:
        self.counts.add(why := str(error.detail.get("count", error.code)))
        self._events.emit("setpoint", "warning", f"setpoint of {agent} dropped: {error}", limit=f"sp {why}", why=why)

    def _check_seal(self, key: str, payload: bytes, attachment: bytes | None) -> bytes:
        """The secret that it was sealed with: of the lease in force, or of the one before, whose holder is to hear what
        took it.

        Raises :class:`Forbidden` for any other. Nothing in it is read before.
        """
        for secret in (self._leases.secret, self._leases.last_secret):
            if secret and is_sealed(secret, key, payload, attachment):
                return secret
        why = "it has no seal" if attachment is None else "its seal is not that of the lease in force"
        raise Forbidden(f"{why}: take a lease with credentials", reason="seal", count="forged")

    def _fly(self, point: wire.Setpoint, in_force: bool) -> bool:
        self._may_move()
        self._check_order(point, in_force)
        self._control.check_pilot()
        autopilot, source = self._identity.autopilot, self._identity.source
        if autopilot is None or not self._identity.connected or source is None:
            raise LinkDown("the autopilot is not heard", count="silent")
        if not self._identity.armed:
            raise Refused("it is disarmed: setpoints are followed by an armed vehicle", count="disarmed")
        self._control.check_order()
        utc, now = time.time(), time.monotonic()
        what, first, until = self._resolve(point, utc, now)
        home = self._way_home(point, what, utc, now)
        mode = self._identity.mode
        needed = autopilot.guided_for(first) or mode or ""
        self._accept(autopilot, first)
        autopilot.setpoint(first)  # what cannot be said must not take the place of what is flown, and keep it fresh
        lingers = self._lingers(until, home) if isinstance(what, Segment) else 0.0
        flown = ActiveStream(autopilot, source, self._leases.number, what, needed, until, home=home, lingers=lingers)
        engaged = self._watchdog.fly(flown, mode)
        self._leases.commit(until if isinstance(what, Segment) else 0.0)
        if isinstance(what, Segment):
            self._segment = wire.swarm.SegmentInfo(
                lease=flown.lease,
                seq=point.seq,
                start=what.start,
                rests=what.rests,
                end=what.end,
                home=home.way.start if home else None,
            )
            self._port.bus.tell(SegmentAccepted())
        return engaged

    @property
    def segment(self) -> wire.swarm.SegmentInfo | None:
        """What the vehicle is committed to, or stands at the end of; None where anything else moves it."""
        return self._segment if self._watchdog.on_segment else None

    def _check_order(self, point: wire.Setpoint, in_force: bool) -> None:
        try:
            if not in_force:  # whatever lease it names: that may have been overheard
                raise self._leases.refusal(point.lease)
            self._leases.require(point.lease)
        except NotHolder as e:
            e.detail["count"] = "pilot" if e.detail.get("reason") == "pilot" else "lease"
            raise
        if point.lease != self._lease:
            self._lease, self._seq = point.lease, -1
        if point.seq <= self._seq:
            raise BadInput(f"seq {point.seq} after {self._seq}", field="seq", value=point.seq, count="order")
        left = point.deadline - time.time()
        if left < 0:
            late = f"{-left * 1000:.0f} ms after its deadline"
            raise BadInput(late, field="deadline", value=point.deadline, count="late")
        if not left <= MAX_AHEAD:
            raise BadInput(
                f"its deadline is {left:.1f} s ahead (at most {MAX_AHEAD:.0f}): is a clock off?",
                field="deadline",
                value=point.deadline,
                count="early",
            )
        self._seq = point.seq

    def _resolve(self, point: wire.Setpoint, utc: float, now: float) -> tuple[Target | Segment, Target, float]:
        """What is to be flown, its first target, and until when (monotonic) it is fresh; checked all along."""
        if point.segment is None:
            target = resolve(point, self._origin)
            self._bounds.check(target)
            self._leave_switch(target)
            fresh = self._watchdog.failsafe.hold_after
            if target.inner:  # an old attitude, rate or torque leads anywhere: its sender says how long it is good for
                fresh = min(fresh, point.deadline - utc)
            return target, target, now + fresh
        self._leases.check_clock()
        segment = Segment(point.segment, self._origin)
        lasts = segment.end - utc
        if not 0.0 < lasts <= MAX_SEGMENT:
            text = f"the segment ends in {lasts:.1f} s; expected 0 to {MAX_SEGMENT:.0f} s"
            raise BadInput(text, field="segment", value=segment.end, count="late" if lasts <= 0.0 else "early")
        self._bounds.check(segment)
        return segment, segment.at(utc), now + lasts

    def _lingers(self, until: float, home: StoredReturn | None) -> float:
        """s for which a segment's last place is given, but that nothing which follows comes later by it."""
        after = self._watchdog.failsafe.land_after
        most = min(LINGER_S, after) if after != "never" else LINGER_S
        return most if home is None else max(min(most, home.begins - RETURN_LEAD - until), 0.0)

    def _way_home(self, point: wire.Setpoint, what: Target | Segment, utc: float, now: float) -> StoredReturn | None:
        """What the vehicle flies if nothing else comes after the segment. One that is not to be flown, or leads where
        nothing may, leaves the segment as it is: the configured action follows.
        """
        after = self._watchdog.failsafe.returns_after
        if point.home is None or after is None or not isinstance(what, Segment):
            return None
        try:
            home = read_way_home(point.home, what, after, utc, now)
            self._bounds.check(home.way, lands=True)
        except BadInput as e:
            self._events.emit("setpoint", "warning", f"way home not kept: {e.message}", limit="home", **e.detail)
            return None
        return home

    def _leave_switch(self, target: Target) -> None:
        """An override of the pilot's switch would take the vehicle from him for good."""
        switch = self._pilot.switch
        if switch is None or target.rc is None or len(target.rc) < switch.channel:
            return
        if target.rc[switch.channel - 1] is not None:
            text = f"rc channel {switch.channel} is the pilot's switch: no agent moves it"
            raise Refused(text, field="rc", value=switch.channel, count="pilot")
