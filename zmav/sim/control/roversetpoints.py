"""What a rover's controllers are asked to do and how they are tuned, for N rovers: one row per quantity, one column per
rover. An autopilot writes its own column through :class:`RoverHandle`; the controllers read whole rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from zmav.sim.arrays import Array

Point = tuple[float, float]

# What is held: nothing (throttle and steering in the middle); the outputs, as given; a stop without a turn; a turn rate
# and a speed; a heading and a speed; a moving point; a place, to which the moving point goes by itself.
COAST, DIRECT, STOP, TURN, HEADING, PATH, PLACE = range(7)

# Row of the tuning -> ArduRover's parameter and the factor to SI.
TUNING: dict[str, tuple[str, float]] = {
    "cruise_speed": ("CRUISE_SPEED", 1.0),
    "cruise_throttle": ("CRUISE_THROTTLE", 0.01),
    "speed_p": ("ATC_SPEED_P", 1.0),
    "speed_i": ("ATC_SPEED_I", 1.0),
    "speed_d": ("ATC_SPEED_D", 1.0),
    "speed_ff": ("ATC_SPEED_FF", 1.0),
    "speed_imax": ("ATC_SPEED_IMAX", 1.0),
    "speed_filter": ("ATC_SPEED_FLTE", 1.0),
    "accel": ("ATC_ACCEL_MAX", 1.0),
    "decel": ("ATC_DECEL_MAX", 1.0),
    "brake": ("ATC_BRAKE", 1.0),
    "stop_speed": ("ATC_STOP_SPEED", 1.0),
    "turn_p": ("ATC_STR_RAT_P", 1.0),
    "turn_i": ("ATC_STR_RAT_I", 1.0),
    "turn_d": ("ATC_STR_RAT_D", 1.0),
    "turn_ff": ("ATC_STR_RAT_FF", 1.0),
    "turn_imax": ("ATC_STR_RAT_IMAX", 1.0),
    "turn_filter": ("ATC_STR_RAT_FLTE", 1.0),
    "turn_max": ("ATC_STR_RAT_MAX", math.pi / 180.0),
    "turn_accel": ("ATC_STR_ACC_MAX", math.pi / 180.0),
    "turn_decel": ("ATC_STR_DEC_MAX", math.pi / 180.0),
    "angle_p": ("ATC_STR_ANG_P", 1.0),
    "lateral": ("ATC_TURN_MAX_G", 9.80665),
    "turn_radius": ("TURN_RADIUS", 1.0),
    "pos_p": ("PSC_POS_P", 1.0),
    "vel_p": ("PSC_VEL_P", 1.0),
    "vel_i": ("PSC_VEL_I", 1.0),
    "vel_imax": ("PSC_VEL_IMAX", 1.0),
    "vel_filter": ("PSC_VEL_FLTE", 1.0),
    "steer_base": ("MOT_SPD_SCA_BASE", 1.0),
    "throttle_max": ("MOT_THR_MAX", 0.01),
    "slew": ("MOT_SLEWRATE", 0.01),
}
BY_PARAM = {param: (row, factor) for row, (param, factor) in TUNING.items()}
HIGHEST = 1e3  # of any number of the tuning: no parameter makes the numbers, instead of the rover, fly away


class RoverSetpoints:
    """Targets of N rovers: metres, m/s, m/s^2 in world north-east; radians; outputs -1 to 1.

    ``speed_limit``, ``accel_limit``, ``jerk_limit``: of the way along a path or to a place.
    """

    def __init__(self, n: int) -> None:
        self.armed = np.zeros(n, dtype=bool)
        self.task = np.zeros(n, dtype=np.int8)
        self.pos: Array = np.zeros((2, n))
        self.vel: Array = np.zeros((2, n))
        self.acc: Array = np.zeros((2, n))
        self.speed: Array = np.zeros(n)
        self.turn: Array = np.zeros(n)
        self.heading: Array = np.zeros(n)
        self.steering: Array = np.zeros(n)
        self.throttle: Array = np.zeros(n)
        self.speed_limit: Array = np.full(n, 5.0)
        self.accel_limit: Array = np.ones(n)
        self.jerk_limit: Array = np.ones(n)
        self.fresh = np.zeros(n, dtype=bool)  # the moving point begins where the rover is
        self.tuning: dict[str, Array] = {row: np.zeros(n) for row in TUNING}
        self.tuned = 0
        """how often a number of the tuning was set: what is reckoned from them holds until then"""

    def handle(self, index: int) -> RoverHandle:
        return RoverHandle(self, index)


class RoverHandle:
    """One rover's column of :class:`RoverSetpoints`."""

    def __init__(self, table: RoverSetpoints, index: int) -> None:
        self._t = table
        self._i = index
        self.point: Callable[[], Point] = lambda: (0.0, 0.0)  # the moving point; set by the fleet

    def power(self, on: bool) -> None:
        """Let the motors turn, or not; what is held stays."""
        self._t.armed[self._i] = on

    def coast(self) -> None:
        self._t.task[self._i] = COAST

    def direct(self, steering: float, throttle: float) -> None:
        """Outputs, -1 to 1."""
        t, i = self._t, self._i
        t.task[i], t.steering[i], t.throttle[i] = DIRECT, steering, throttle

    def stop(self) -> None:
        self._t.task[self._i] = STOP

    def turn(self, rate: float, speed: float) -> None:
        """A turn rate, rad/s clockwise, and a speed, m/s."""
        t, i = self._t, self._i
        t.task[i], t.turn[i], t.speed[i] = TURN, rate, speed

    def head(self, yaw: float, speed: float) -> None:
        """A heading, radians, and a speed, m/s."""
        t, i = self._t, self._i
        t.task[i], t.heading[i], t.speed[i] = HEADING, yaw, speed

    def follow(self, pos: Point, vel: Point, acc: Point) -> None:
        """A moving point."""
        t, i = self._t, self._i
        t.task[i] = PATH
        t.pos[:, i], t.vel[:, i], t.acc[:, i] = pos, vel, acc

    def go(self, pos: Point) -> None:
        """A place, as fast and as smoothly as the limits let."""
        t, i = self._t, self._i
        if t.task[i] != PLACE:
            t.fresh[i] = True
        t.task[i] = PLACE
        t.pos[:, i] = pos

    def limits(self, speed: float, accel: float, jerk: float) -> None:
        t, i = self._t, self._i
        t.speed_limit[i], t.accel_limit[i], t.jerk_limit[i] = speed, accel, jerk

    def tune(self, row: str, value: float) -> None:
        """Set one of :data:`TUNING` by its row; never beyond :data:`HIGHEST`."""
        self._t.tuning[row][self._i] = min(max(value, -HIGHEST), HIGHEST)
        self._t.tuned += 1
