"""SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET, as ArduPilot takes them in
GUIDED.

Masks and frames: https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html. Outside GUIDED they are
ignored, as are frames that do not exist and numbers that are none.
"""

from __future__ import annotations

import math
from typing import Any

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.ardupilot.plan import TERRAIN
from zmav.sim.autopilots.ardupilot.state import AttitudeTarget, Quaternion, Target, YawWish
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector, from_nose
from zmav.sim.geo import Position, to_ned

_POS, _VEL, _ACC = 0x007, 0x038, 0x1C0  # POSITION_TARGET_TYPEMASK
_FORCE, _NO_YAW, _NO_YAW_RATE = 0x200, 0x400, 0x800
LOCAL, BODY_FRAMES, LOCAL_FRAMES = 1, (8, 9), (1, 7, 8, 9)  # MAV_FRAME: local, offset, body, body offset
_ABSOLUTE = (0, 5)
_RELATIVE = (3, 6, 10, 11)  # above home, or the terrain
_NO_RATES, _NO_THRUST, _NO_ATTITUDE = 7, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_FASTEST_TURN = 100.0  # rad/s
_THRUST_IS_THRUST = 8  # GUID_OPTIONS
_WAYPOINT, _GUIDED_ITEM = 16, 2
_MOST = 1000.0  # m/s, m/s^2
_FARTHEST = 1e7  # m
_HIGHEST = 80_000.0  # m, up or down: what ArduPilot keeps as an altitude


