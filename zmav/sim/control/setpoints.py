"""What the cascade is asked to do, for N vehicles: one row per quantity, one column per vehicle.

An autopilot writes its own column through :class:`SetpointHandle`; the cascade reads whole rows.
"""

from __future__ import annotations

import enum
import math

import numpy as np

from zmav.sim.arrays import Array
from zmav.sim.control.gains import Gains, arducopter_gains

Vector = tuple[float, float, float]


def from_nose(vector: Vector, yaw: float) -> Vector:
    """From forward-right-down, level, to north-east-down."""
    c, s = math.cos(yaw), math.sin(yaw)
    return vector[0] * c - vector[1] * s, vector[0] * s + vector[1] * c, vector[2]


class Spool(enum.IntEnum):
    """What the rotors do."""

    OFF = 0
    IDLE = 1
    FLY = 2


class Axis(enum.IntEnum):
    """What is held, of the horizontal pair or of the vertical."""

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    DIRECT = 3  # horizontally the attitude, vertically the thrust, as given
    RATES = 4  # horizontally: the body rates as given, heading included
    TORQUE = 5  # horizontally: the torque as given, heading included


# As plain numbers, for comparing whole rows many times a second.
FLY, IDLE = int(Spool.FLY), int(Spool.IDLE)
POSITION, VELOCITY, ACCELERATION = int(Axis.POSITION), int(Axis.VELOCITY), int(Axis.ACCELERATION)
DIRECT, RATES, TORQUE = int(Axis.DIRECT), int(Axis.RATES), int(Axis.TORQUE)
YAW_ANGLE, YAW_RATE = 0, 1


# What a vehicle may do at most, SI units: at ArduCopter's defaults, and what no parameter raises it above, since beyond
# it the numbers, not the vehicle, would fly away.
LIMITS = {
    "speed": (10.0, 50.0),  # WPNAV_SPEED
    "speed_up": (2.5, 20.0),  # WPNAV_SPEED_UP
    "speed_down": (1.5, 20.0),  # WPNAV_SPEED_DN
    "accel": (2.5, 20.0),  # WPNAV_ACCEL
    "accel_z": (1.0, 10.0),  # WPNAV_ACCEL_Z
    "jerk": (5.0, 100.0),  # PSC_JERK_XY
    "jerk_z": (5.0, 100.0),  # PSC_JERK_Z
    "lean": (math.radians(30.0), math.radians(80.0)),  # ANGLE_MAX
    "yaw_slew": (math.radians(60.0), 6.0),  # ATC_SLEW_YAW
}
FASTEST_TURN = LIMITS["yaw_slew"][1]
HIGHEST = 1e3  # of any gain: beyond it the numbers, not the vehicle, would fly away


class Setpoints:
    """Targets of N vehicles: metres, m/s, m/s^2 in world NED; radians; thrust as a fraction of the rotors' sum.

    ``raw``: the targets are followed as they are, without the shaping of :mod:`zmav.sim.control.reference`.
    """

    def __init__(self, n: int, gains: Gains | None = None) -> None:
        self.spool = np.zeros(n, dtype=np.int8)
        self.kinds = np.zeros((2, n), dtype=np.int8)
        self.horizontal, self.vertical = self.kinds
        self.yaw_kind = np.zeros(n, dtype=np.int8)
        self.pos: Array = np.zeros((3, n))
        self.vel: Array = np.zeros((3, n))
        self.acc: Array = np.zeros((3, n))
        self.roll: Array = np.zeros(n)
        self.pitch: Array = np.zeros(n)
        self.thrust: Array = np.zeros(n)
        self.yaw: Array = np.zeros(n)
        self.yaw_rate: Array = np.zeros(n)
        self.body: Array = np.zeros((3, n))  # body rates, rad/s; or torque, -1..1
        self.raw = np.zeros(n, dtype=bool)
        limits = np.repeat(np.array([[usual] for usual, _ in LIMITS.values()]), n, axis=1)
        self.limits = dict(zip(LIMITS, limits, strict=True))  # (N,) rows
        at = list(LIMITS).index("accel")
        self.accels: Array = limits[at : at + 2]  # those of "accel" and "accel_z"
        self.gains = gains or arducopter_gains(n)

    def handle(self, index: int) -> SetpointHandle:
        return SetpointHandle(self, index)


