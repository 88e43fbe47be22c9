"""``setpoint/{agent}``: outer-loop commands, checked one by one, and the first steps of the safety ladder.

A setpoint is flown only under the lease in force, in order, before its deadline, and while the vehicle is in the mode
that follows setpoints: so a pilot's mode switch wins within one cycle. When the stream stops, the vehicle holds.
"""

from __future__ import annotations

import asyncio
import collections
import time
from collections.abc import Callable
from typing import Any

import zenoh

from zmav import keys, wire
from zmav.autopilots import Message
from zmav.errors import BadInput, LinkDown, NotHolder, Refused, ZmavError
from zmav.services.events import Events
from zmav.services.identity import Identity
from zmav.services.lease import Leases
from zmav.services.port import Port, on_loop
from zmav.services.target import resolve

HOLD_AFTER = 0.5
HOLD_REPEATS = 3
MAX_AHEAD = 5.0
"""s: a deadline farther away is a mistake or a clock that is off"""


class Setpoints:
    """Takes setpoints from the key space to the autopilot. Lives on the event loop."""

    def __init__(
        self,
        session: zenoh.Session,
        port: Port,
        identity: Identity,
        leases: Leases,
        events: Events,
        origin: wire.Origin | None,
        guard: Callable[[], None],
    ) -> None:
        self._session, self._port, self._identity = session, port, identity
        self._leases, self._events, self._origin, self._guard = leases, events, origin, guard
        self.counts: collections.Counter[str] = collections.Counter()
        self.busy: Callable[[], bool] = lambda: False
        """an order moves the vehicle: setpoints wait until it has ended, or they would undo a landing just ordered"""
        self._seq = -1
        self._lease = ""
        self._last: float | None = None
        self._subscriber: Any = None
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        key = keys.SETPOINT.key(self._port.fleet, self._port.name, agent="*")
        self._subscriber = self._session.declare_subscriber(key, on_loop(loop, self._on_sample))

    def close(self) -> None:
        """End; a vehicle that follows a stream is told to hold, for nobody will watch over it any more."""
        self._subscriber.undeclare()
        if self._last is not None:
            self._hold(repeats=0)
        self.stop()

    def stop(self) -> None:
        """The stream is over on purpose: an order moves the vehicle now, or it has landed."""
        self._last = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _on_sample(self, sample: zenoh.Sample) -> None:
        agent = str(sample.key_expr).rpartition("/")[2]
        try:
            point = wire.decode(sample.payload.to_bytes(), wire.Setpoint, f"setpoint of {agent}")
            self._fly(point)
        except ZmavError as e:
            why = str(e.detail.get("count", e.code))
            self.counts[why] += 1
            self._events.emit("setpoint", "warning", f"setpoint of {agent} dropped: {e}", limit=f"sp {why}", why=why)

    def _fly(self, point: wire.Setpoint) -> None:
        self._guard()
        self._check_order(point)
        autopilot = self._identity.autopilot
        if autopilot is None or not self._identity.connected or self._identity.source is None:
            raise LinkDown("the autopilot is not heard", count="silent")
        target = resolve(point, self._origin)
        actions = autopilot.setpoint(target)
        if self._identity.mode != autopilot.guided or not self._identity.armed:
            raise Refused(
                f"{'armed' if self._identity.armed else 'disarmed'} in {self._identity.mode}: setpoints are followed "
                f"only armed in {autopilot.guided}",
                count="mode",
            )
        if self.busy():
            raise Refused("an order moves the vehicle: setpoints are followed when it has ended", count="busy")
        if not all(self._send(action) for action in actions if isinstance(action, Message)):
            raise LinkDown("the link to the autopilot is down or full", count="link")
        self._last = time.monotonic()
        if self._timer is None:
            self._watch(HOLD_AFTER)
        self.counts["flown"] += 1

    def _check_order(self, point: wire.Setpoint) -> None:
        try:
            self._leases.require(point.lease)
        except NotHolder as e:
            e.detail["count"] = "lease"
            raise
        if point.lease != self._lease:
            self._lease, self._seq = point.lease, -1
        if point.seq <= self._seq:
            raise BadInput(f"seq {point.seq} after {self._seq}", field="seq", value=point.seq, count="order")
        left = point.deadline - time.time()
        if left < 0:
            late = f"{-left * 1000:.0f} ms after its deadline"
            raise BadInput(late, field="deadline", value=point.deadline, count="late")
        if left > MAX_AHEAD:
            raise BadInput(
                f"its deadline is {left:.1f} s ahead (at most {MAX_AHEAD:.0f}): is a clock off?",
                field="deadline",
                value=point.deadline,
                count="early",
            )
        self._seq = point.seq

    def _send(self, message: Message) -> bool:
        assert self._identity.source is not None
        return self._port.send(message.name, **message.addressed(*self._identity.source))

    def _watch(self, delay: float) -> None:
        self._timer = asyncio.get_running_loop().call_later(delay, self._on_timer)

    def _on_timer(self) -> None:
        """The stream may have ended: hold once it has been silent for HOLD_AFTER."""
        self._timer = None
        if self._last is None:
            return
        silent = time.monotonic() - self._last
        if silent < HOLD_AFTER:
            self._watch(HOLD_AFTER - silent)
            return
        self._last = None
        if self._hold(repeats=HOLD_REPEATS):
            self.counts["held"] += 1
            self._events.emit("setpoint", "warning", f"no setpoint for {HOLD_AFTER} s: holding position")

    def _hold(self, repeats: int) -> bool:
        """Tell the autopilot to stop, and again a little later, for the message has no acknowledgement.

        False where it is not ours to stop: the pilot has it, or it is disarmed.
        """
        autopilot = self._identity.autopilot
        try:
            if autopilot is None or self._identity.mode != autopilot.guided or not self._identity.armed:
                return False
            _, message = autopilot.hold()
        except ZmavError as e:
            self._events.emit("setpoint", "error", f"no setpoint for {HOLD_AFTER} s, and no hold: {e}")
            return False
        if message is None:
            return False
        self._send(message)
        if repeats:
            self._timer = asyncio.get_running_loop().call_later(0.2, self._hold_again, repeats - 1)
        return True

    def _hold_again(self, repeats: int) -> None:
        self._timer = None
        if self._last is not None:
            self._on_timer()  # the stream goes on, and is watched again
        elif not self.busy():
            self._hold(repeats)
