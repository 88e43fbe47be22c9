"""Where a PX4 is, how it moves, and where it wants to go; None where it has nothing to say.

Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.px4.ground import Stage
from zmav.sim.autopilots.px4.modes import LAND, OFFBOARD
from zmav.sim.autopilots.px4.offboard import Motion
from zmav.sim.protocol import reports
from zmav.sim.protocol.base import Fields
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.reports import axes, boot_ms, boot_us, centidegrees, e7


def odometry(node: Px4Node) -> Fields:
    copter, s = node.copter, node.copter.sense
    return {
        "time_usec": boot_us(node),
        "frame_id": 1,
        "child_frame_id": 1,
        **axes("{}", copter.local),
        "q": [s.qw, s.qx, s.qy, s.qz],
        **axes("v{}", (s.vn, s.ve, s.vd)),
        "rollspeed": s.p,
        "pitchspeed": s.q,
        "yawspeed": s.r,
        "pose_covariance": _POSE_COVARIANCE,
        "velocity_covariance": _VELOCITY_COVARIANCE,
        "estimator_type": 8,
    }


def _diagonal(values: tuple[float, ...]) -> list[float]:
    """The upper triangle of a 6 by 6 matrix, row by row, that only knows its diagonal."""
    triangle = []
    for row in range(6):
        triangle += [values[row] if row < len(values) else math.nan] + [math.nan] * (5 - row)
    return triangle


_POSE_COVARIANCE = _diagonal((0.043, 0.043, 0.09, 0.0003, 0.0003, 0.02))
_VELOCITY_COVARIANCE = _diagonal((0.011, 0.01, 0.006))


def altitude(node: Px4Node) -> Fields:
    copter = node.copter
    amsl, height = copter.position.alt_amsl_m, copter.home_world[2] - copter.sense.down
    return {
        "time_usec": boot_us(node),
        "altitude_monotonic": amsl,
        "altitude_amsl": amsl,
        "altitude_local": -copter.local[2],
        "altitude_relative": height,
        "altitude_terrain": 0.0,
        "bottom_clearance": max(-copter.sense.down, 0.0),
    }


def vfr_hud(node: Px4Node) -> Fields:
    copter = node.copter
    return reports.vfr_hud(node, turning=copter.armed and not copter.landed, located=copter.position_ok)


def open_drone_id_location(node: Px4Node) -> Fields:
    copter, s = node.copter, node.copter.sense
    here = copter.position
    return {
        "status": 1 if copter.landed else 2,
        "direction": centidegrees(math.atan2(s.ve, s.vn)),
        "speed_horizontal": min(round(math.hypot(s.vn, s.ve) * 100), 25500),
        "speed_vertical": round(min(max(-s.vd, -62.0), 62.0) * 100),
        "latitude": e7(here.lat_deg),
        "longitude": e7(here.lon_deg),
        "altitude_barometric": here.alt_amsl_m,
        "altitude_geodetic": here.alt_amsl_m,
        "height": copter.home_world[2] - s.down,
        "horizontal_accuracy": 12,
        "vertical_accuracy": 5,
        "speed_accuracy": 3,
        "timestamp": 65535.0,
    }


def open_drone_id_system(node: Px4Node) -> Fields:
    copter = node.copter
    home = copter.place(copter.home_world)
    return {
        "operator_latitude": e7(home.lat_deg),
        "operator_longitude": e7(home.lon_deg),
        "area_count": 1,
        "area_ceiling": -1000.0,
        "area_floor": -1000.0,
        "operator_altitude_geo": home.alt_amsl_m,
    }


# ---- where it wants to go


def attitude_target(node: Px4Node) -> Fields:
    copter, wanted = node.copter, node.seat.wanted()
    if not copter.armed or copter.ground.stage in (Stage.STANDING, Stage.TOUCHED):
        return reports.attitude_target(node, (0.0, 0.0, 0.0), 0.0)
    return reports.attitude_target(node, wanted.rate, wanted.thrust or 0.0)


_NO = math.nan
_STANDING: Fields = {"vx": _NO, "vy": _NO, "vz": _NO, "afz": 100.0}  # so that it does not try to lift itself


def _loops(node: Px4Node) -> Fields:
    """Velocity and acceleration that the loops are asked for, and the heading."""
    wanted = node.seat.wanted()
    return {**axes("v{}", wanted.vel), **axes("af{}", wanted.acc), "yaw": node.copter.sense.want_yaw}


def position_target_local_ned(node: Px4Node) -> Fields | None:
    """What the position controller follows; nothing where attitude, rates or torques are streamed."""
    copter = node.copter
    wish = copter.offboard.wish if copter.armed and copter.mode is OFFBOARD else None
    if wish is not None and not isinstance(wish, Motion):
        return None
    fields: Fields = {"time_boot_ms": boot_ms(node), "coordinate_frame": 1}
    nowhere = {"x": _NO, "y": _NO, "z": _NO}
    if not copter.armed or copter.ground.stage in (Stage.STANDING, Stage.TOUCHED):
        return {**fields, **nowhere, **_STANDING, "type_mask": 63, "yaw": copter.sense.want_yaw}
    fields.update(_loops(node))
    if copter.failsafe.active and copter.mode.manual:
        return {**fields, **nowhere, "type_mask": 31, "vx": _NO, "vy": _NO, "afx": 0.0, "afy": 0.0}
    if wish is None:
        return {**fields, **axes("{}", copter.local)}
    mask, about = 0, copter.origin_world
    for axis, name in enumerate("xyz"):
        pos = wish.pos[axis]
        mask |= (pos is None) << axis
        fields[name] = _NO if pos is None else pos - about[axis]
    return {**fields, "type_mask": mask}


def position_target_global_int(node: Px4Node) -> Fields | None:
    """Where an AUTO mode goes; a landing has no altitude of its own."""
    copter = node.copter
    if not copter.armed or not copter.mode.auto:
        return None
    place = copter.place(copter.navigator.goal)
    standing = copter.ground.stage in (Stage.STANDING, Stage.TOUCHED)
    loops = {**_STANDING, "yaw": copter.sense.want_yaw} if standing else _loops(node)
    return {
        "time_boot_ms": boot_ms(node),
        "coordinate_frame": 5,
        "lat_int": e7(place.lat_deg),
        "lon_int": e7(place.lon_deg),
        "alt": 0.0 if copter.mode is LAND else place.alt_amsl_m,
        **loops,
    }
