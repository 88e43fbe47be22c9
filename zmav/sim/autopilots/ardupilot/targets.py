"""What GUIDED is asked for, whatever kind of vehicle it is: positions, velocities, attitudes."""

from __future__ import annotations

import enum

import msgspec

from zmav.sim.control.setpoints import Vector

Quaternion = tuple[float, float, float, float]


class Doing(enum.Enum):
    """What GUIDED does now."""

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
    """A target in the world's NED (metres, m/s, m/s^2); what is None is left to the vehicle."""

    pos: Vector | None = None
    vel: Vector | None = None
    acc: Vector | None = None
    yaw: YawWish = YawWish()


class AttitudeTarget(msgspec.Struct, frozen=True):
    """An attitude (w, x, y, z; body to world) that turns at body ``rates`` (rad/s), or without one the rates alone;
    and a vertical speed in m/s (positive up) or a thrust, -1 to 1.
    """

    attitude: Quaternion | None
    rates: Vector
    climb: float | None
    thrust: float | None

    @property
    def lifts(self) -> bool:
        """It takes a landed copter off the ground."""
        return (self.climb or 0.0) > 0.0 or (self.thrust or 0.0) > 0.0
