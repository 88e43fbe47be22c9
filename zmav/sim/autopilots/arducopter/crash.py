"""ArduCopter's crash check (FS_CRASH_CHECK): who leans far from where it wants to, and hardly moves, has crashed.

https://ardupilot.org/copter/docs/crash_check.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.dynamics.airframe import GRAVITY

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

AFTER_S, ANGLE_ERROR_DEG, LEAN_DEG, SPEED_MAX, ACCEL_MAX = 2.0, 30.0, 15.0, 10.0, 3.0
FILTER_S = 1.0 / (2.0 * math.pi)  # of the acceleration: 1 Hz
_EMERGENCY = 0


class CrashCheck:
    """Called ten times a second."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self._lasting = 0.0
        self._accel = 0.0

    def update(self, dt: float) -> None:
        copter, s = self._copter, self._copter.sense
        self._accel += (self._felt() - self._accel) * min(dt / FILTER_S, 1.0)
        if not copter.armed or copter.landed or not copter.params["FS_CRASH_CHECK"]:
            self._lasting = 0.0
            return
        off = self.off_deg
        lean = math.degrees(math.acos(min(max(math.cos(s.roll) * math.cos(s.pitch), -1.0), 1.0)))
        speed = math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd)
        crashed = self._accel < ACCEL_MAX and lean > LEAN_DEG and off > ANGLE_ERROR_DEG and speed < SPEED_MAX
        self._lasting = self._lasting + dt if crashed else 0.0
        if self._lasting >= AFTER_S - 1e-9:
            copter.say(
                _EMERGENCY,
                f"Crash: Disarming: AngErr={off:.0f}>{ANGLE_ERROR_DEG:.0f}, Accel={self._accel:.1f}<{ACCEL_MAX:.1f}",
            )
            copter.disarm(forced=True)

    @property
    def off_deg(self) -> float:
        """Between the thrust's direction and the one asked for; the heading does not count."""
        s = self._copter.sense
        is_down = _down(s.qw, s.qx, s.qy, s.qz)
        want_down = _down(s.want_qw, s.want_qx, s.want_qy, s.want_qz)
        dot = sum(a * b for a, b in zip(is_down, want_down, strict=True))
        return math.degrees(math.acos(min(max(dot, -1.0), 1.0)))

    def _felt(self) -> float:
        """Acceleration over the ground, m/s^2: what the accelerometers feel but for gravity."""
        s = self._copter.sense
        w, x, y, z = s.qw, s.qx, s.qy, s.qz
        # Gravity in body axes: the last row of the attitude's matrix.
        gx, gy, gz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        return math.sqrt((s.fx + GRAVITY * gx) ** 2 + (s.fy + GRAVITY * gy) ** 2 + (s.fz + GRAVITY * gz) ** 2)


def _down(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The body's down axis in the world: the last column of the attitude's matrix."""
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
