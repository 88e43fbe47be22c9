"""From a point on the wire to a target an autopilot takes: exactly one level of authority, and every fault is named."""

from __future__ import annotations

import math

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.errors import BadInput

MAX_DISTANCE = 100_000.0
"""m from the origin, or up: farther is a mistake"""
MAX_MOTION = 1000.0
"""m/s and m/s²: the most ArduPilot takes for sane"""
MAX_ANGLE = 100.0
"""rad and rad/s"""
UNIT_WITHIN = 1e-2
PWM = (800, 2200)
RC_CHANNELS, SERVO_OUTPUTS = 18, 16

_MOTION = ("pos", "lat_deg", "lon_deg", "alt_amsl", "alt_rel", "vel", "acc", "yaw", "yaw_rate")
_BY_GROUP: dict[str, tuple[str, ...]] = {
    "motion": _MOTION,
    "attitude": ("attitude", "rates", "thrust"),
    "torque": ("torque", "thrust"),
    "manual": ("manual",),
    "rc": ("rc",),
    "servo": ("servo",),
    "segment": ("segment",),
}
"""the fields that may be given together; ``thrust`` belongs to two groups"""
_LEVEL_FIELDS = tuple(dict.fromkeys(name for names in _BY_GROUP.values() for name in names))


def group_of(point: wire.Setpoint) -> str:
    """Which of motion, attitude (rates included), torque, manual, rc, servo and segment a setpoint is.

    Raises :class:`BadInput` where none is given, or two are mixed.
    """
    given = [name for name in _LEVEL_FIELDS if getattr(point, name) is not None]
    for group, names in _BY_GROUP.items():
        if given and all(name in names for name in given):
            if given == ["thrust"]:
                break
            return group
    if not given:
        text = "neither a position nor a velocity is given, nor any other level"
        raise BadInput(text, field="pos", value=None, expected="one of " + ", ".join(_LEVEL_FIELDS))
    if given == ["thrust"]:
        text = "a thrust alone is no setpoint: attitude, rates or torque goes with it"
        raise BadInput(text, field="thrust", value=point.thrust, expected="attitude, rates or torque beside it")
    group = next(group for group, names in _BY_GROUP.items() if given[0] in names)
    odd = next((name for name in given if name not in _BY_GROUP[group]), given[-1])
    text = f"{odd} does not go with {given[0]}: one level of authority at a time"
    raise BadInput(text, field=odd, value=str(getattr(point, odd))[:80], expected=f"absent, or without {given[0]}")


def resolve(point: wire.Setpoint | wire.GoTo, origin: wire.Origin | None) -> Target:
    """The target of a setpoint or a goto; raises :class:`BadInput` for what does not fit together.

    A ``segment`` is many targets, and is for :class:`zmav.services.authority.trajectory.Segment`.
    """
    if not isinstance(point, wire.Setpoint):
        return _place(point, origin, point.yaw)
    group = group_of(point)
    if group == "motion":
        return _motion(point, origin)
    if group == "segment":
        raise BadInput("a segment is many points and not one", field="segment", expected="a single point")
    if point.frame != "ned":
        text = f"frame 'global' is for positions and velocities, and this is {group}"
        raise BadInput(text, field="frame", value=point.frame, expected="absent")
    if group == "attitude":
        return _attitude(point)
    if group == "torque":
        return Target(torque=vector("torque", point.torque, 1.0), thrust=_thrust(point.thrust))
    if point.manual is not None:
        return Target(manual=_sticks(point.manual))
    if point.rc is not None:
        return Target(rc=_pwm("rc", point.rc, RC_CHANNELS))
    return Target(servo=_pwm("servo", point.servo or [], SERVO_OUTPUTS))


def _motion(point: wire.Setpoint, origin: wire.Origin | None) -> Target:
    vel = vector("vel", point.vel, MAX_MOTION)
    acc = vector("acc", point.acc, MAX_MOTION)
    yaw, yaw_rate = number("yaw", point.yaw, MAX_ANGLE), number("yaw_rate", point.yaw_rate, MAX_ANGLE)
    placed = point.pos is not None if point.frame == "ned" else not (point.lat_deg is None and point.lon_deg is None)
    if placed:
        return _place(point, origin, yaw, vel, acc, yaw_rate)
    _refuse_other_frame(point)
    for name in ("alt_amsl", "alt_rel"):
        if getattr(point, name) is not None:
            text = f"{name} needs lat_deg and lon_deg beside it"
            raise BadInput(text, field="lat_deg", value=None, expected="a latitude")
    if vel is None and acc is None:
        text = "neither a position nor a velocity is given, nor an acceleration: a yaw alone is no setpoint"
        raise BadInput(text, field="pos", value=None, expected="pos, vel or acc")
    return Target(vel=vel, acc=acc, yaw=yaw, yaw_rate=yaw_rate)


