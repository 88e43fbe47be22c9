"""From the autopilot's own messages to a controller's state, and to what the autopilot does by itself.

ATTITUDE_QUATERNION sets the pace; the others are the newest there are. Positions are turned from those about the
estimator's own origin to those about the fleet's by GLOBAL_POSITION_INT.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.controllers.types import MOTORS, Array, State, Trim
from zmav import geo, wire
from zmav.errors import BadConfig

RATES_HZ: Mapping[str, float] = {
    "ATTITUDE_QUATERNION": 0.0,
    "LOCAL_POSITION_NED": 0.0,
    "GLOBAL_POSITION_INT": 5.0,
    "RC_CHANNELS": 50.0,
    "ATTITUDE_TARGET": 25.0,
    "SERVO_OUTPUT_RAW": 25.0,
    "HEARTBEAT": 10.0,
}
"""what is wanted of the autopilot; 0: as often as there are cycles. Of a mode that has changed a HEARTBEAT tells"""
HEARD = (*(name for name in RATES_HZ if name != "HEARTBEAT"), "COMMAND_ACK")
"""what is read here: of HEARTBEATs the vehicle's own agent tells"""
MOST_DT = 0.1
"""s: after a longer silence a controller is not asked to make up for it"""
ROUNDED = 0.0015
"""s by which a time in whole milliseconds can make one cycle look longer or shorter"""
BLIND, DEAF = 0.5, 1.0
"""s by the autopilot's clock without a position, or the pilot's sticks, after which the last ones are of no use"""
SHARE = 0.02
"""of the newest cycle's time in the mean"""
BESIDE = 0.2
"""s that a local position may be older or newer than the global one that it is held against"""
MOVED = 1.0
"""m by which the estimator's origin has moved, and was not only measured badly"""
PWM_MID, PWM_HALF, PWM_LOW, PWM_SPAN = 1500.0, 500.0, 1000.0, 1000.0
UNHEARD = (0, 65535)
CHANNELS = 18
DRIVEN = 950
"""µs from which an output drives a motor: idle ones are below"""


