"""What a fixed wing's controllers are asked to do, for N planes: one row per quantity, one column per plane.

An autopilot writes its own column through :class:`PlaneHandle`; the controllers read whole rows.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from zmav.sim.arrays import Array


class Stage(enum.IntEnum):
    """Of the flight, where the energy controller acts differently."""

    NORMAL = 0
    TAKEOFF = 1
    LAND = 2
    FLARE = 3


# As plain numbers, for comparing whole rows many times a second.
TAKEOFF, LAND, FLARE = int(Stage.TAKEOFF), int(Stage.LAND), int(Stage.FLARE)
# What holds the roll axis: the aileron, as given; a bank; a line; a circle; a heading. And the pitch axis: the
# elevator, as given; an angle; height and speed.
AILERON, ROLL, LINE, CIRCLE, HEADING = range(5)
ELEVATOR, PITCH, ENERGY = range(3)

# Parameter -> (lowest, highest) that the controllers fly with: beyond it the numbers, not the plane, would fly away.
GAINS: dict[str, tuple[float, float]] = {
    "RLL2SRV_TCONST": (0.05, 10.0),
    "RLL2SRV_RMAX": (0.0, 1000.0),
    "RLL_RATE_P": (0.0, 10.0),
    "RLL_RATE_I": (0.0, 10.0),
    "RLL_RATE_D": (0.0, 1.0),
    "RLL_RATE_FF": (0.0, 10.0),
    "RLL_RATE_IMAX": (0.0, 1.0),
    "RLL_RATE_FLTT": (0.0, 100.0),
    "RLL_RATE_FLTD": (0.0, 100.0),
    "PTCH2SRV_TCONST": (0.05, 10.0),
    "PTCH2SRV_RMAX_UP": (0.0, 1000.0),
    "PTCH2SRV_RMAX_DN": (0.0, 1000.0),
    "PTCH2SRV_RLL": (0.0, 3.0),
    "PTCH_RATE_P": (0.0, 10.0),
    "PTCH_RATE_I": (0.0, 10.0),
    "PTCH_RATE_D": (0.0, 1.0),
    "PTCH_RATE_FF": (0.0, 10.0),
    "PTCH_RATE_IMAX": (0.0, 1.0),
    "PTCH_RATE_FLTT": (0.0, 100.0),
    "PTCH_RATE_FLTD": (0.0, 100.0),
    "KFF_RDDRMIX": (-1.0, 1.0),
    "SCALING_SPEED": (1.0, 100.0),
    "NAVL1_PERIOD": (1.0, 100.0),
    "NAVL1_DAMPING": (0.1, 2.0),
    "NAVL1_XTRACK_I": (0.0, 0.1),
    "TECS_CLMB_MAX": (0.1, 50.0),
    "TECS_SINK_MIN": (0.1, 50.0),
    "TECS_SINK_MAX": (0.1, 50.0),
    "TECS_TIME_CONST": (0.5, 50.0),
    "TECS_THR_DAMP": (0.0, 5.0),
    "TECS_PTCH_DAMP": (0.0, 5.0),
    "TECS_INTEG_GAIN": (0.0, 2.0),
    "TECS_VERT_ACC": (0.5, 50.0),
    "TECS_SPD_OMEGA": (0.1, 10.0),
    "TECS_RLL2THR": (0.0, 100.0),
    "TECS_SPDWEIGHT": (0.0, 2.0),
    "TECS_PITCH_MAX": (0.0, 60.0),
    "TECS_HDEM_TCONST": (0.2, 30.0),
    "TECS_LAND_TCONST": (0.5, 20.0),
    "TECS_LAND_SINK": (0.0, 5.0),
    "TECS_LAND_DAMP": (0.0, 5.0),
    "TECS_LAND_PMAX": (0.0, 60.0),
    "LAND_PITCH_DEG": (-20.0, 20.0),
    "AIRSPEED_CRUISE": (3.0, 100.0),
    "AIRSPEED_MIN": (3.0, 100.0),
    "AIRSPEED_MAX": (3.0, 100.0),
    "STALL_PREVENTION": (0.0, 1.0),
    "TRIM_THROTTLE": (0.0, 100.0),
    "THR_MAX": (0.0, 100.0),
    "THR_MIN": (0.0, 100.0),
    "THR_SLEWRATE": (0.0, 500.0),
    "ROLL_LIMIT_DEG": (1.0, 90.0),
    "PTCH_LIM_MAX_DEG": (1.0, 90.0),
    "PTCH_LIM_MIN_DEG": (-90.0, -1.0),
}


class Flown(NamedTuple):
    """What the controllers of one plane do now: radians, metres, m/s."""

    roll: float
    pitch: float
    bearing: float
    error: float
    """of the bearing"""
    cross_track: float
    """left of the line, or outside of the circle"""
    circling: bool
    turn_distance: float
    speed_error: float
    """true airspeed wanted minus flown"""
    height: float
    """wanted, over the world's origin"""