def _place(
    point: wire.Setpoint | wire.GoTo,
    origin: wire.Origin | None,
    yaw: float | None,
    vel: wire.Vector | None = None,
    acc: wire.Vector | None = None,
    yaw_rate: float | None = None,
) -> Target:
    _refuse_other_frame(point)
    number("yaw", yaw, MAX_ANGLE)
    if point.frame == "ned":
        lat, lon, alt = to_global("pos", point.pos, origin)
        return Target(lat, lon, alt, None, vel, acc, yaw, yaw_rate)
    for name, most in (("lat_deg", 90.0), ("lon_deg", 180.0)):
        if number(name, getattr(point, name), most) is None:
            raise BadInput(f"{name} must be within ±{most:.0f}", field=name, value=None, expected=f"±{most:.0f}")
    if (point.alt_amsl is None) == (point.alt_rel is None):
        raise BadInput("give one of alt_amsl and alt_rel", field="alt_rel", value=point.alt_rel, expected="one of them")
    amsl, rel = number("alt_amsl", point.alt_amsl, MAX_DISTANCE), number("alt_rel", point.alt_rel, MAX_DISTANCE)
    return Target(point.lat_deg, point.lon_deg, amsl, rel, vel, acc, yaw, yaw_rate)


def to_global(field: str, pos: wire.Vector | None, origin: wire.Origin | None) -> tuple[float, float, float]:
    """Latitude, longitude and altitude AMSL of a point about the fleet's origin; raises :class:`BadInput`."""
    if pos is None:
        raise BadInput(f"{field} is missing", field=field, value=None, expected="north, east, down in metres")
    if origin is None:
        raise BadInput(
            "frame 'ned' is about the fleet's origin, and none is declared: give one (--origin, or origin in the "
            "fleet file), or use frame 'global'",
            field="frame",
            value="ned",
            expected="global",
        )
    vector(field, pos, MAX_DISTANCE)
    return geo.to_global(origin, pos)


def vector(field: str, value: wire.Vector | None, most: float) -> wire.Vector | None:
    """The vector itself; raises :class:`BadInput` where it is not finite or a part of it is beyond ``most``."""
    if value is not None:
        for part in value:
            if not -most <= part <= most:  # so that NaN is refused, too
                _refuse(field, list(value), most, finite=math.isfinite(part))
    return value


def number(field: str, value: float | None, most: float) -> float | None:
    """The number itself; raises :class:`BadInput` where it is not finite or beyond ``most``."""
    if value is not None and not -most <= value <= most:
        _refuse(field, value, most, finite=math.isfinite(value))
    return value


def _refuse(field: str, value: object, most: float, *, finite: bool) -> None:
    text = f"{field} must be within ±{most:g}" if finite else f"{field} is not finite"
    raise BadInput(text, field=field, value=str(value), expected=f"finite, within ±{most:g}")


def _refuse_other_frame(point: wire.Setpoint | wire.GoTo) -> None:
    ned = point.frame == "ned"
    for name in ("lat_deg", "lon_deg", "alt_amsl", "alt_rel") if ned else ("pos",):
        if getattr(point, name) is not None:
            theirs, ours = ("global", "ned") if ned else ("ned", "global")
            text = f"{name} belongs to frame {theirs!r}, not {ours!r}"
            raise BadInput(text, field=name, value=getattr(point, name), expected="absent")


def _attitude(point: wire.Setpoint) -> Target:
    thrust, rates = _thrust(point.thrust), vector("rates", point.rates, MAX_ANGLE)
    if point.attitude is None:
        return Target(rates=rates, thrust=thrust)
    q = point.attitude
    length = math.sqrt(sum(part * part for part in q)) if all(abs(part) <= 2.0 for part in q) else math.nan
    if not abs(length - 1.0) <= UNIT_WITHIN:
        text = f"attitude is a quaternion w, x, y, z of length 1, and this has {length:.3g}"
        raise BadInput(text, field="attitude", value=str(list(q)), expected=f"length 1 within {UNIT_WITHIN}")
    w, x, y, z = q
    return Target(attitude=(w / length, x / length, y / length, z / length), rates=rates, thrust=thrust)


def _thrust(thrust: float | None) -> float:
    if thrust is None:
        raise BadInput("thrust is missing beside it", field="thrust", value=None, expected="0 to 1")
    if not 0.0 <= thrust <= 1.0:
        raise BadInput(
            f"thrust must be from 0 to 1, not {thrust}", field="thrust", value=str(thrust), expected="0 to 1"
        )
    return thrust


def _sticks(manual: wire.ManualControl) -> wire.ManualControl:
    for name, least in (("x", -1.0), ("y", -1.0), ("z", 0.0), ("r", -1.0)):
        value = getattr(manual, name)
        if not least <= value <= 1.0:
            text = f"manual.{name} must be from {least:g} to 1, not {value}"
            raise BadInput(text, field=f"manual.{name}", value=str(value), expected=f"{least:g} to 1")
    if not 0 <= manual.buttons <= 0xFFFF:
        text = f"manual.buttons are 16 bits, not {manual.buttons}"
        raise BadInput(text, field="manual.buttons", value=manual.buttons, expected="0 to 65535")
    return manual


def _pwm(field: str, values: list[int | None], most: int) -> tuple[int | None, ...]:
    if not 1 <= len(values) <= most or all(value is None for value in values):
        text = f"{field} needs 1 to {most} values in µs, at least one of them not null"
        raise BadInput(text, field=field, value=len(values), expected=f"1 to {most} values")
    for index, value in enumerate(values):
        if value is not None and not PWM[0] <= value <= PWM[1]:
            text = f"{field}[{index}] must be from {PWM[0]} to {PWM[1]} µs, not {value}"
            raise BadInput(text, field=f"{field}[{index}]", value=value, expected=f"{PWM[0]} to {PWM[1]}, or null")
    return tuple(values)