def local_target(vehicle: ArduVehicle, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_LOCAL_NED."""
    if not vehicle.takes_targets:
        return
    frame, mask = msg["coordinate_frame"], msg["type_mask"]
    if frame not in LOCAL_FRAMES or _asks_force(mask):
        vehicle.guided.hold()
        return
    about = vehicle.sense.yaw if frame in BODY_FRAMES else 0.0
    _, vel, acc = _vectors(msg, mask, ("x", "y", "z"))
    pos = None if mask & _POS else local_place(vehicle, msg)
    _apply(vehicle, Target(pos, _turn(vel, about), _turn(acc, about), _yaw(msg, mask, about)))


def local_place(vehicle: ArduVehicle, msg: dict[str, Any]) -> Vector:
    """Where a SET_POSITION_TARGET_LOCAL_NED is, in the world's NED."""
    s, frame = vehicle.sense, msg["coordinate_frame"]
    about = vehicle.origin_world if frame == LOCAL else (s.north, s.east, s.down)
    north, east, down = from_nose(_three(msg, ("x", "y", "z")), s.yaw if frame in BODY_FRAMES else 0.0)
    return about[0] + north, about[1] + east, about[2] + down


def global_target(vehicle: ArduVehicle, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_GLOBAL_INT."""
    if not vehicle.takes_targets:
        return
    mask = msg["type_mask"]
    pos, vel, acc = _vectors(msg, mask, ("lat_int", "lon_int", "alt"))
    if pos is not None:
        pos = point(vehicle, msg["lat_int"], msg["lon_int"], msg["alt"], msg["coordinate_frame"])
        if pos is None:
            vehicle.guided.hold()
            return
        if vel is not None:
            acc = None  # not taken beside a position and a velocity
    if _asks_force(mask):
        vehicle.guided.hold()
        return
    _apply(vehicle, Target(pos, vel, acc, _yaw(msg, mask, 0.0)))


def point(vehicle: ArduVehicle, lat_e7: int, lon_e7: int, alt: float, frame: int) -> Vector | None:
    """A place in degrees times 1e7 and metres, in the world's NED; None where there is no such place or frame."""
    if abs(lat_e7) > 900_000_000 or abs(lon_e7) > 1_800_000_000 or not abs(alt) < _HIGHEST:
        return None
    north, east, down = to_ned(Position(lat_e7 * 1e-7, lon_e7 * 1e-7, alt), vehicle.world)
    if frame in _RELATIVE:
        down = vehicle.home_world[2] - alt - (vehicle.above_home(north, east) if frame in TERRAIN else 0.0)
    elif frame not in _ABSOLUTE:
        return None
    return north, east, down


def guided_item(vehicle: ArduVehicle, item: Item) -> MissionResult:
    """A mission item that is to be flown at once: a waypoint, in GUIDED only; others of that kind are merely taken."""
    if item.current != _GUIDED_ITEM:
        return MissionResult.ACCEPTED
    place = point(vehicle, item.x, item.y, item.z, item.frame)
    if not vehicle.takes_targets or item.command != _WAYPOINT or place is None or not vehicle.fence.allows(place):
        return MissionResult.ERROR
    vehicle.guided.aim(Target(pos=place))
    return MissionResult.ACCEPTED


def attitude_target(vehicle: ArduVehicle, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET; the thrust field is a climb rate (0.5: none) unless GUID_OPTIONS says otherwise.

    The attitude, the body rates or both are flown; of the rates all three or none are to be given.
    """
    if not vehicle.takes_targets:
        return
    mask, thrust = msg["type_mask"], msg["thrust"]
    rates = (msg["body_roll_rate"], msg["body_pitch_rate"], msg["body_yaw_rate"])
    ignored = mask & _NO_RATES
    attitude = None if mask & _NO_ATTITUDE else _unit(msg["q"])
    senseless = attitude is None and not mask & _NO_ATTITUDE
    if mask & _NO_THRUST or senseless or not math.isfinite(thrust) or ignored not in (0, _NO_RATES):
        vehicle.guided.hold()
        return
    if ignored:
        rates = (0.0, 0.0, 0.0)
    if not all(abs(rate) <= _FASTEST_TURN for rate in rates):
        vehicle.guided.hold()
        return
    if int(vehicle.params["GUID_OPTIONS"]) & _THRUST_IS_THRUST:
        vehicle.guided.lean(AttitudeTarget(attitude, rates, None, min(max(thrust, -1.0), 1.0)))
        return
    thrust = min(max(thrust, 0.0), 1.0)
    span = vehicle.params["WPNAV_SPEED_UP" if thrust > 0.5 else "WPNAV_SPEED_DN"] * 0.01
    vehicle.guided.lean(AttitudeTarget(attitude, rates, (thrust - 0.5) * 2.0 * span, None))


def _unit(q: list[float]) -> Quaternion | None:
    """The quaternion at unit length; None for one that is far from it."""
    norm = math.sqrt(sum(c * c for c in q))
    if not abs(norm - 1.0) < 1e-3:
        return None
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _asks_force(mask: int) -> bool:
    """A force instead of an acceleration, which ArduVehicle does not take."""
    return bool(mask & _FORCE) and not mask & _ACC


def _vectors(
    msg: dict[str, Any], mask: int, names: tuple[str, str, str]
) -> tuple[Vector | None, Vector | None, Vector | None]:
    """Position, velocity and acceleration; one whose mask has any bit set is left out, as in ArduVehicle."""
    pos = _three(msg, names) if not mask & _POS else None
    vel = _three(msg, ("vx", "vy", "vz")) if not mask & _VEL else None
    acc = _three(msg, ("afx", "afy", "afz")) if not mask & _ACC else None
    return pos, vel, acc


def _three(msg: dict[str, Any], names: tuple[str, str, str]) -> Vector:
    return msg[names[0]], msg[names[1]], msg[names[2]]


def _turn(vector: Vector | None, yaw: float) -> Vector | None:
    return None if vector is None else from_nose(vector, yaw)


def _yaw(msg: dict[str, Any], mask: int, about: float) -> YawWish:
    if not mask & _NO_YAW and math.isfinite(msg["yaw"]):
        return YawWish(angle=about + msg["yaw"])
    if not mask & _NO_YAW_RATE and math.isfinite(msg["yaw_rate"]):
        return YawWish(rate=msg["yaw_rate"])
    return YawWish()


def _apply(vehicle: ArduVehicle, target: Target) -> None:
    """Hand it to GUIDED; vectors that are no numbers, or beyond reason, mean stop."""
    for vector, most in ((target.pos, _FARTHEST), (target.vel, _MOST), (target.acc, _MOST)):
        if vector is not None and not all(abs(c) <= most for c in vector):
            vehicle.guided.hold()
            return
    if target.pos is None or vehicle.fence.allows(target.pos):
        vehicle.guided.aim(target)