class PlaneTargets:
    """Targets of N planes: metres NED of the world, m/s, radians; surfaces as shares of their travel (roll right, nose
    up, nose right), throttle 0 to 1. Speeds are equivalent airspeeds. ``radius`` of a circle is positive clockwise.
    """

    def __init__(self, n: int) -> None:
        def row(value: float = 0.0) -> Array:
            return np.full(n, value)

        self.lateral = np.zeros(n, dtype=np.int8)
        self.upright = np.zeros(n, dtype=np.int8)
        self.stage = np.zeros(n, dtype=np.int8)
        self.auto_throttle = np.zeros(n, dtype=bool)
        self.auto_rudder = np.zeros(n, dtype=bool)
        self.idle = np.ones(n, dtype=bool)  # integrators rest: it stands
        self.aileron, self.elevator, self.rudder, self.throttle = row(), row(), row(), row()
        self.roll, self.pitch = row(), row()
        self.heading = row()
        self.start: Array = np.zeros((2, n))
        self.end: Array = np.zeros((2, n))  # of a line; the centre of a circle
        self.radius = row()
        self.height = row()  # over the world's origin
        self.airspeed = row(22.0)
        self.ground_height = row()  # of the place to land at, over the world's origin
        self.roll_limit = row(1.0)
        self.pitch_min, self.pitch_max = row(-1.5), row(1.5)
        self.throttle_min, self.throttle_max = row(), row(1.0)
        self.gains: dict[str, Array] = {name: row(low) for name, (low, _) in GAINS.items()}
        self.tuned = 0
        """how often a gain was set: what is reckoned from them holds until then"""


class PlaneHandle:
    """One plane's column of :class:`PlaneTargets`. ``flown()``: what its controllers make of it; ``eas2tas``: true
    over equivalent airspeed.
    """

    def __init__(self, table: PlaneTargets, index: int, flown: Callable[[], Flown], eas2tas: float) -> None:
        self._t = table
        self._i = index
        self.flown = flown
        self.eas2tas = eas2tas

    def gain(self, name: str, value: float) -> None:
        """Set one of :data:`GAINS`, kept within its bounds."""
        low, high = GAINS[name]
        self._t.gains[name][self._i] = min(max(value, low), high)
        self._t.tuned += 1

    def off(self) -> None:
        """Surfaces in the middle, no thrust."""
        self.surfaces(0.0, 0.0, 0.0)
        self.power(0.0)
        self.stage(Stage.NORMAL)
        self._t.idle[self._i] = True

    def flying(self, on: bool) -> None:
        """The integrators may work."""
        self._t.idle[self._i] = not on

    def surfaces(self, aileron: float, elevator: float, rudder: float) -> None:
        t, i = self._t, self._i
        t.lateral[i], t.upright[i] = AILERON, ELEVATOR
        t.aileron[i], t.elevator[i], t.rudder[i] = aileron, elevator, rudder
        t.auto_rudder[i] = False

    def yaw(self, rudder: float) -> None:
        """The pilot's rudder: on top of what coordinates turns."""
        self._t.rudder[self._i] = rudder

    def roll(self, angle: float) -> None:
        """Hold a bank."""
        self._t.lateral[self._i], self._t.roll[self._i] = ROLL, angle
        self._t.auto_rudder[self._i] = True

    def pitch(self, angle: float) -> None:
        self._t.upright[self._i], self._t.pitch[self._i] = PITCH, angle

    def line(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        t, i = self._t, self._i
        t.lateral[i], t.auto_rudder[i] = LINE, True
        t.start[:, i], t.end[:, i] = start, end

    def circle(self, centre: tuple[float, float], radius: float) -> None:
        """``radius``: metres, negative counter-clockwise."""
        t, i = self._t, self._i
        t.lateral[i], t.auto_rudder[i] = CIRCLE, True
        t.end[:, i], t.radius[i] = centre, radius

    def fly_heading(self, heading: float) -> None:
        t, i = self._t, self._i
        t.lateral[i], t.auto_rudder[i], t.heading[i] = HEADING, True, heading

    def energy(self, height: float, airspeed: float) -> None:
        """Hold a height (m over the world's origin) and an equivalent airspeed with elevator and throttle."""
        t, i = self._t, self._i
        t.upright[i], t.auto_throttle[i] = ENERGY, True
        t.height[i], t.airspeed[i] = height, airspeed

    def power(self, throttle: float) -> None:
        self._t.auto_throttle[self._i] = False
        self._t.throttle[self._i] = throttle

    def stage(self, stage: Stage, ground_height: float = 0.0) -> None:
        self._t.stage[self._i] = stage
        self._t.ground_height[self._i] = ground_height

    def limits(self, *, roll: float, pitch: tuple[float, float], throttle: tuple[float, float]) -> None:
        """How far navigation may go: radians either way, radians from and to, shares from and to."""
        t, i = self._t, self._i
        t.roll_limit[i] = roll
        t.pitch_min[i], t.pitch_max[i] = pitch
        t.throttle_min[i], t.throttle_max[i] = throttle