class Estimate:
    """One vehicle's. Not thread-safe: its user sees to that. ``channels``: of the pilot's roll, pitch, throttle and
    yaw. Raises :class:`~zmav.errors.BadConfig` for channels that there are not.
    """

    def __init__(self, channels: tuple[int, ...]) -> None:
        if not all(1 <= channel <= CHANNELS for channel in channels):
            text = f"rc = {list(channels)}: RC_CHANNELS has channels 1 to {CHANNELS}"
            raise BadConfig(text, field="rc", value=list(channels), expected=f"1 to {CHANNELS}")
        self._channels = channels
        self._anchor: tuple[wire.Origin, wire.Vector] | None = None
        self.state, self.trim = State(), Trim()
        self.period = 0.0
        """s from cycle to cycle, by the autopilot's clock"""
        self.boot_t: float | None = None
        """UTC s at which the autopilot's time was zero"""
        self.located = False
        """position and velocity are known"""
        self.cycles = 0
        self._boot_ms = -1
        self._sticks_ms = -1
        self._shift: Array | None = None
        self._shifts: deque[Array] = deque(maxlen=10)
        self._places: deque[tuple[int, Array, Array]] = deque(maxlen=50)

    def anchor(self, place: wire.GlobalPosition, local: wire.Vector) -> None:
        """One place in both frames, by the vehicle's own state; without it, positions stay about the estimator's."""
        if self._anchor is None:
            about = wire.Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_amsl=place.alt_amsl)
            self._anchor = about, local

    @property
    def ready(self) -> bool:
        """All that a controller needs is there."""
        placed = self._shift is not None or self._anchor is None
        return self.located and self.cycles > 1 and placed and self.blind is None

    @property
    def blind(self) -> str | None:
        """Attitudes come, and positions do not any more; None: they do."""
        silent = (self._boot_ms - self._places[-1][0]) / 1e3 if self._places else 0.0
        return f"no position came for {silent * 1e3:.0f} ms" if silent > BLIND else None

    def attitude(self, f: Mapping[str, Any]) -> bool:
        """ATTITUDE_QUATERNION; False: one that has come before, or the autopilot has started again."""
        ms = int(f["time_boot_ms"])
        step = (ms - self._boot_ms) / 1e3
        self._boot_ms = ms
        if step <= 0.0:
            return False
        s = self.state
        usual = min(step, MOST_DT)  # a silence, or a clock that was set, is no cycle's length
        self.period += SHARE * (usual - self.period) if self.cycles > 1 else usual - self.period
        # Times come in whole milliseconds: where that explains it, every cycle is as long as the mean.
        s.dt = self.period if abs(step - self.period) < ROUNDED else min(step, MOST_DT)
        s.t = ms / 1e3 + (self.boot_t or 0.0)
        s.q = np.array((f["q1"], f["q2"], f["q3"], f["q4"]))
        s.rates = np.array((f["rollspeed"], f["pitchspeed"], f["yawspeed"]))
        if ms - self._sticks_ms > DEAF * 1e3:
            s.sticks = _unheard()
        self.cycles += 1
        return True

    def local(self, f: Mapping[str, Any]) -> None:
        """LOCAL_POSITION_NED."""
        pos, vel = np.array((f["x"], f["y"], f["z"])), np.array((f["vx"], f["vy"], f["vz"]))
        self._places.append((int(f["time_boot_ms"]), pos, vel))
        self.state.pos = pos if self._shift is None else pos + self._shift
        self.state.vel = vel
        self.located = True

    def globally(self, f: Mapping[str, Any]) -> None:
        """GLOBAL_POSITION_INT: where the estimator's origin lies in the fleet's frame."""
        if self._anchor is None or not self._places:
            return
        about, local = self._anchor
        ms = int(f["time_boot_ms"])
        at, pos, vel = min(self._places, key=lambda place: abs(place[0] - ms))
        if abs(ms - at) > BESIDE * 1e3:
            return  # the links brought one of them late: the vehicle was elsewhere
        here = np.array(geo.in_fleet_frame(about, local, f))
        shift = here - (pos + vel * ((ms - at) / 1e3))
        if self._shift is not None and float(np.abs(shift - self._shift).max()) > MOVED:
            self._shifts.clear()
        self._shifts.append(shift)
        self._shift = np.mean(self._shifts, axis=0)
        self.state.pos = self._places[-1][1] + self._shift

    def sticks(self, f: Mapping[str, Any]) -> None:
        """RC_CHANNELS."""
        raw = [int(f[f"chan{channel}_raw"]) for channel in self._channels]
        self._sticks_ms = int(f["time_boot_ms"])
        if any(pwm in UNHEARD for pwm in raw):
            self.state.sticks = _unheard()
            return
        roll, pitch, throttle, yaw = raw
        # A pitch stick pulled back gives more, and brings the nose up.
        self.state.sticks = np.array([_centred(roll), _centred(pitch), _from_low(throttle), _centred(yaw)])

    def target(self, f: Mapping[str, Any]) -> None:
        """ATTITUDE_TARGET: what the autopilot's own loops ask for."""
        q = np.array(f["q"])
        rates = np.array((f["body_roll_rate"], f["body_pitch_rate"], f["body_yaw_rate"]))
        if math.isfinite(float(q.sum())) and math.isfinite(f["thrust"]) and f["thrust"] > 0.0:
            self.trim = Trim(float(f["thrust"]), q, np.nan_to_num(rates))

    def outputs(self, f: Mapping[str, Any]) -> None:
        """SERVO_OUTPUT_RAW: the motors, as far as the first outputs are motors."""
        raw = [int(f[f"servo{i + 1}_raw"]) for i in range(MOTORS)]
        driven = [pwm for pwm in raw if DRIVEN <= pwm < UNHEARD[1]]
        self.state.motors = np.clip((np.array(driven) - PWM_LOW) / PWM_SPAN, 0.0, 1.0) if driven else None


def _unheard() -> Array:
    return np.array([0.0, 0.0, math.nan, 0.0])


def _centred(pwm: int) -> float:
    return min(max((pwm - PWM_MID) / PWM_HALF, -1.0), 1.0)


def _from_low(pwm: int) -> float:
    return min(max((pwm - PWM_LOW) / PWM_SPAN, 0.0), 1.0)
