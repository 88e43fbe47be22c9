"""GUIDED: flies to what the ground or a companion asks, as ArduCopter does.

Targets: https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html. A position target holds for ever;
velocities, accelerations and attitudes are dropped GUID_TIMEOUT seconds after the last one, and the copter comes to
a stop. On the ground only a takeoff lifts it, or an attitude with a climb.
"""

from __future__ import annotations

import math

from zmav import rotation
from zmav.sim.autopilots.arducopter.base import CopterBase
from zmav.sim.autopilots.ardupilot.state import AttitudeTarget, Doing, GuidedMode, Quaternion, Target, YawWish
from zmav.sim.control.setpoints import Axis, Spool

TAKEOFF_DONE_M = 0.5


class Guided(GuidedMode):
    number, name, armable, changes_speed = 4, "GUIDED", True, True
    _until = math.inf
    _lift_at = 0.0
    _takeoff_down = 0.0
    _wanted = AttitudeTarget(None, (0.0, 0.0, 0.0), 0.0, None)
    _turned: Quaternion | None = None

    def __init__(self, copter: CopterBase) -> None:
        super().__init__(copter)
        self.copter = copter

    def enter(self) -> None:
        self.hold()

    def hold(self) -> None:
        """Stop here: what a target that makes no sense leads to as well."""
        self.doing, self.target, self._until = Doing.HOLD, Target(), math.inf
        self.copter.stop_here()

    def take_off(self, down: float) -> None:
        """Rise to ``down`` metres (world NED) over this place."""
        copter = self.copter
        self.doing, self._takeoff_down, self._until = Doing.TAKEOFF, down, math.inf
        self._lift_at = copter.spun_up_at
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
        """Take an attitude target; a positive climb or thrust lifts a landed copter."""
        copter, sp = self.copter, self.copter.sp
        if self.doing is not Doing.ATTITUDE:
            self._lift_at = math.inf
        self.doing, self._until = Doing.ATTITUDE, copter.now + copter.params["GUID_TIMEOUT"]
        self.target, self._wanted, self._turned = Target(), target, target.attitude
        if target.thrust is not None:
            sp.direct_thrust(min(max(target.thrust, 0.0), 1.0))
        else:
            sp.climb(-(target.climb or 0.0))
        if target.lifts:
            copter.auto_armed = True
        if target.attitude is None:
            sp.rates(*target.rates)
        else:
            self._incline(target.attitude)

    def _incline(self, q: Quaternion) -> None:
        """Hold this attitude; never leaning more than ANGLE_MAX."""
        copter = self.copter
        roll, pitch, yaw = rotation.euler(q)
        most = copter.sp.limit_of("lean")
        copter.sp.lean(min(max(roll, -most), most), min(max(pitch, -most), most))
        copter.heading.hold(yaw)

    def _turn_on(self) -> None:
        """An attitude with body rates turns on by itself until the next one comes."""
        if self._turned is None or not any(self._wanted.rates):
            return
        half = 0.5 * self.copter.dt
        turned = rotation.product(self._turned, (1.0, *(rate * half for rate in self._wanted.rates)))
        norm = math.sqrt(sum(part * part for part in turned))
        self._turned = (turned[0] / norm, turned[1] / norm, turned[2] / norm, turned[3] / norm)
        self._incline(self._turned)

    def _attitude_from_ground(self) -> bool:
        """A landed copter that is to lean: idle, or spooling up to lift. True while it stays on the ground."""
        copter = self.copter
        if not self._wanted.lifts or copter.now > self._until:
            self._lift_at = math.inf
        elif self._lift_at == math.inf:
            self._lift_at = copter.spun_up_at
        return copter.now < self._lift_at

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
        leans = self.doing is Doing.ATTITUDE
        if copter.landed and self.doing is not Doing.TAKEOFF and (not leans or self._attitude_from_ground()):
            copter.sp.spool(Spool.IDLE)
            return
        if self.doing is Doing.TAKEOFF and copter.now < self._lift_at:
            copter.sp.spool(Spool.IDLE)
            return
        copter.sp.spool(Spool.FLY)
        if copter.now > self._until:
            self._starve()
        elif leans:
            self._turn_on()

    def _starve(self) -> None:
        """Nothing came for GUID_TIMEOUT: a stop, and level flight."""
        copter = self.copter
        self._until = math.inf
        if self.doing is Doing.POSITION_VELOCITY and self.target.pos is not None:
            copter.sp.move(pos=self.target.pos)
        elif self.doing is Doing.ATTITUDE:
            self._turned = None
            copter.sp.lean(0.0, 0.0)
            copter.sp.climb(0.0)
        else:
            copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        copter.heading.hold(copter.sense.yaw)
