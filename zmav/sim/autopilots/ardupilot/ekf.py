"""ArduPilot's navigation filter (EKF3): for how long it goes on without a sensor, what it says, and what
EKF_STATUS_REPORT shows.

Gates, noises and times are EK3_POS_I_GATE, EK3_POSNE_M_NSE, EK3_GLITCH_RAD and their like at their defaults, and the
sequences follow a real ArduCopter with each sensor failing in flight. Source: https://ardupilot.org/copter/docs/common-
apm-navigation-extended-kalman-filter-overview.html
"""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.boot import Flag
from zmav.sim.autopilots.ardupilot.state import CRITICAL, INFO, WARNING, VehicleState
from zmav.sim.autopilots.navigation import GATE, NavigationFilter
from zmav.sim.sensors.estimate import Belief

RETRY_WITH_VELOCITY_S, RETRY_S, TILT_DRIFT_S = 10.0, 7.0, 15.0
DOUBT_AFTER_S, TRUST_AFTER_S = 1.1, 10.0  # innovations out of their gate; within
# Compass: its test ratio per gauss that it disagrees, how fast the heading follows it while that is below 1, how fast
# the filter learns the disagreement away, and how long it waits for a compass that it does not believe.
MAG_PER_GAUSS, MAG_FOLLOW_S, MAG_LEARN_S, MAG_RETRY_S = 5.2, 4.0, 14.0, 10.0


