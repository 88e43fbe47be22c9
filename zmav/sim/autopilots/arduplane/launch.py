"""How an ArduPlane takes off by itself: the wait for its moment, the climb with full power, and the level-off.

https://ardupilot.org/plane/docs/automatic-takeoff.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.control.planetargets import Stage

if TYPE_CHECKING:
    from zmav.sim.autopilots.arduplane.plane import ArduPlane

_WARNING, _INFO = 4, 6
QUIET_S = 2.0  # between two reports
BAD_PITCH, BAD_ROLL = (math.radians(-30.0), math.radians(45.0)), math.radians(30.0)
LEVEL_OFF_FROM_M = 10.0


class Launch:
    """A take-off from ``ground`` (m over the world's origin) to ``height`` metres over it."""

    def __init__(self, plane: ArduPlane) -> None:
        self._plane = plane
        self.reset()

    def reset(self) -> None:
        """As after disarming."""
        self.ground = -self._plane.sense.down
        self.height = 0.0
        self.pitch = 0.0
        self._counting: float | None = None
        self._reported = -QUIET_S
        self._level_off: float | None = None

    def begin(self, height: float, pitch: float) -> None:
        """``pitch``: of the climb, rad."""
        self.height, self.pitch, self._level_off = height, pitch, None
        self.ground = -self._plane.sense.down

    def released(self) -> bool:
        """Whether it may give power now: enough acceleration (TKOFF_THR_MINACC), a moment, and enough speed."""
        plane, params, s = self._plane, self._plane.params, self._plane.sense
        if not plane.armed or not plane.gps_ok:
            self._counting = None
            return False
        forward = s.fx - 9.81 * math.sin(s.pitch)
        wait = min(max(params["TKOFF_THR_DELAY"] * 0.1, 0.0), 12.7)
        if self._counting is None:
            if params["TKOFF_THR_MINACC"] > 0 and forward < params["TKOFF_THR_MINACC"]:
                return False
            self._counting = plane.now
            self._report(_INFO, f"Armed AUTO, xaccel = {forward:.1f} m/s/s, waiting {wait:.1f} sec")
        waited = plane.now - self._counting
        if waited > wait + 0.1:
            self._counting = None
            self._report(_WARNING, "Timeout AUTO")
            return False
        if not BAD_PITCH[0] < s.pitch < BAD_PITCH[1] or abs(s.roll) > BAD_ROLL:
            self._counting = None
            plane.say(_WARNING, "Bad launch AUTO")
            return False
        least = params["TKOFF_THR_MINSPD"]
        if waited < wait - 1e-6 or (least > 0 and plane.groundspeed <= least):
            return False
        plane.say(_INFO, f"Triggered AUTO. GPS speed = {plane.groundspeed:.1f}")
        self._counting, self.ground = None, -s.down
        return True

    def _report(self, severity: int, text: str) -> None:
        if self._plane.now - self._reported > QUIET_S:
            self._reported = self._plane.now
            self._plane.say(severity, text)

    @property
    def climbed(self) -> float:
        """Metres over where it started."""
        return -self._plane.sense.down - self.ground

    def climb(self, height: float) -> None:
        """Set this moment's pitch, power and bank limit; ``height``: to reach, m over the world's origin."""
        plane, params = self._plane, self._plane.params
        full = params["TKOFF_THR_MAX"] or params["THR_MAX"]
        lowest = self._least_pitch(height)
        airspeed = plane.eas
        rotate = params["TKOFF_ROTATE_SPD"]
        if rotate > 0 and plane.fastest < rotate:
            plane.sp.pitch(math.radians(params["TKOFF_GND_PITCH"]))
            plane.sp.power(full * 0.01)
        else:
            if rotate > 0 and airspeed < params["AIRSPEED_CRUISE"]:
                share = plane.groundspeed / max(params["AIRSPEED_CRUISE"], 1.0)
                lowest = min(max(lowest * share, math.radians(5.0)), max(lowest, math.radians(5.0)))
            plane.fly_height(height, plane.cruise, Stage.TAKEOFF)
        plane.limit(roll=self._most_roll(), pitch_min=lowest, throttle=(full * 0.01, full * 0.01))

    def _least_pitch(self, height: float) -> float:
        """The climb's, and near the top less and less (TKOFF_PLIM_SEC)."""
        plane = self._plane
        left, climbing = height + plane.sense.down, -plane.sense.vd
        seconds = plane.params["TKOFF_PLIM_SEC"]
        near = climbing > 0.1 and 0 < left / climbing <= seconds and plane.height >= LEVEL_OFF_FROM_M
        if self._level_off is None and near:
            plane.say(_INFO, f"Takeoff level-off starting at {int(left)}m")
            self._level_off = max(left, 0.1)
        if self._level_off is not None:
            return self.pitch * min(max(left / self._level_off, 0.0), 1.0)
        return self.pitch

    def _most_roll(self) -> float:
        """Hardly any near the ground; all of it from three times TKOFF_LVL_ALT on."""
        params = self._plane.params
        low = max(params["TKOFF_LVL_ALT"], 0.0)
        high = max(min(3.0 * low, params["TKOFF_ALT"]), low + 1.0)
        share = min(max((self.climbed - low) / (high - low), 0.0), 1.0)
        few, most = params["LEVEL_ROLL_LIMIT"], params["ROLL_LIMIT_DEG"]
        return math.radians(few + (most - few) * share)
