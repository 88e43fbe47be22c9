"""What a supervisor can be asked to follow: the arguments of its orders."""

from __future__ import annotations

from zmav import wire


class GoTo(wire.Order, kw_only=True):
    """A place to fly to under the controller."""

    pos: wire.Vector
    """m, NED about the fleet's origin"""
    yaw: float | None = None
    """rad"""
    speed: float = 2.0
    """m/s at most"""
    accel: float = 2.0
    """m/s² at most"""


class FollowSegment(wire.Order, kw_only=True):
    """A trajectory to follow under the controller."""

    segment: list[wire.SegmentPoint]


class ByStick(wire.Order, kw_only=True):
    """The pilot's sticks as reference."""

    level: str = "attitude"
    """velocity, attitude or rates"""
