"""Unit conversions, and the reports that all autopilots share."""

from __future__ import annotations

import math
from collections.abc import Iterable

from zmav.sim.environment import Vector
from zmav.sim.protocol.base import Fields, Node
from zmav.sim.sensors.readings import GpsFix


def e7(degrees: float) -> int:
    """Degrees as MAVLink's degE7."""
    return round(degrees * 1e7)


def centidegrees(yaw: float) -> int:
    """An angle in radians as 0 to 35999."""
    return round(math.degrees(yaw) * 100.0) % 36000


def int16(value: float) -> int:
    """Rounded, and held at the ends of its field."""
    return min(max(round(value), -32768), 32767)


def axes(form: str, values: Iterable[float]) -> Fields:
    """Three fields, called by ``form`` with x, y and z in it."""
    return {form.format(axis): value for axis, value in zip("xyz", values, strict=True)}


def numbered(form: str, values: Iterable[int]) -> Fields:
    """Fields that are called by ``form`` with 1, 2, ... in it."""
    return {form.format(i): value for i, value in enumerate(values, start=1)}


# ---- what every simulated autopilot says in the same way, or begins with


def gps_raw_int(node: Node, fix: GpsFix) -> Fields:
    """The place, the motion and the satellites of a solution; not how good it is."""
    here = node.brain.place((fix.north, fix.east, fix.down))
    return {
        "fix_type": node.receiver.fix_type(fix.fix_type),
        "lat": e7(here.lat_deg),
        "lon": e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "vel": min(round(math.hypot(fix.vn, fix.ve) * 100), 65534),
        "cog": centidegrees(math.atan2(fix.ve, fix.vn)),
        "satellites_visible": fix.satellites,
        "alt_ellipsoid": round(here.alt_amsl_m * 1000),
    }


def vfr_hud(node: Node, *, turning: bool, located: bool) -> Fields:
    """All but the airspeed. ``turning``: the motors may; ``located``: it knows its altitude."""
    brain, s = node.brain, node.brain.sense
    return {
        "groundspeed": math.hypot(s.vn, s.ve),
        "heading": int(math.degrees(s.yaw)) % 360,
        "throttle": round(abs(s.throttle) * 100) if turning else 0,
        "alt": brain.position.alt_amsl_m if located else 0.0,
        "climb": -s.vd,
    }


def attitude(node: Node) -> Fields:
    s = node.brain.sense
    rates = {"rollspeed": s.p, "pitchspeed": s.q, "yawspeed": s.r}
    return {"roll": s.roll, "pitch": s.pitch, "yaw": s.yaw, **rates}


def attitude_quaternion(node: Node) -> Fields:
    s = node.brain.sense
    rates = {"rollspeed": s.p, "pitchspeed": s.q, "yawspeed": s.r}
    return {"q1": s.qw, "q2": s.qx, "q3": s.qy, "q4": s.qz, **rates}


def attitude_target(node: Node, rate: tuple[float, float, float], thrust: float) -> Fields:
    """What a multirotor's loops ask for: body rates (rad/s), and the share of full thrust before the motors' curve."""
    s = node.brain.sense
    return {
        "q": [s.want_qw, s.want_qx, s.want_qy, s.want_qz],
        "body_roll_rate": rate[0],
        "body_pitch_rate": rate[1],
        "body_yaw_rate": rate[2],
        "thrust": thrust,
    }


def local_position_ned(node: Node) -> Fields | None:
    brain, s = node.brain, node.brain.sense
    if not brain.position_ok:
        return None
    return {**axes("{}", brain.local), **axes("v{}", (s.vn, s.ve, s.vd))}


def global_position_int(node: Node) -> Fields:
    """To be told by those who know where they are."""
    brain, s, here = node.brain, node.brain.sense, node.brain.position
    return {
        "lat": e7(here.lat_deg),
        "lon": e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "relative_alt": round((brain.home_world[2] - s.down) * 1000),
        "vx": round(s.vn * 100),
        "vy": round(s.ve * 100),
        "vz": round(s.vd * 100),
        "hdg": centidegrees(s.yaw),
    }


def home_position(node: Node) -> Fields:
    """All but the attitude there."""
    brain = node.brain
    home, origin = brain.home_world, brain.origin_world
    return {
        **_place(node, home),
        **axes("{}", (a - b for a, b in zip(home, origin, strict=True))),
    }


def gps_global_origin(node: Node) -> Fields:
    return _place(node, node.brain.origin_world)


def _place(node: Node, world: Vector) -> Fields:
    place = node.brain.place(world)
    return {
        "latitude": e7(place.lat_deg),
        "longitude": e7(place.lon_deg),
        "altitude": round(place.alt_amsl_m * 1000),
    }
