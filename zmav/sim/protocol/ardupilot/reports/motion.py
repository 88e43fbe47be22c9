"""Where the vehicle is, how it moves, and where it wants to go."""

from __future__ import annotations

import math

from zmav import rotation
from zmav.sim.autopilots.ardupilot.targets import Doing
from zmav.sim.control.setpoints import Vector
from zmav.sim.geo import Position
from zmav.sim.protocol import reports
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.base import Fields
from zmav.sim.protocol.reports import axes, boot_ms, centidegrees, e7


def global_position_int(node: ArduNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    if not vehicle.boot.has("gps"):
        return {"time_boot_ms": boot_ms(node), "hdg": centidegrees(s.yaw)}
    return reports.global_position_int(node)


def vfr_hud(node: ArduNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    wind_n, wind_e, wind_d = node.seat.wind
    airspeed = math.sqrt((s.vn - wind_n) ** 2 + (s.ve - wind_e) ** 2 + (s.vd - wind_d) ** 2)
    return {**reports.vfr_hud(node, turning=vehicle.armed, located=vehicle.boot.has("gps")), "airspeed": airspeed}


def attitude_target(node: ArduNode) -> Fields | None:
    """Copter's."""
    wanted = node.seat.wanted()
    if wanted.thrust is None:
        return None
    return reports.attitude_target(node, wanted.rate, wanted.thrust if node.vehicle.armed else 0.0)


def home_position(node: ArduNode) -> Fields | None:
    if not node.vehicle.boot.has("origin"):
        return None
    return {**reports.home_position(node), "q": [math.nan] * 4}


def nav_controller_output(node: ArduNode) -> Fields:
    s = node.vehicle.sense
    roll, pitch, _ = rotation.euler((s.want_qw, s.want_qx, s.want_qy, s.want_qz))
    fields: Fields = {
        "nav_roll": math.degrees(roll),
        "nav_pitch": math.degrees(pitch),
        "nav_bearing": round(math.degrees(s.want_yaw)),
    }
    target = _held_position(node)
    if target is not None:
        north, east = target[0] - s.north, target[1] - s.east
        fields.update(
            target_bearing=round(math.degrees(math.atan2(east, north))) % 360,
            wp_dist=min(round(math.hypot(north, east)), 65535),
            alt_error=s.down - target[2],
        )
    return fields


def _held_position(node: ArduNode) -> Vector | None:
    """The position that GUIDED or a mission flies to or holds, in the world's NED."""
    vehicle, guided = node.vehicle, node.vehicle.guided
    if vehicle.mode is vehicle.auto and vehicle.armed:
        return vehicle.auto.target
    if vehicle.mode is guided and guided.doing in (Doing.POSITION, Doing.POSITION_VELOCITY):
        return guided.target.pos
    return None


def position_target_local_ned(node: ArduNode) -> Fields | None:
    vehicle, guided = node.vehicle, node.vehicle.guided
    if vehicle.mode is not guided or guided.doing in (Doing.HOLD, Doing.ATTITUDE):
        return None
    mask = 0xC00  # yaw and yaw rate
    fields: Fields = {"time_boot_ms": boot_ms(node), "coordinate_frame": 1}
    north, east, down = vehicle.origin_world
    pos = guided.target.pos
    about = (pos[0] - north, pos[1] - east, pos[2] - down) if pos is not None else None
    for bits, vector, names in (
        (0x007, about, ("x", "y", "z")),
        (0x038, guided.target.vel, ("vx", "vy", "vz")),
        (0x1C0, guided.target.acc, ("afx", "afy", "afz")),
    ):
        if vector is None:
            mask |= bits
        else:
            fields.update(zip(names, vector, strict=True))
    fields["type_mask"] = mask
    return fields


def position_target_global_int(node: ArduNode) -> Fields | None:
    return target_place(node, _held_position(node))


def target_place(node: ArduNode, pos: Vector | None) -> Fields | None:
    """POSITION_TARGET_GLOBAL_INT of a place alone."""
    if pos is None:
        return None
    place = node.vehicle.place(pos)
    return {
        "time_boot_ms": boot_ms(node),
        "type_mask": 0xFDF8,
        "lat_int": e7(place.lat_deg),
        "lon_int": e7(place.lon_deg),
        "alt": place.alt_amsl_m,
    }


def simstate(node: ArduNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    true: Position = vehicle.place((s.true_north, s.true_east, s.true_down))
    return {
        "roll": s.roll,
        "pitch": s.pitch,
        "yaw": s.yaw,
        **axes("{}acc", (s.fx, s.fy, s.fz)),
        **axes("{}gyro", (s.p, s.q, s.r)),
        "lat": e7(true.lat_deg),
        "lng": e7(true.lon_deg),
    }


def ahrs2(node: ArduNode) -> Fields | None:
    vehicle, s = node.vehicle, node.vehicle.sense
    if not vehicle.boot.has("ekf_started"):
        return None
    here = vehicle.position if vehicle.boot.has("gps") else Position(0.0, 0.0, 0.0)
    return {
        "roll": s.roll,
        "pitch": s.pitch,
        "yaw": s.yaw,
        "altitude": here.alt_amsl_m,
        "lat": e7(here.lat_deg),
        "lng": e7(here.lon_deg),
    }
