"""What sensors measure and outputs are given."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.protocol.reports import Fields, boot_ms, boot_us, centidegrees, e7, int16

if TYPE_CHECKING:
    from zmav.sim.protocol.ardupilot.node import MavNode

MOST_RPM = 10_000.0
RECEIVED = 8  # channels of the receiver
_LEVEL_LOCKS, _YAW_LOCK, _YAW_IN_VEHICLE, _YAW_IN_EARTH = 4 | 8, 16, 32, 64  # GIMBAL_DEVICE_FLAGS


def gps_raw_int(node: MavNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    if not vehicle.gps_ok:
        return {"eph": 65535, "epv": 65535}
    here = vehicle.position
    speed = math.hypot(s.vn, s.ve)
    return {
        "time_usec": boot_us(node),
        "fix_type": 6,
        "lat": e7(here.lat_deg),
        "lon": e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "eph": 121,
        "epv": 200,
        "vel": min(round(speed * 100), 65534),
        "cog": centidegrees(math.atan2(s.ve, s.vn)),
        "satellites_visible": 10,
        "alt_ellipsoid": round(here.alt_amsl_m * 1000),
        "h_acc": 300,
        "v_acc": 300,
    }


def raw_imu(node: MavNode) -> Fields:
    return {"time_usec": boot_us(node), **_imu(node)}


def scaled_imu2(node: MavNode) -> Fields:
    return {"time_boot_ms": boot_ms(node), **_imu(node)}


def scaled_imu3(node: MavNode) -> Fields:
    """There are two accelerometers and gyroscopes, but three compasses."""
    return {"time_boot_ms": boot_ms(node), **_compass(node)}


def _imu(node: MavNode) -> Fields:
    s = node.vehicle.sense
    to_mg = 1000.0 / GRAVITY
    return {
        "xacc": int16(s.fx * to_mg),
        "yacc": int16(s.fy * to_mg),
        "zacc": int16(s.fz * to_mg),
        "xgyro": int16(s.p * 1000.0),
        "ygyro": int16(s.q * 1000.0),
        "zgyro": int16(s.r * 1000.0),
        "temperature": 3200,
        **_compass(node),
    }


def _compass(node: MavNode) -> Fields:
    """The Earth's field in body axes, milligauss."""
    s = node.vehicle.sense
    n, e, d = (1000.0 * part for part in node.field)
    w, x, y, z = s.qw, s.qx, s.qy, s.qz
    return {
        "xmag": int16((1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d),
        "ymag": int16(2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d),
        "zmag": int16(2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d),
    }


def scaled_pressure(node: MavNode) -> Fields:
    # The International Standard Atmosphere up to 11 km.
    height = node.vehicle.position.alt_amsl_m
    return {
        "time_boot_ms": boot_ms(node),
        "press_abs": 1013.25 * (1.0 - 2.25577e-5 * min(height, 40000.0)) ** 5.25588,
        "temperature": 3100,
    }


def terrain_report(node: MavNode) -> Fields | None:
    """The flat ground, as one who has no terrain data says it."""
    vehicle = node.vehicle
    if not vehicle.boot.has("origin"):
        return {"spacing": 100, "pending": 56}
    here = vehicle.position
    return {"lat": e7(here.lat_deg), "lon": e7(here.lon_deg), "current_height": here.alt_amsl_m, "pending": 504}


def esc_telemetry(node: MavNode) -> Fields:
    turning = [round(MOST_RPM * speed) for speed in node.seat.rotor_speeds()[:4]]
    volts = round(node.vehicle.voltage * 100)
    amps = round(node.vehicle.sense.current_a * 100 / node.vehicle.MOTORS)
    return {
        "temperature": [32] * 4,
        "voltage": [volts] * 4,
        "current": [amps] * 4,
        "totalcurrent": [round(node.vehicle.consumed_mah / 4)] * 4,
        "rpm": turning,
        "count": [int(node.vehicle.uptime * 400) % 65536] * 4,
    }


def vibration(node: MavNode) -> Fields:
    level = 0.02 if not node.vehicle.landed else 0.003
    return {"time_usec": boot_us(node), "vibration_x": level, "vibration_y": level, "vibration_z": level}


def rc_channels(node: MavNode) -> Fields:
    pwm = node.vehicle.rc.pwm
    fields: Fields = {f"chan{i}_raw": value % 65536 for i, value in enumerate(pwm, start=1)}
    return {"time_boot_ms": boot_ms(node), "chancount": RECEIVED, "rssi": 255, **fields}


def servo_output_raw(node: MavNode) -> Fields:
    """The motors on the first outputs, what DO_SET_SERVO set on the others; 0 where there is no signal."""
    outputs = [round(1000 + 1000 * u) for u in node.seat.outputs()]
    outputs += node.vehicle.payload.servos[len(outputs) :]
    return {"time_usec": boot_us(node), **{f"servo{i}_raw": pwm for i, pwm in enumerate(outputs, start=1)}}


def relay_status(node: MavNode) -> Fields:
    payload = node.vehicle.payload
    present = [i for i in range(len(payload.relays)) if payload.has_relay(i)]
    return {
        "time_boot_ms": boot_ms(node),
        "on": sum(1 << i for i in present if payload.relays[i]),
        "present": sum(1 << i for i in present),
    }


def camera_feedback(node: MavNode) -> Fields | None:
    """The last picture."""
    vehicle, camera = node.vehicle, node.vehicle.payload.camera
    if not camera.pictures:
        return None
    place, s = vehicle.place(camera.shot_place), vehicle.sense
    return {
        "time_usec": int((camera.shot_at - vehicle.booted_at) * 1e6),
        "img_idx": camera.pictures % 65536,
        "lat": e7(place.lat_deg),
        "lng": e7(place.lon_deg),
        "alt_msl": place.alt_amsl_m,
        "alt_rel": vehicle.home_world[2] - camera.shot_place[2],
        "roll": math.degrees(s.roll),
        "pitch": math.degrees(s.pitch),
        "yaw": math.degrees(s.yaw),
        "completed_captures": camera.pictures % 65536,
    }


def gimbal_device_attitude_status(node: MavNode) -> Fields | None:
    """Where the gimbal points: about the nose, or about north where it is locked to that."""
    gimbal = node.vehicle.payload.gimbal
    if not gimbal.present:
        return None
    yaw = gimbal.yaw if gimbal.locked else gimbal.yaw_ahead
    half = [math.radians(angle) / 2.0 for angle in (gimbal.roll, gimbal.pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = [math.cos(a) for a in half], [math.sin(a) for a in half]
    flags = _LEVEL_LOCKS | (_YAW_IN_EARTH | _YAW_LOCK if gimbal.locked else _YAW_IN_VEHICLE)
    return {
        "time_boot_ms": boot_ms(node),
        "flags": flags | {0: 1, 1: 2}.get(gimbal.mode, 0),
        "q": [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        "angular_velocity_x": math.nan,
        "angular_velocity_y": math.nan,
        "angular_velocity_z": math.nan,
        "delta_yaw": math.nan,
        "delta_yaw_velocity": math.nan,
        "gimbal_device_id": 1,
    }


def wind(node: MavNode) -> Fields | None:
    vehicle = node.vehicle
    if not vehicle.position_ok:
        return None
    north, east, down = node.seat.wind
    # Where it comes from.
    return {
        "direction": math.degrees(math.atan2(-east, -north)),
        "speed": math.hypot(north, east),
        "speed_z": down,
    }
