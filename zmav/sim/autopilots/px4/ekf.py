"""PX4's estimator (EKF2): how long it goes on without GPS, when it resets to a solution that it did not believe, and
what ESTIMATOR_STATUS shows.

Gates, noises and times are EKF2_GPS_P_GATE, EKF2_GPS_P_NOISE, EKF2_NOAID_TOUT, EKF2_HDG_GATE and their like at their
defaults. Source: https://docs.px4.io/v1.16/en/advanced_config/tuning_the_ecl_ekf.html, "What should I do if ...".
"""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.navigation import GATE, NavigationFilter
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.sensors.estimate import Belief

WITHOUT_AID_S = 5.0
HEADING_SIGMA, HEADING_GATE, HEADING_FOLLOW_S = 0.3, 2.6, 3.0  # EKF2_HEAD_NOISE rad, EKF2_HDG_GATE
# ESTIMATOR_STATUS_FLAGS
AT_REST, MOVING = 0x3FF, 0x37F
_VELOCITY_HORIZ, _POS_REL, _POS_ABS, _PRED_REL, _PRED_ABS = 2, 8, 16, 256, 512
GPS_GLITCH = 1024


class Ekf2(NavigationFilter[Px4State]):
    """One vehicle's estimator; the heading that follows from the GPS's velocity alone is PX4's EKF-GSF."""

    USUAL: ClassVar[dict[str, float]] = {"velocity": 0.04, "position": 0.02, "height": 0.02, "compass": 0.04}
    POSITION_VARIANCE: ClassVar[float] = 0.3
    HEIGHT_VARIANCE: ClassVar[float] = 4.0
    GROWTH, REACQUIRE_S, RESET_AFTER_S = 0.01, 1.0, 7.0

    def power_on(self) -> None:
        self._good = True
        super().power_on()

    @property
    def good(self) -> bool:
        return self._good

    @property
    def flags(self) -> int:
        """ESTIMATOR_STATUS.flags."""
        flags = MOVING if self._vehicle.armed else AT_REST
        if not self.good:
            flags &= ~(_VELOCITY_HORIZ | _POS_REL | _POS_ABS | _PRED_REL | _PRED_ABS)
        return flags | GPS_GLITCH if self.glitching else flags

    def without_fix(self, belief: Belief) -> None:
        self._good = self._vehicle.now - self._passed <= WITHOUT_AID_S

    @property
    def listens(self) -> bool:
        return self._good

    def position_ratio(self, north: float, east: float) -> float:
        return max(abs(north), abs(east)) / (GATE * math.sqrt(self._variance))

    def judge(self, *, believed: bool) -> None:
        self.glitching = not believed

    def reset(self, belief: Belief) -> None:
        super().reset(belief)
        self._good, self.glitching = True, False

    def watch_compass(self, belief: Belief, dt: float) -> None:
        turn = belief.compass_turn
        if turn != self._turn_seen:
            self._turn_seen, self._by_course, self._shown = turn, False, 0.0
        off = math.remainder(turn - belief.yaw_error, math.tau)
        ratio = 0.0 if self._by_course else abs(off) / (HEADING_GATE * HEADING_SIGMA)
        self.ratios["compass"] = max(ratio, self.USUAL["compass"])
        if belief.compass_lost:
            return
        if ratio < 1.0 and not self._by_course:
            self._follow_compass(belief, dt / HEADING_FOLLOW_S)
        self._watch_course(belief, dt)