class Ekf3(NavigationFilter[VehicleState]):
    """One vehicle's filter."""

    USUAL: ClassVar[dict[str, float]] = {"velocity": 0.008, "position": 0.004, "height": 0.0005, "compass": 0.011}
    POSITION_VARIANCE: ClassVar[float] = 0.28
    HEIGHT_VARIANCE: ClassVar[float] = 4.1
    HEIGHT_RETRY_S: ClassVar[float] = 10.0
    GROWTH, REACQUIRE_S, RESET_AFTER_S = 0.0172, 0.5, RETRY_WITH_VELOCITY_S + 0.2  # the next solution comes then

    def power_on(self) -> None:
        now = self._vehicle.now
        self._vel_passed = now
        self._failing_since: float | None = None
        self._good_since: float | None = None
        self._lane = 0
        self._compass_off = 0.0  # how far the compass disagrees, as the filter sees it
        self._heading_taken = 0.0  # of that, what it has believed
        self._mag_passed = now
        self._aiding = True
        self.position_timeout = False
        super().power_on()

    # ---- what it knows

    @property
    def good(self) -> bool:
        return self.aiding and not self.position_timeout

    @property
    def aiding(self) -> bool:
        return self._aiding

    @property
    def started(self) -> bool:
        return self._vehicle.boot.has("position")

    @property
    def flags(self) -> Flag:
        """EKF_STATUS_REPORT.flags of a filter that has had a position."""
        flags = Flag.ATTITUDE | Flag.VELOCITY_VERT | Flag.POS_VERT_ABS
        if self._height_lost:
            flags &= ~Flag.POS_VERT_ABS
        if not self.aiding:
            return flags | Flag.VELOCITY_HORIZ | Flag.CONST_POS_MODE
        if self._velocity_aided:
            flags |= Flag.VELOCITY_HORIZ
        if not self.position_timeout:
            flags |= Flag.POS_HORIZ_REL | Flag.POS_HORIZ_ABS | Flag.PRED_POS_HORIZ_REL | Flag.PRED_POS_HORIZ_ABS
        return flags | Flag.GPS_GLITCHING if self.glitching else flags

    @property
    def threshold(self) -> float:
        """FS_EKF_THRESH; 0 for a kind that has none."""
        params = self._vehicle.params
        return params["FS_EKF_THRESH"] if "FS_EKF_THRESH" in params else 0.0  # noqa: SIM401 - it is no dict

    @property
    def beyond(self) -> bool:
        """Two of compass, velocity and position are beyond FS_EKF_THRESH, or velocity alone by twice that."""
        limit = self.threshold
        if limit <= 0:
            return False
        velocity = self.ratios["velocity"]
        count = (self.ratios["compass"] >= limit) + (velocity >= limit) + (velocity >= 2.0 * limit)
        return count + (self.ratios["position"] >= limit and count > 0) >= 2

    @property
    def _velocity_aided(self) -> bool:
        return not self._leading or self._vehicle.now - self._vel_passed <= RETRY_S

    @property
    def _height_lost(self) -> bool:
        return self._leading and self._vehicle.now - self._height_passed > self.HEIGHT_RETRY_S

    def begin(self) -> None:
        self._vel_passed = self._good_since = self._vehicle.now

    def recovered(self, belief: Belief) -> bool:
        return super().recovered(belief) and self._compass_off < 0.005

    # ---- GPS

    def watch_gps(self, belief: Belief, dt: float) -> None:
        if belief.has_fix and self.aiding:
            if self.position_timeout and not self._velocity_aided:
                self.reset(belief)  # nothing else holds it: the first solution does
                return
            self._vel_passed = self._vehicle.now
        super().watch_gps(belief, dt)

    @property
    def listens(self) -> bool:
        return self.aiding

    def position_ratio(self, north: float, east: float) -> float:
        return math.sqrt((north * north + east * east) / (GATE * GATE * 2.0 * self._variance))

    def judge(self, *, believed: bool) -> None:
        now = self._vehicle.now
        if not believed:
            self._doubt(now)
            return
        self.position_timeout = False
        self._failing_since = None
        self._good_since = now if self._good_since is None else self._good_since
        if self.glitching and now - self._good_since >= TRUST_AFTER_S:
            self.glitching = False
            self._vehicle.reactions.gps_glitched(False)

    def _doubt(self, now: float) -> None:
        self._good_since = None
        if self._failing_since is None:
            self._failing_since = now
            self._switch_lane()
        if not self.glitching and now - self._failing_since >= DOUBT_AFTER_S:
            self.glitching = True
            self._vehicle.reactions.gps_glitched(True)
        self.position_timeout |= now - self._passed > RETRY_WITH_VELOCITY_S

    def reset(self, belief: Belief) -> None:
        super().reset(belief)
        self._vel_passed = self._vehicle.now
        self.position_timeout = False
        if self.aiding:
            self._failing_since = None
            self._switch_lane()
        else:
            self._aiding = True
            self._say_both("is using GPS", INFO)

    def _switch_lane(self) -> None:
        """The other of the two filters is taken, because it doubts less."""
        self._lane = 1 - self._lane
        self._vehicle.say(CRITICAL, f"EKF3 lane switch {self._lane}")
        self._vehicle.reactions.lane_switched(self._lane)

    def drift(self) -> tuple[float, float]:
        """Another way each time, the same in every run."""
        heading = 2.399963 * (int(self._passed * 10.0) % 97)
        return math.cos(heading), math.sin(heading)

    def without_fix(self, belief: Belief) -> None:
        now = self._vehicle.now
        if self.aiding and now - self._passed > RETRY_S:
            self.position_timeout = True
        if self.aiding and now - self._passed > TILT_DRIFT_S:
            self._aiding = False
            self.glitching = False
            belief.slide(0.0, 0.0)
            self.ratios["position"] = self.ratios["velocity"] = 0.0
            self._say_both("stopped aiding", WARNING)

    def _say_both(self, text: str, severity: int) -> None:
        for lane in (0, 1):
            self._vehicle.say(severity, f"EKF3 IMU{lane} {text}")

    # ---- compass

    def watch_compass(self, belief: Belief, dt: float) -> None:
        turn, now = belief.compass_turn, self._vehicle.now
        if turn != self._turn_seen:
            self._compass_off = min(abs(math.remainder(turn - self._heading_taken, math.tau)), math.pi)
            self._turn_seen, self._by_course = turn, False
            self._shown, self._mag_passed = 0.0, now
        ratio = MAG_PER_GAUSS * belief.level_field * 2.0 * math.sin(self._compass_off / 2.0)
        self.ratios["compass"] = max(ratio, self.USUAL["compass"])
        if belief.compass_lost:
            return  # the gyroscopes carry the heading on
        if ratio < 1.0:
            self._mag_passed = now
            self._compass_off *= math.exp(-dt / MAG_LEARN_S)
            if not self._by_course:
                self._heading_taken = turn
                self._follow_compass(belief, dt / MAG_FOLLOW_S)
        elif now - self._mag_passed > MAG_RETRY_S:
            self._mag_passed = now
            for other in (1, 0):
                self._say_both(f"switching to compass {other}", INFO)
        self._watch_course(belief, dt)

    def course_taken(self) -> None:
        self._switch_lane()
