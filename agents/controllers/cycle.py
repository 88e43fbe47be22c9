"""The hot path: the autopilot's attitude in, a cycle to the controller, its output out as a setpoint.

One frame's way: Zenoh's thread calls :meth:`Cycles.on_frame`; an attitude begins a cycle, which goes to the
controller's process; its answer comes in that process's reader thread, is looked at, and is put as a setpoint. No event
loop is on the way. What goes wrong ends the engagement at once, and says so to the event loop.
"""

from __future__ import annotations

import enum
import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np
import zenoh

from agents.controllers import packets
from agents.controllers.estimate import MOST_DT, Estimate
from agents.controllers.guard import Guard, fit
from agents.controllers.packets import Answer
from agents.controllers.references import References
from agents.controllers.settings import usual
from agents.controllers.signals import cycle_signals
from agents.controllers.types import (
    Acceleration,
    AttitudeThrust,
    Output,
    RatesThrust,
    Reference,
    State,
    TorqueThrust,
    Trim,
    Velocity,
)
from agents.controllers.worker import Worker
from zmav.errors import ZmavError
from zmav.mavlink import Dialect, decode, parse_frame
from zmav.vehicle.lease import Lease

logger = logging.getLogger(__name__)
OUTER_VALID = 0.4
"""s that a velocity or an acceleration is flown without the next one; what is within it: ``guard_silent``"""
BURST = 0.5
"""of a cycle, within which two attitudes are told as one"""
CLOCK_STEP = 0.0002
"""s by which the autopilot's clock is set at a time while a controller flies"""
DO_SET_MODE, ACCEPTED = 176, 0
"""MAV_CMD and MAV_RESULT"""


class Phase(enum.IntEnum):
    """Numbers as in a cycle's packet."""

    LOOKING_ON = 0
    """the autopilot flies; the controller follows what it does"""
    IN_FORCE = 1
    ENGAGING = 2
    """its first outputs go out, and the autopilot is yet to follow them"""


class CycleCounters(msgspec.Struct):
    """What became of the cycles since the controller took over last."""

    cycles: int = 0
    late: int = 0
    """that began before the output of the one before had come"""
    outputs: int = 0
    """that went out"""
    clipped: int = 0
    """outputs with a thrust or a torque out of range"""


