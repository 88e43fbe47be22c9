"""What a PX4's sensors measure and its outputs are given.

Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.protocol.reports import Fields, boot_ms, boot_us, centidegrees, e7

if TYPE_CHECKING:
    from zmav.sim.protocol.px4.node import Px4Node

_AT_REST, _MOVING = 1023, 895  # ESTIMATOR_STATUS.flags
_DISARMED_PWM, _LEAST_PWM = 900, 1000


def gps_raw_int(node: Px4Node) -> Fields | None:
    copter, s = node.copter, node.copter.sense
    here = copter.position
    return {
        "time_usec": boot_us(node),
        "fix_type": 3,
        "lat": e7(here.lat_deg),
        "lon": e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "eph": 70,
        "epv": 110,
        "vel": min(round(math.hypot(s.vn, s.ve) * 100), 65534),
        "cog": centidegrees(math.atan2(s.ve, s.vn)),
        "satellites_visible": 10,
        "alt_ellipsoid": round(here.alt_amsl_m * 1000),
        "h_acc": 900,
        "v_acc": 1780,
        "vel_acc": 400,
    }


def highres_imu(node: Px4Node) -> Fields:
    s = node.copter.sense
    n, e, d = node.field
    w, x, y, z = s.qw, s.qx, s.qy, s.qz
    return {
        "time_usec": boot_us(node),
        "xacc": s.fx,
        "yacc": s.fy,
        "zacc": s.fz,
        "xgyro": s.p,
        "ygyro": s.q,
        "zgyro": s.r,
        # The Earth's field in body axes, gauss.
        "xmag": (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        "ymag": 2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        "zmag": 2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
        "abs_pressure": _pressure(node),
        "pressure_alt": node.copter.position.alt_amsl_m,
        "temperature": 15.0,
        "fields_updated": 0x1FF,
    }


def _pressure(node: Px4Node) -> float:
    """hPa; the International Standard Atmosphere up to 11 km."""
    height = node.copter.position.alt_amsl_m
    return float(1013.25 * (1.0 - 2.25577e-5 * min(height, 40000.0)) ** 5.25588)


def scaled_pressure(node: Px4Node) -> Fields:
    return {"time_boot_ms": boot_ms(node), "press_abs": _pressure(node), "temperature": 1180}


def distance_sensor(node: Px4Node) -> Fields:
    return {
        "time_boot_ms": boot_ms(node),
        "max_distance": 10000,
        "current_distance": min(max(round(-100.0 * node.copter.sense.true_down), 0), 10000),
        "orientation": 25,
    }


def servo_output_raw(node: Px4Node) -> Fields:
    armed = node.copter.armed
    pwm = [round(_LEAST_PWM + 1000 * u) if armed else _DISARMED_PWM for u in node.seat.outputs()]
    pwm += [_DISARMED_PWM] * (16 - len(pwm))
    return {"time_usec": boot_us(node), **{f"servo{i}_raw": value for i, value in enumerate(pwm, start=1)}}


def estimator_status(node: Px4Node) -> Fields | None:
    copter = node.copter
    if not copter.position_ok:
        return None
    return {
        "time_usec": boot_us(node),
        "flags": _MOVING if copter.armed else _AT_REST,
        "vel_ratio": 0.04,
        "pos_horiz_ratio": 0.02,
        "pos_vert_ratio": 0.02,
        "mag_ratio": 0.04,
        "hagl_ratio": 0.001,
        "tas_ratio": math.nan,
        "pos_horiz_accuracy": 0.29,
        "pos_vert_accuracy": 0.31,
    }


def vibration(node: Px4Node) -> Fields:
    level = 0.0 if node.copter.landed else 0.02
    return {"time_usec": boot_us(node), "vibration_x": 0.0, "vibration_y": 0.01, "vibration_z": 0.11 + level}
