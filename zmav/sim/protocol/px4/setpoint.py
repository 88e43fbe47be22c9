"""The setpoint messages, as PX4 judges their masks: whatever is not ignored counts, axis by axis.

https://docs.px4.io/v1.16/en/flight_modes/offboard.html. A message that PX4 cannot use is no sign of life either.
"""

from __future__ import annotations

import math
from typing import Any

from zmav import rotation
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.autopilots.px4.modes import OFFBOARD
from zmav.sim.autopilots.px4.offboard import NOTHING, Attitude, Motion, Partial, Rates, Torque, Wish
from zmav.sim.control.setpoints import from_nose
from zmav.sim.geo import Position, to_ned

_LOCAL, _BODY = 1, 8  # MAV_FRAME
_ABSOLUTE, _RELATIVE, _TERRAIN = (0, 5), (3, 6), (10, 11)
_FORCE, _NO_YAW, _NO_YAW_RATE = 0x200, 0x400, 0x800  # POSITION_TARGET_TYPEMASK
_NO_ROLL_RATE, _NO_PITCH_RATE, _NO_YAW_TURN, _NO_THRUST, _NO_ATTITUDE = 1, 2, 4, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_ALL_RATES = _NO_ROLL_RATE | _NO_PITCH_RATE
_FARTHEST, _MOST = 1e7, 1000.0  # m; m/s, m/s^2, rad/s: beyond it the numbers, not the vehicle, would fly away
_CRITICAL = 2
_FLIGHT_CONTROL = 0  # group_mlx


def local_target(copter: Px4Copter, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_LOCAL_NED: about the EKF's origin, or (velocities only) about the nose."""
    frame, mask = msg["coordinate_frame"], msg["type_mask"]
    if frame not in (_LOCAL, _BODY):
        copter.say(_CRITICAL, f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported\t")
        return
    pos = _three(msg, mask, 0, ("x", "y", "z"), _FARTHEST)
    vel = _three(msg, mask, 3, ("vx", "vy", "vz"), _MOST)
    acc = _three(msg, mask, 6, ("afx", "afy", "afz"), _MOST)
    if frame == _BODY:
        yaw = copter.sense.yaw
        pos, vel, acc = NOTHING, _turned(vel, yaw), _turned(acc, yaw)
    else:
        pos = _shifted(pos, copter.origin_world)
    if not any(part is not None for part in (*pos, *vel, *acc)):
        copter.say(_CRITICAL, "SET_POSITION_TARGET_LOCAL_NED invalid\t")
        return
    _apply(copter, pos, vel, acc, msg)


def global_target(copter: Px4Copter, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_GLOBAL_INT."""
    mask = msg["type_mask"]
    pos: Partial = NOTHING
    if not mask & 0b111:
        place = point(copter, msg["lat_int"] * 1e-7, msg["lon_int"] * 1e-7, msg["alt"], msg["coordinate_frame"])
        if place is None:
            copter.say(
                _CRITICAL, f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {msg['coordinate_frame']}\t"
            )
            return
        pos = place
    vel = _three(msg, mask, 3, ("vx", "vy", "vz"), _MOST)
    acc = _three(msg, mask, 6, ("afx", "afy", "afz"), _MOST)
    if any(part is not None for part in (*pos, *vel, *acc)):
        _apply(copter, pos, vel, acc, msg)


def point(copter: Px4Copter, lat: float, lon: float, alt: float, frame: int) -> tuple[float, float, float] | None:
    """A place in degrees and metres of ``frame``, in the world's NED; None where there is no such place or frame."""
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0 and abs(alt) < 1e5 and copter.position_ok):
        return None
    north, east, down = to_ned(Position(lat, lon, alt), copter.world)
    if frame in _RELATIVE:
        down = copter.home_world[2] - alt
    elif frame in _TERRAIN:
        down = -alt  # the ground of the simulated world is flat
    elif frame not in _ABSOLUTE:
        return None
    return north, east, down


def attitude_target(copter: Px4Copter, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET: the attitude where it is given, else the body rates; both with the thrust."""
    mask = msg["type_mask"]
    by_attitude, by_rates = not mask & _NO_ATTITUDE, not mask & _ALL_RATES
    if not (by_attitude or by_rates):
        return
    copter.offboard.beat(needs_position=False)
    thrust = 0.0 if mask & _NO_THRUST else msg["thrust"]
    turn = None if mask & _NO_YAW_TURN else msg["body_yaw_rate"]
    numbers = [thrust, *msg["q"], msg["body_roll_rate"], msg["body_pitch_rate"], msg["body_yaw_rate"]]
    if copter.mode is not OFFBOARD or not all(math.isfinite(n) and abs(n) < _MOST for n in numbers):
        return
    thrust = min(max(thrust, 0.0), 1.0)
    wish: Wish
    if by_attitude:
        norm = math.sqrt(sum(c * c for c in msg["q"]))
        if norm < 1e-3:
            return
        wish = Attitude(*rotation.euler(c / norm for c in msg["q"]), turn, thrust)
    else:
        wish = Rates(msg["body_roll_rate"], msg["body_pitch_rate"], turn or 0.0, thrust)
    copter.offboard.take(wish)


def actuator_target(copter: Px4Copter, msg: dict[str, Any]) -> None:
    """Apply a SET_ACTUATOR_CONTROL_TARGET as PX4 1.13 did: group 0 is roll, pitch and yaw torque, -1 to 1, and thrust,
    0 to 1. https://docs.px4.io/v1.13/en/concept/mixing.html#control-group-0-flight-control
    """
    if msg["group_mlx"] != _FLIGHT_CONTROL:
        return
    copter.offboard.beat(needs_position=False)
    roll, pitch, yaw, thrust = msg["controls"][:4]
    if copter.mode is OFFBOARD and all(map(math.isfinite, (roll, pitch, yaw, thrust))):
        copter.offboard.take(Torque(roll, pitch, yaw, min(max(thrust, 0.0), 1.0)))


def _apply(copter: Px4Copter, pos: Partial, vel: Partial, acc: Partial, msg: dict[str, Any]) -> None:
    mask = msg["type_mask"]
    if mask & _FORCE and any(part is not None for part in acc):
        copter.say(_CRITICAL, "SET_POSITION_TARGET force not supported\t")
        return
    copter.offboard.beat(needs_position=any(part is not None for part in (*pos, *vel)))
    if copter.mode is not OFFBOARD:
        return
    yaw = None if mask & _NO_YAW or not math.isfinite(msg["yaw"]) else msg["yaw"]
    rate = None if mask & _NO_YAW_RATE or not math.isfinite(msg["yaw_rate"]) else msg["yaw_rate"]
    copter.offboard.take(Motion(pos, vel, acc, yaw, rate))


def _three(msg: dict[str, Any], mask: int, first_bit: int, names: tuple[str, str, str], most: float) -> Partial:
    """Three fields; an ignored one, or one that is no reasonable number, is None."""
    values: list[float | None] = []
    for offset, name in enumerate(names):
        value = msg[name]
        ignored = mask >> (first_bit + offset) & 1 or not abs(value) < most
        values.append(None if ignored else value)
    return values[0], values[1], values[2]


def _turned(vector: Partial, yaw: float) -> Partial:
    """From forward-right-down to north-east-down; all or nothing."""
    x, y, z = vector
    if x is None or y is None or z is None:
        return NOTHING
    return from_nose((x, y, z), yaw)


def _shifted(vector: Partial, about: tuple[float, float, float]) -> Partial:
    x, y, z = vector
    return (
        None if x is None else x + about[0],
        None if y is None else y + about[1],
        None if z is None else z + about[2],
    )
