"""How an ArduPlane takes off by itself: the wait for its moment, the climb with full power, and the level-off.

https://ardupilot.org/plane/docs/automatic-takeoff.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.state import INFO
from zmav.sim.autopilots.arduplane.base import PlaneBase
from zmav.sim.control.planetargets import Stage

LEVEL_OFF_FROM_M = 10.0


class Launch:
    """A take-off from ``ground`` (m over the world's origin)."""

    def __init__(self, plane: PlaneBase) -> None:
        self._plane = plane
        self.reset()

    def reset(self) -> None:
        """As after disarming."""
        self.ground = -self._plane.sense.down
        self.pitch = 0.0
        self._counting: float | None = None
        self._level_off: float | None = None

    def begin(self, pitch: float) -> None:
        """``pitch``: of the climb, rad."""
        self.pitch, self._level_off = pitch, None
        self.ground = -self._plane.sense.down

    def released(self) -> bool:
        """Whether it may give power now, after a moment (TKOFF_THR_DELAY)."""
        plane, s = self._plane, self._plane.sense
        if not plane.armed or not plane.gps_ok:
            self._counting = None
            return False
        wait = min(max(plane.params["TKOFF_THR_DELAY"] * 0.1, 0.0), 12.7)
        if self._counting is None:
            self._counting = plane.now
            forward = s.fx - 9.81 * math.sin(s.pitch)
            plane.say(INFO, f"Armed AUTO, xaccel = {forward:.1f} m/s/s, waiting {wait:.1f} sec")
        if plane.now - self._counting < wait - 1e-6:
            return False
        plane.say(INFO, f"Triggered AUTO. GPS speed = {plane.groundspeed:.1f}")
        self._counting, self.ground = None, -s.down
        return True

    @property
    def climbed(self) -> float:
        """Metres over where it started."""
        return -self._plane.sense.down - self.ground

    def climb(self, height: float) -> None:
        """Set this moment's pitch, power and bank limit; ``height``: to reach, m over the world's origin."""
        plane, params = self._plane, self._plane.params
        full = params["TKOFF_THR_MAX"] or params["THR_MAX"]
        lowest = self._least_pitch(height)
        plane.fly_height(height, plane.cruise, Stage.TAKEOFF)
        plane.limit(roll=self._most_roll(), pitch_min=lowest, throttle=(full * 0.01, full * 0.01))

    def _least_pitch(self, height: float) -> float:
        """The climb's, and near the top less and less (TKOFF_PLIM_SEC)."""
        plane = self._plane
        left, climbing = height + plane.sense.down, -plane.sense.vd
        seconds = plane.params["TKOFF_PLIM_SEC"]
        near = climbing > 0.1 and 0 < left / climbing <= seconds and plane.height >= LEVEL_OFF_FROM_M
        if self._level_off is None and near:
            plane.say(INFO, f"Takeoff level-off starting at {int(left)}m")
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
