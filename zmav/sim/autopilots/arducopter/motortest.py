"""DO_MOTOR_TEST: one motor after the other turns on the ground, in the order that they stand clockwise from the nose.

https://ardupilot.org/copter/docs/connect-escs-and-motors.html; texts and refusals as ArduCopter's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

PERCENT, PWM, PILOT = 0, 1, 2  # MOTOR_TEST_THROTTLE_TYPE
LONGEST_S = 600.0
PAUSE_S = 0.5  # between two motors
LOWEST_PWM, HIGHEST_PWM = 800, 2200
CRITICAL, INFO = 2, 6


class MotorTest:
    """One copter's; while it runs the copter counts as armed."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self.running = False
        rotors = copter.airframe.rotors
        self._order = sorted(range(len(rotors)), key=lambda i: _bearing(rotors[i].forward_m, rotors[i].right_m))
        self._motor = self._count = self._kind = 0
        self._value = self._until = self._timeout = 0.0

    def start(self, motor: int, kind: int, value: float, timeout: float, count: int) -> bool:
        """``motor``: from 1; False, with the reason said, where it may not."""
        copter = self._copter
        if not self.running:
            refusal = "" if copter.boot.has("initialised") else "Board initialising"
            refusal = refusal or ("" if copter.landed else "vehicle not landed")
            if refusal:
                copter.say(CRITICAL, f"Motor Test: {refusal}")
                return False
            copter.say(INFO, "starting motor test")
            self.running = True
            copter.armed = True
        self._motor, self._kind, self._value, self._count = motor, kind, value, max(count, 1)
        self._timeout = min(max(timeout, 0.0), LONGEST_S)
        self._until = copter.now + self._timeout
        return True

    def update(self) -> None:
        """Instead of a mode, while it runs."""
        copter = self._copter
        if copter.now >= self._until + PAUSE_S * (self._count > 1):
            self._count -= 1
            if self._count <= 0:
                self.stop()
                return
            self._motor += 1
            self._until = copter.now + self._timeout
        if copter.now >= self._until:
            copter.sp.test(None, 0.0)
            return
        pwm = self._pwm()
        if not LOWEST_PWM <= pwm <= HIGHEST_PWM:
            self.stop()
        elif not 1 <= self._motor <= len(self._order):
            copter.say(INFO, "Motor Test: cancelled")
            self.stop()
        else:
            copter.sp.test(self._order[self._motor - 1], min(max((pwm - 1000.0) / 1000.0, 0.0), 1.0))

    def _pwm(self) -> float:
        if self._kind == PERCENT:
            return 1000.0 + 10.0 * self._value if self._value <= 100.0 else 0.0
        if self._kind == PWM:
            return self._value
        return float(self._copter.rc.pwm[2]) if self._kind == PILOT else 0.0

    def stop(self) -> None:
        if not self.running:
            return
        self.running = False
        self._copter.armed = False
        self._copter.sp.test(None, 0.0)
        self._copter.say(INFO, "finished motor test")


def _bearing(forward: float, right: float) -> float:
    """Degrees clockwise from the nose; what is on the nose's line comes first."""
    return round(math.degrees(math.atan2(right, forward)) % 360.0, 3)
