"""OFFBOARD: the setpoint stream, whether it lives, and what it has the vehicle do.

https://docs.px4.io/v1.16/en/flight_modes/offboard.html. A setpoint counts as a sign of life in every mode; what it asks
for is kept only while OFFBOARD flies.
"""

from __future__ import annotations

import math

import msgspec

from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.control.setpoints import Axis, Spool, Vector

# Disarmed, PX4 looks at the stream every half second: a shorter one is not always seen (one entry in four failed after
# 0.3 s). Armed, the first setpoint is enough.
SETTLE_S = 0.5
CLIMB_MPS = 0.3  # a setpoint that asks for more than this lifts a landed vehicle
RISE_M = 0.2
LIFT_THRUST = 0.1
Partial = tuple["float | None", "float | None", "float | None"]
NOTHING: Partial = (None, None, None)


class Motion(msgspec.Struct, frozen=True):
    """A setpoint of the position controller in the world's NED; what is None is not held."""

    pos: Partial = NOTHING
    vel: Partial = NOTHING
    acc: Partial = NOTHING
    yaw: float | None = None
    yaw_rate: float | None = None


class Attitude(msgspec.Struct, frozen=True):
    """Lean (radians) and thrust (0 to 1)."""

    roll: float
    pitch: float
    yaw: float
    yaw_rate: float | None
    thrust: float


class Rates(msgspec.Struct, frozen=True):
    """Body rates (rad/s) and thrust (0 to 1)."""

    roll: float
    pitch: float
    yaw: float
    thrust: float


class Torque(msgspec.Struct, frozen=True):
    """Torques (-1 to 1) and thrust (0 to 1)."""

    roll: float
    pitch: float
    yaw: float
    thrust: float


Wish = Motion | Attitude | Rates | Torque


class Offboard:
    """One vehicle's stream of setpoints."""

    def __init__(self, copter: Px4State) -> None:
        self._copter = copter
        self.wish: Wish | None = None
        self.needs_position = True
        self._since = -math.inf  # when the running stream began
        self._last = -math.inf

    @property
    def _patience(self) -> float:
        return float(self._copter.params["COM_OF_LOSS_T"])

    def beat(self, *, needs_position: bool) -> None:
        """A setpoint came; ``needs_position``: it is one of the position controller."""
        now = self._copter.now
        if now - self._last > self._patience:
            self._since = now
        self._last = now
        self.needs_position = needs_position

    @property
    def known(self) -> bool:
        """There has been a setpoint since boot."""
        return self._last > -math.inf

    @property
    def alive(self) -> bool:
        """The stream runs, long enough to have been seen, and what it asks for can be flown."""
        copter = self._copter
        settled = copter.armed or copter.now - self._since >= SETTLE_S
        fresh = copter.now - self._last <= self._patience and settled
        return fresh and (copter.position_ok or not self.needs_position)

    def take(self, wish: Wish) -> None:
        """Fly this from now on, where OFFBOARD flies; what goes to the inner loops, at once."""
        self.wish = wish
        if self.by_thrust and self._copter.flies:
            self.fly()

    def enter(self) -> None:
        """Until a setpoint comes the vehicle stays where it is."""
        self.wish = None
        self._copter.stop_here()

    # ---- flying

    @property
    def lifts(self) -> bool:
        """Asks a standing vehicle to leave the ground."""
        wish, down = self.wish, self._copter.sense.down
        if isinstance(wish, Motion):
            z, vz, az = wish.pos[2], wish.vel[2], wish.acc[2]
            return (
                (z is not None and z < down - RISE_M)
                or (z is None and vz is not None and vz < -CLIMB_MPS)
                or (z is None and vz is None and az is not None and az < -CLIMB_MPS)
            )
        return wish is not None and wish.thrust > LIFT_THRUST

    @property
    def by_thrust(self) -> bool:
        """The thrust is given: nothing is ramped up for a takeoff."""
        return isinstance(self.wish, Attitude | Rates | Torque)

    def fly(self) -> None:
        """Hand the wish to the controllers."""
        sp = self._copter.sp
        sp.spool(Spool.FLY)
        wish = self.wish
        sp.raw(isinstance(wish, Motion))
        if isinstance(wish, Motion):
            self._move(wish)
        elif isinstance(wish, Attitude):
            sp.lean(wish.roll, wish.pitch)
            sp.direct_thrust(wish.thrust)
            if wish.yaw_rate is not None:
                sp.turn(wish.yaw_rate)
            else:
                sp.heading(wish.yaw)
        elif isinstance(wish, Rates):
            sp.rates(wish.roll, wish.pitch, wish.yaw)
            sp.direct_thrust(wish.thrust)
        elif isinstance(wish, Torque):
            sp.torque(wish.roll, wish.pitch, wish.yaw)
            sp.direct_thrust(wish.thrust)

    def _move(self, wish: Motion) -> None:
        sp, sense = self._copter.sp, self._copter.sense
        across = _axis(wish, 0) if _axis(wish, 0) == _axis(wish, 1) else None
        upright = _axis(wish, 2)
        # What is not held on any level is brought to rest.
        sp.move(
            pos=_filled(wish.pos),
            vel=_filled(wish.vel),
            acc=_filled(wish.acc),
            horizontal=Axis.VELOCITY if across is None else across,
            vertical=Axis.VELOCITY if upright is None else upright,
        )
        if wish.yaw is not None:
            sp.heading(wish.yaw)
        elif wish.yaw_rate is not None:
            sp.turn(wish.yaw_rate)
        else:
            sp.turn(0.0)
            sp.heading(sense.want_yaw)


def _axis(wish: Motion, index: int) -> Axis | None:
    """The highest level on which this axis is held."""
    for values, axis in ((wish.pos, Axis.POSITION), (wish.vel, Axis.VELOCITY), (wish.acc, Axis.ACCELERATION)):
        if values[index] is not None:
            return axis
    return None


def _filled(vector: Partial) -> Vector:
    x, y, z = vector
    return x or 0.0, y or 0.0, z or 0.0
