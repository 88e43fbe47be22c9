"""From a point on the wire to a point an autopilot takes; every fault is named."""

from __future__ import annotations

import math

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.errors import BadInput

MAX_DISTANCE = 100_000.0
"""m from the origin: farther is a mistake"""


def resolve(point: wire.Setpoint | wire.GoTo, origin: wire.Origin | None) -> Target:
    """The target of a setpoint or a goto; raises :class:`BadInput` for what does not fit together."""
    _check_finite(point)
    motion = point if isinstance(point, wire.Setpoint) else None
    vel, acc = (motion.vel, motion.acc) if motion else (None, None)
    yaw_rate = motion.yaw_rate if motion else None
    if point.frame == "ned":
        _refuse(point, ("lat_deg", "lon_deg", "alt_amsl", "alt_rel"), "belongs to frame 'global', not 'ned'")
        if point.pos is None:
            return Target(vel=_need_velocity(vel), acc=acc, yaw=point.yaw, yaw_rate=yaw_rate)
        if origin is None:
            raise BadInput(
                "frame 'ned' is about the fleet's origin, and none is declared: give one (--origin, or origin in the "
                "fleet file), or use frame 'global'",
                field="frame",
                value="ned",
                expected="global",
            )
        if math.hypot(*point.pos) > MAX_DISTANCE:
            raise BadInput(f"pos is over {MAX_DISTANCE:.0f} m away", field="pos", value=list(point.pos))
        lat, lon, alt = geo.to_global(origin, point.pos)
        return Target(lat, lon, alt_amsl=alt, vel=vel, acc=acc, yaw=point.yaw, yaw_rate=yaw_rate)
    _refuse(point, ("pos",), "belongs to frame 'ned', not 'global'")
    if point.lat_deg is None and point.lon_deg is None:
        return Target(vel=_need_velocity(vel), acc=acc, yaw=point.yaw, yaw_rate=yaw_rate)
    _check_global(point)
    return Target(
        point.lat_deg, point.lon_deg, point.alt_amsl, point.alt_rel, vel=vel, acc=acc, yaw=point.yaw, yaw_rate=yaw_rate
    )


def _check_finite(point: wire.Setpoint | wire.GoTo) -> None:
    for name in point.__struct_fields__:
        value = getattr(point, name)
        parts = value if isinstance(value, tuple) else (value,)
        if any(isinstance(x, float) and not math.isfinite(x) for x in parts):
            raise BadInput(f"{name} is not finite", field=name, value=str(value), expected="a finite number")


def _refuse(point: wire.Setpoint | wire.GoTo, names: tuple[str, ...], why: str) -> None:
    for name in names:
        if getattr(point, name) is not None:
            raise BadInput(f"{name} {why}", field=name, value=getattr(point, name), expected="absent")


def _need_velocity(vel: wire.Vector | None) -> wire.Vector:
    if vel is None:
        raise BadInput("neither a position nor a velocity is given", field="pos", value=None, expected="pos or vel")
    return vel


def _check_global(point: wire.Setpoint | wire.GoTo) -> None:
    for name, limit in (("lat_deg", 90.0), ("lon_deg", 180.0)):
        value = getattr(point, name)
        if value is None or abs(value) > limit:
            raise BadInput(f"{name} must be within ±{limit:.0f}", field=name, value=value, expected=f"±{limit:.0f}")
    if (point.alt_amsl is None) == (point.alt_rel is None):
        raise BadInput("give one of alt_amsl and alt_rel", field="alt_rel", value=point.alt_rel, expected="one of them")
