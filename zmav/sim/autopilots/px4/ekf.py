"""PX4's estimator (EKF2) as its commander and a ground station see it: how long it goes on without GPS, when it resets
to a solution that it did not believe, and what ESTIMATOR_STATUS shows.

Gates, noises and times are EKF2_GPS_P_GATE, EKF2_GPS_P_NOISE, EKF2_NOAID_TOUT, EKF2_HDG_GATE and their like at their
defaults. Source: https://docs.px4.io/v1.16/en/advanced_config/tuning_the_ecl_ekf.html, "What should I do if ...".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.sensors.estimate import Belief

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

GATE = 5.0  # standard deviations
POSITION_VARIANCE, GROWTH = 0.3, 0.01  # m^2 of a GPS innovation per axis; m^2/s without fusion
HEIGHT_VARIANCE = 4.0
RESET_AFTER_S = 7.0  # of solutions that are not believed
WITHOUT_AID_S = 5.0
REACQUIRE_S = 1.0
DEAD_RECKONING = 0.02  # m/s^2 that a tilt error of a tenth of a degree makes
HEADING_SIGMA, HEADING_GATE, HEADING_FOLLOW_S = 0.3, 2.6, 3.0  # EKF2_HEAD_NOISE rad, EKF2_HDG_GATE
TURNED_ENOUGH, SHOWN_MPS = 0.5, 6.0  # rad of error that flying can show; the speed gained the wrong way until it has
# ESTIMATOR_STATUS_FLAGS
AT_REST, MOVING = 0x3FF, 0x37F
_VELOCITY_HORIZ, _POS_REL, _POS_ABS, _PRED_REL, _PRED_ABS = 2, 8, 16, 256, 512
GPS_GLITCH = 1024
_USUAL = {"velocity": 0.04, "position": 0.02, "height": 0.02, "compass": 0.04}


class Ekf2:
    """One vehicle's estimator. :meth:`update` is called ten times a second."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self._belief: Belief | None = None
        self.power_on()

    def attach(self, belief: Belief) -> None:
        """Steer the estimate of the body that the autopilot sits in."""
        self._belief = belief

    def power_on(self) -> None:
        """Start from nothing."""
        self._leading = False
        self._passed = self._back_at = self._copter.now
        self._had_fix = True
        self._slip = 0.0
        self._shown = 0.0
        self._variance = POSITION_VARIANCE
        self._by_course = False
        self._turn_seen = 0.0
        self.good = True
        self.glitching = False
        self.ratios = dict(_USUAL)
        if self._belief is not None and self._belief.led:
            self._belief.forget()

    # ---- what it knows

    @property
    def has_fix(self) -> bool:
        """The GPS has a solution."""
        return self._belief is None or self._belief.has_fix

    @property
    def flags(self) -> int:
        """ESTIMATOR_STATUS.flags."""
        flags = MOVING if self._copter.armed else AT_REST
        if not self.good:
            flags &= ~(_VELOCITY_HORIZ | _POS_REL | _POS_ABS | _PRED_REL | _PRED_ABS)
        return flags | GPS_GLITCH if self.glitching else flags

    # ---- ten times a second

    def update(self, dt: float) -> None:
        belief = self._belief
        if belief is None or not (belief.troubled or self._leading):
            return
        if not self._leading:
            self._leading = True
            self._passed = self._copter.now
            belief.lead(True)
        self._watch_gps(belief, dt)
        self._watch_heading(belief, dt)
        self._watch_height(belief)
        if not belief.troubled and self.good and not self.glitching and self._close(belief):
            self._leading = False
            belief.lead(False)

    @staticmethod
    def _close(belief: Belief) -> bool:
        return max(map(abs, belief.innovation)) < 0.05 and abs(belief.yaw_error) < 0.005

    def _watch_gps(self, belief: Belief, dt: float) -> None:
        now = self._copter.now
        if not belief.has_fix:
            self._had_fix = False
            belief.follow(False)
            self._slip += DEAD_RECKONING * dt
            belief.slide(self._slip, 0.5 * self._slip)
            self.good = now - self._passed <= WITHOUT_AID_S
            return
        if not self._had_fix:
            self._had_fix, self._back_at = True, now
        if not self.good:
            if now - self._back_at >= REACQUIRE_S:
                self._reset(belief)
            return
        north, east, _ = belief.innovation
        ratio = max(abs(north), abs(east)) / (GATE * math.sqrt(self._variance))
        self._slip = 0.0
        belief.slide(0.0, 0.0)
        self.ratios["position"] = max(ratio, _USUAL["position"])
        self.glitching = ratio >= 1.0
        if not self.glitching:
            self._passed, self._variance = now, POSITION_VARIANCE
            belief.follow(True)
            return
        belief.follow(False)
        self._variance += GROWTH * dt
        if now - self._passed > RESET_AFTER_S:
            self._reset(belief)

    def _reset(self, belief: Belief) -> None:
        """Take the GPS's place and speed for true."""
        belief.reset_position()
        self.good, self.glitching, self._slip = True, False, 0.0
        self._passed, self._variance = self._copter.now, POSITION_VARIANCE
        self.ratios["position"] = _USUAL["position"]

    def _watch_heading(self, belief: Belief, dt: float) -> None:
        turn = belief.compass_turn
        if turn != self._turn_seen:
            self._turn_seen, self._by_course, self._shown = turn, False, 0.0
        off = math.remainder(turn - belief.yaw_error, math.tau)
        ratio = 0.0 if self._by_course else abs(off) / (HEADING_GATE * HEADING_SIGMA)
        self.ratios["compass"] = max(ratio, _USUAL["compass"])
        if belief.compass_lost:
            return
        if ratio < 1.0 and not self._by_course:
            error = belief.yaw_error + off * min(dt / HEADING_FOLLOW_S, 1.0)
            if error != belief.yaw_error:
                belief.turn(0.0 if abs(error) < 1e-4 and turn == 0.0 else error)
        self._watch_course(belief, dt)

    def _watch_course(self, belief: Belief, dt: float) -> None:
        """The heading that follows from the GPS's velocity alone (EKF-GSF): the emergency reset of the yaw."""
        sense, error = self._copter.sense, belief.yaw_error
        astray = math.hypot(sense.roll, sense.pitch) * 9.81 * abs(2.0 * math.sin(error / 2.0))
        if belief.has_fix:
            wanted = _USUAL["velocity"] + 0.35 * astray
            self.ratios["velocity"] += (wanted - self.ratios["velocity"]) * min(dt, 1.0)
        if self._copter.armed and abs(error) > TURNED_ENOUGH:
            self._shown += astray * dt
            if self._shown >= SHOWN_MPS:
                self._by_course, self._shown = True, 0.0
                belief.turn(0.0, reset=True)

    def _watch_height(self, belief: Belief) -> None:
        """GPS and barometer hold it together; without a barometer the GPS does."""
        if belief.baro_lost:
            return
        ratio = abs(belief.innovation[2]) / (GATE * math.sqrt(HEIGHT_VARIANCE))
        self.ratios["height"] = max(ratio, _USUAL["height"])
        if ratio < 1.0:
            belief.follow_height()