class SetpointHandle:
    """One vehicle's column of :class:`Setpoints`."""

    def __init__(self, table: Setpoints, index: int) -> None:
        self._t = table
        self._i = index

    def spool(self, spool: Spool) -> None:
        self._t.spool[self._i] = spool

    def move(
        self,
        *,
        pos: Vector = (0.0, 0.0, 0.0),
        vel: Vector = (0.0, 0.0, 0.0),
        acc: Vector = (0.0, 0.0, 0.0),
        horizontal: Axis = Axis.POSITION,
        vertical: Axis = Axis.POSITION,
    ) -> None:
        """Hold a position, a velocity (with ``vel`` beside a position: fed forward) or an acceleration."""
        t, i = self._t, self._i
        t.horizontal[i], t.vertical[i] = horizontal, vertical
        t.pos[:, i], t.vel[:, i], t.acc[:, i] = pos, vel, acc

    def raw(self, on: bool) -> None:
        """Follow targets unshaped, as a controller does that a stream of setpoints drives."""
        self._t.raw[self._i] = on

    def rates(self, p: float, q: float, r: float) -> None:
        """Hold these body rates, rad/s about forward, right and down."""
        t, i = self._t, self._i
        t.horizontal[i] = Axis.RATES
        t.body[:, i] = p, q, r

    def torque(self, roll: float, pitch: float, yaw: float) -> None:
        """Apply this torque about forward, right and down, below all loops: shares of the highest, -1..1, as PX4's
        vehicle_torque_setpoint has them. The thrust goes with :meth:`direct_thrust`.
        """
        t, i = self._t, self._i
        t.horizontal[i] = Axis.TORQUE
        t.body[:, i] = [min(max(share, -1.0), 1.0) for share in (roll, pitch, yaw)]

    def lean(self, roll: float, pitch: float) -> None:
        """Hold this attitude (radians) instead of anything horizontal."""
        t, i = self._t, self._i
        t.horizontal[i] = Axis.DIRECT
        t.roll[i], t.pitch[i] = roll, pitch

    @property
    def leans(self) -> bool:
        """Its attitude is held as told."""
        return bool(self._t.horizontal[self._i] == Axis.DIRECT)

    def climb(self, down_speed: float) -> None:
        """Hold a vertical speed, m/s, positive down."""
        t, i = self._t, self._i
        t.vertical[i] = Axis.VELOCITY
        t.vel[2, i], t.acc[2, i] = down_speed, 0.0

    def height(self, down: float) -> None:
        """Hold a height: metres down of the world's origin."""
        t, i = self._t, self._i
        t.vertical[i] = Axis.POSITION
        t.pos[2, i], t.vel[2, i], t.acc[2, i] = down, 0.0, 0.0

    def direct_thrust(self, fraction: float) -> None:
        t, i = self._t, self._i
        t.vertical[i] = Axis.DIRECT
        t.thrust[i] = fraction

    def heading(self, yaw: float) -> None:
        """Turn to ``yaw`` (radians) at the allowed rate and stay there."""
        self._t.yaw_kind[self._i] = YAW_ANGLE
        self._t.yaw[self._i] = yaw

    def turn(self, rate: float) -> None:
        """Turn at ``rate`` rad/s, clockwise from above."""
        self._t.yaw_kind[self._i] = YAW_RATE
        self._t.yaw_rate[self._i] = min(max(rate, -FASTEST_TURN), FASTEST_TURN)

    def limit(self, name: str, value: float) -> None:
        """Set one of :data:`LIMITS` by its name; never beyond its highest."""
        self._t.limits[name][self._i] = min(max(value, 1e-3), LIMITS[name][1])

    def tune(self, gain: str, axes: tuple[int, ...], value: float) -> None:
        """Set one of :class:`~zmav.sim.control.gains.Gains` by its name, on some of its rows; never below
        zero, nor beyond :data:`HIGHEST`.
        """
        self._t.gains.tune(self._i, gain, axes, min(max(value, 0.0), HIGHEST))

    def limit_of(self, name: str) -> float:
        return float(self._t.limits[name][self._i])
