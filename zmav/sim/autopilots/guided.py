"""GUIDED: flies to what the ground or a companion asks, as ArduCopter does.

Targets: https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html. A position target holds for ever;
velocities, accelerations and attitudes are dropped GUID_TIMEOUT seconds after the last one, and the copter comes to
a stop. On the ground only a takeoff lifts it.
"""

from __future__ import annotations

import enum
import math

import msgspec

from zmav.sim.autopilots.modes import Mode
from zmav.sim.control.setpoints import Axis, Spool, Vector

SPOOL_UP_S = 2.0  # from the command to thrust, as measured
TAKEOFF_DONE_M = 0.5


class Doing(enum.Enum):
    HOLD = "hold"
    TAKEOFF = "takeoff"
    POSITION = "position"
    POSITION_VELOCITY = "position and velocity"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    ATTITUDE = "attitude"


class YawWish(msgspec.Struct, frozen=True):
    """The yaw part of a target: an angle (radians, absolute), a rate (rad/s), or neither."""

    angle: float | None = None
    rate: float | None = None


class Target(msgspec.Struct, frozen=True):
    """A target in the world's NED (metres, m/s, m/s^2); what is None is left to the copter."""

    pos: Vector | None = None
    vel: Vector | None = None
    acc: Vector | None = None
    yaw: YawWish = YawWish()


class AttitudeTarget(msgspec.Struct, frozen=True):
    """Lean in radians, vertical speed in m/s (positive up) or thrust 0..1, and the yaw part."""

    roll: float
    pitch: float
    climb: float | None
    thrust: float | None
    yaw: YawWish = YawWish()


class Guided(Mode):
    number, name, armable, changes_speed = 4, "GUIDED", True, True
    doing = Doing.HOLD
    target = Target()
    _until = math.inf
    _lift_at = 0.0
    _takeoff_down = 0.0

    def enter(self) -> None:
        self.hold()

    def hold(self) -> None:
        """Stop here: what a target that makes no sense leads to as well."""
        self.doing, self.target, self._until = Doing.HOLD, Target(), math.inf
        self.stop_here()

    def take_off(self, down: float) -> None:
        """Rise to ``down`` metres (world NED) over this place."""
        copter = self.copter
        self.doing, self._takeoff_down, self._until = Doing.TAKEOFF, down, math.inf
        self._lift_at = copter.now + SPOOL_UP_S
        self.target = Target(pos=(copter.sense.north, copter.sense.east, down))
        copter.sp.move(pos=(copter.sense.north, copter.sense.east, down))
        copter.heading.hold(copter.sense.yaw)

    @property
    def taking_off(self) -> bool:
        reached = self.copter.sense.down < self._takeoff_down + TAKEOFF_DONE_M
        return self.doing is Doing.TAKEOFF and not reached

    def aim(self, target: Target) -> None:
        """Take a target; one that holds nothing, or a position with an acceleration but no velocity, means stop."""
        copter, sp = self.copter, self.copter.sp
        timeout = copter.now + copter.params["GUID_TIMEOUT"]
        vel, acc = target.vel or (0.0, 0.0, 0.0), target.acc or (0.0, 0.0, 0.0)
        if target.pos is not None and target.vel is not None:
            self.doing, self._until = Doing.POSITION_VELOCITY, timeout
            sp.move(pos=target.pos, vel=vel, acc=acc)
        elif target.pos is not None and target.acc is None:
            self.doing, self._until = Doing.POSITION, math.inf
            sp.move(pos=target.pos)
        elif target.vel is not None:
            self.doing, self._until = Doing.VELOCITY, timeout
            sp.move(vel=vel, acc=acc, horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        elif target.pos is None and target.acc is not None:
            self.doing, self._until = Doing.ACCELERATION, timeout
            sp.move(acc=acc, horizontal=Axis.ACCELERATION, vertical=Axis.ACCELERATION)
        else:
            self.hold()
            return
        self.target = target
        self._face(target.yaw)

    def lean(self, target: AttitudeTarget) -> None:
        """Take an attitude target."""
        copter, sp = self.copter, self.copter.sp
        self.doing, self._until = Doing.ATTITUDE, copter.now + copter.params["GUID_TIMEOUT"]
        sp.lean(target.roll, target.pitch)
        if target.thrust is not None:
            sp.direct_thrust(target.thrust)
        else:
            sp.climb(-(target.climb or 0.0))
        self.target = Target(yaw=target.yaw)
        if target.yaw.angle is None and target.yaw.rate is None:
            copter.heading.hold(copter.sense.yaw)
        else:
            self._face(target.yaw)

    def _face(self, wish: YawWish) -> None:
        copter = self.copter
        if wish.angle is not None:
            copter.heading.hold(wish.angle)
        elif wish.rate is not None:
            copter.heading.turn(wish.rate)
        else:
            copter.heading.along(copter.params["WP_YAW_BEHAVIOR"], copter.sense.yaw)

    def update(self) -> None:
        copter = self.copter
        if copter.landed and self.doing is not Doing.TAKEOFF:
            copter.sp.spool(Spool.IDLE)
            return
        if self.doing is Doing.TAKEOFF and copter.now < self._lift_at:
            copter.sp.spool(Spool.IDLE)
            return
        copter.sp.spool(Spool.FLY)
        if copter.now > self._until:
            self._starve()

    def _starve(self) -> None:
        """Nothing came for GUID_TIMEOUT: a stop, and level flight."""
        copter = self.copter
        self._until = math.inf
        if self.doing is Doing.POSITION_VELOCITY and self.target.pos is not None:
            copter.sp.move(pos=self.target.pos)
        elif self.doing is Doing.ATTITUDE:
            copter.sp.lean(0.0, 0.0)
            copter.sp.climb(0.0)
        else:
            copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        copter.heading.hold(copter.sense.yaw)