class Cycles:
    """One vehicle's. ``on_trip(text)`` and ``on_signals(t, values)`` are called from carrying threads."""

    def __init__(self, dialect: Dialect, estimate: Estimate) -> None:
        self._dialect, self.estimate = dialect, estimate
        self.lock = threading.Lock()
        """held while anything here is read or changed"""
        self.limits = usual()
        """by the names of :mod:`agents.controllers.settings`"""
        self.references, self.guard = References(self.limits), Guard(self.limits)
        self.on_trip: Callable[[str], None] = lambda text: None
        self.on_signals: Callable[[float, dict[str, float]], None] = lambda t, values: None
        self.phase = Phase.LOOKING_ON
        self.counters = CycleCounters()
        self.heard = 0.0
        """monotonic s of the last attitude"""
        self.source: tuple[int, int] | None = None
        """system and component of the autopilot: another one's frames may come over the same link"""
        self.tripped = 0.0
        """monotonic s at which the last engagement ended by itself"""
        self.stuck = False
        """the controller's process does not answer any more"""
        self._lease: Lease | None = None
        self._worker: Worker | None = None
        self._busy = False
        self._late = 0
        """cycles in a row"""
        self._number = 0
        self._dt = 0.0
        """s by the autopilot's clock since the controller was asked last"""
        self._begun = 0.0
        """monotonic s at which the controller was asked last"""
        self._told = 0.0
        """monotonic s of the last attitude that was a cycle of its own"""
        self._reference = Reference()
        self._applied: Trim | None = None
        """what the last output asked for: where the next class begins that is loaded in flight"""
        self._said = 0.0
        """monotonic s at which signals are due"""
        self._takers: dict[str, Callable[[Mapping[str, Any]], None]] = {
            "LOCAL_POSITION_NED": estimate.local,
            "GLOBAL_POSITION_INT": estimate.globally,
            "RC_CHANNELS": estimate.sticks,
            "ATTITUDE_TARGET": estimate.target,
            "SERVO_OUTPUT_RAW": estimate.outputs,
            "COMMAND_ACK": self._acknowledged,
        }

    # The event loop, without the lock.

    def fly_by(self, worker: Worker | None) -> None:
        """Whose outputs count from the next cycle on."""
        with self.lock:
            self._worker, self._busy, self._late, self.stuck = worker, False, 0, False

    def engage(self, lease: Lease, height: float) -> None:
        """Send outputs; ``height``: m above home."""
        with self.lock:
            self.guard.begin(self.estimate.state, height)
            self.references.hold(self.estimate.state)  # the first attitude since it is located may be yet to come
            self._lease, self.counters = lease, CycleCounters()
            # What it was asked while it looked on gives no output: nobody waits for that.
            self._busy, self._late, self._applied = False, 0, None
            self.phase = Phase.ENGAGING

    def presume(self) -> None:
        """The autopilot probably follows now: from here on the controller remembers from cycle to cycle."""
        with self.lock:
            if self.phase is Phase.ENGAGING:
                self.phase = Phase.IN_FORCE

    def doubt(self) -> None:
        """It does not after all."""
        with self.lock:
            if self.phase is Phase.IN_FORCE:
                self.phase, self._applied = Phase.ENGAGING, None

    def in_force(self) -> bool:
        """The autopilot follows for certain; False: it has ended already."""
        self.presume()
        return self.phase is Phase.IN_FORCE

    def end(self) -> None:
        """No output goes out any more once this returns."""
        with self.lock:
            self._end()

    def watch(self) -> None:
        """To be called often: the autopilot's state must keep coming."""
        with self.lock:
            silent = time.monotonic() - self.heard
            if self.phase and silent > max(self.limits["guard_silent"], 10.0 * self.estimate.period):
                self._trip(f"no attitude came for {silent * 1e3:.0f} ms")

    def set_clock(self, boot_t: float) -> None:
        """UTC s at which the autopilot's time was zero, as it is known now; to be called often. In flight it is
        only drawn near: where a clock is set, what is followed would jump with it.
        """
        with self.lock:
            if not self.phase:
                self.estimate.boot_t = boot_t
            elif self.estimate.boot_t is not None:
                self.estimate.boot_t += min(max(boot_t - self.estimate.boot_t, -CLOCK_STEP), CLOCK_STEP)

    # Zenoh's thread.

    def on_frame(self, sample: zenoh.Sample) -> None:
        try:
            frame = parse_frame(sample.payload.to_bytes(), self._dialect)
            if (frame.sysid, frame.compid) != self.source:
                return
            name, fields = self._dialect.name_of(frame.msgid), decode(frame, self._dialect)
        except ZmavError as e:
            logger.debug("no frame: %s", e)
            return
        with self.lock:
            try:
                if name != "ATTITUDE_QUATERNION":
                    self._takers[name](fields)
                elif self.estimate.attitude(fields):
                    self._begin()
            except Exception as e:  # a thread of Zenoh's would go on, and the vehicle with it
                logger.exception("a cycle failed")
                if self.phase:
                    self._trip(f"the supervisor failed: {e!r}")

    def _begin(self) -> None:
        self.heard = now = time.monotonic()
        worker, estimate, phase = self._worker, self.estimate, self.phase
        if not estimate.located:
            return
        state = estimate.state
        if not phase:
            self.references.hold(state)
        self._reference = reference = self.references.at(state)
        if phase:
            self.counters.cycles += 1
            why = estimate.blind or self.references.lost(state) or self.guard.check(state, reference)
            if why is not None:
                self._trip(why)
                return
        self._dt += state.dt
        if self._busy or worker is None:
            # Frames come in bursts, of links and where this computer stood still: one close behind another is no cycle
            # of its own, and an answer may still be to be read.
            if now - self._told > BURST * estimate.period:
                self._told = now
                self._overdue()
            return
        state.dt, self._dt = min(self._dt, MOST_DT), 0.0
        self._number = (self._number + 1) & 0xFFFFFFFF
        self._busy, self._begun, self._told = True, now, now
        trim = estimate.trim if self._applied is None else self._applied
        worker.send(packets.pack_cycle(self._number, phase, state, reference, trim))

    def _overdue(self) -> None:
        if not self.phase:
            return
        self.counters.late += 1
        self._late += 1
        if self._late >= round(self.limits["guard_late"]):
            self.stuck = True
            self._trip(f"no output for {self._late} cycles")

    def _acknowledged(self, fields: Mapping[str, Any]) -> None:
        """COMMAND_ACK: a mode that is granted is entered with it. A HEARTBEAT tells of it only later, and a controller
        of torques that began again with each cycle would tumble until then.
        """
        if fields["command"] == DO_SET_MODE and fields["result"] == ACCEPTED and self.phase is Phase.ENGAGING:
            self.phase = Phase.IN_FORCE

    # A worker's thread.

    def on_answer(self, worker: Worker, answer: Answer) -> None:
        with self.lock:
            if worker is not self._worker or answer.number != self._number:
                return
            self._busy, self._late = False, 0
            if answer.output is None or not self.phase:
                return
            why, clipped = fit(answer.output)
            self.counters.clipped += clipped
            if why is not None:
                self._trip(why)
                return
            self._put(answer.output)
            self.counters.outputs += 1
            now = time.monotonic()
            if self.phase is Phase.IN_FORCE:
                self._applied = _applied(answer.output, self.estimate.state)
            self._stream(worker, answer.output, answer.signals, now)

    def on_failed(self, worker: Worker, text: str) -> None:
        with self.lock:
            if worker is self._worker:
                self._busy = False
                if self.phase:
                    self._trip(text)

    def _put(self, output: Output) -> None:
        assert self._lease is not None
        try:
            self._lease.setpoint(**setpoint(output, self.limits["guard_silent"]))
        except ZmavError as e:
            self._trip(str(e))

    def _trip(self, text: str) -> None:
        self.tripped = time.monotonic()
        self._end()
        self.on_trip(text)

    def _end(self) -> None:
        self.phase, self._lease, self._applied = Phase.LOOKING_ON, None, None

    def _stream(self, worker: Worker, output: Output, signals: tuple[float, ...], now: float) -> None:
        if now < self._said:
            return
        # Cycles come when they come: the next due time, not the time since, keeps the rate on average.
        period = 1.0 / self.limits["signals_hz"]
        self._said = max(self._said + period, now - period)
        values = cycle_signals(self.estimate.state, self._reference, output)
        values.update(zip(worker.names, signals, strict=False))
        values["inject"] = self.references.injected
        values["took_us"], values["late"] = (now - self._begun) * 1e6, float(self.counters.late)
        self.on_signals(self.estimate.state.t, values)


def setpoint(output: Output, valid: float) -> dict[str, Any]:
    """As :meth:`zmav.vehicle.lease.Lease.setpoint` takes it; ``valid``: s for which an inner loop's is flown."""
    inner = not isinstance(output, Velocity | Acceleration)
    found: dict[str, Any] = {"valid": valid if inner else OUTER_VALID}
    for name, value in vars(output).items():
        if not (inner and name == "yaw_rate"):  # no autopilot takes it beside an attitude
            found[name] = tuple(float(each) for each in value) if isinstance(value, np.ndarray) else value
    return found


def _applied(output: Output, state: State) -> Trim | None:
    """Where another class begins that takes over from this one; None: what the autopilot says that it does."""
    if isinstance(output, AttitudeThrust):
        return Trim(output.thrust, output.attitude, state.rates)
    if isinstance(output, RatesThrust):
        return Trim(output.thrust, state.q, output.rates)
    return Trim(output.thrust, state.q, state.rates) if isinstance(output, TorqueThrust) else None
