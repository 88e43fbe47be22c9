"""What a PX4's sensors measure and its outputs are given.

Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math

from zmav.sim.protocol import reports
from zmav.sim.protocol.base import Fields
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.reports import axes, boot_ms, boot_us

FARTHEST_M = 100.0  # of the rangefinder of PX4's own simulation
_DISARMED_PWM, _LEAST_PWM = 900, 1000
_INERTIAL, _MAG, _BARO = 0x3F, 0x1C0, 0x1A00  # HIGHRES_IMU_UPDATED_FLAGS
_MAG_HZ, _BARO_HZ = 14.25, 10.0  # as recorded
_MOST_OUTPUTS, _CHANNELS, _NO_CHANNEL = 32, 18, 65535


def gps_raw_int(node: Px4Node) -> Fields:
    quality = {"eph": 70, "epv": 110, "h_acc": 900, "v_acc": 1780, "vel_acc": 400}
    return {**reports.gps_raw_int(node, node.seat.fix()), **quality}


def highres_imu(node: Px4Node) -> Fields:
    seen = node.seat.readings()
    # A compass and a barometer are slower than the messages: these say what is new.
    now = node.copter.uptime
    sampled, node.imu_seen = node.imu_seen, (int(now * _MAG_HZ), int(now * _BARO_HZ))
    fresh = [_MAG * (sampled[0] != node.imu_seen[0]), _BARO * (sampled[1] != node.imu_seen[1])]
    return {
        "time_usec": boot_us(node),
        **axes("{}acc", seen.accel),
        **axes("{}gyro", seen.gyro),
        **axes("{}mag", seen.mag),
        "abs_pressure": seen.pressure_hpa * 100.0,  # PX4 puts pascals into this field of hectopascals
        "pressure_alt": seen.pressure_alt_m,
        "temperature": 15.0,
        "fields_updated": _INERTIAL | sum(fresh),
    }


def distance_sensor(node: Px4Node) -> Fields:
    """Without an echo the farthest that it sees."""
    metres = node.seat.distance(nearest=0.0, farthest=FARTHEST_M, mount=0.0)
    metres = FARTHEST_M if math.isnan(metres) else metres
    return {
        "time_boot_ms": boot_ms(node),
        "max_distance": round(FARTHEST_M * 100),
        "current_distance": round(100.0 * metres),
        "orientation": 25,
    }


def servo_output_raw(node: Px4Node) -> Fields:
    armed = node.copter.armed
    pwm = [round(_LEAST_PWM + 1000 * u) if armed else _DISARMED_PWM for u in node.seat.outputs()]
    pwm += [_DISARMED_PWM] * (16 - len(pwm))
    return {"time_usec": boot_us(node), **{f"servo{i}_raw": value for i, value in enumerate(pwm, start=1)}}


def actuator_output_status(node: Px4Node) -> Fields:
    """The outputs in use, µs of PWM."""
    armed, outputs = node.copter.armed, node.seat.outputs()
    pwm = [_LEAST_PWM + 1000.0 * u if armed else float(_DISARMED_PWM) for u in outputs]
    return {"time_usec": boot_us(node), "active": len(pwm), "actuator": pwm + [0.0] * (_MOST_OUTPUTS - len(pwm))}


def rc_channels(node: Px4Node) -> Fields | None:
    """What the pilot's radio gives; nothing without one."""
    sticks = node.copter.sticks
    if not (sticks.radio and sticks.pilot.sending):
        return None
    pwm = [*sticks.pilot.pwm, *[_NO_CHANNEL] * (_CHANNELS - len(sticks.pilot.pwm))]
    return {
        "time_boot_ms": boot_ms(node),
        "chancount": len(sticks.pilot.pwm),
        "rssi": 100,
        **{f"chan{i}_raw": value for i, value in enumerate(pwm, start=1)},
    }


def estimator_status(node: Px4Node) -> Fields | None:
    copter = node.copter
    if copter.filter.good and not copter.position_ok:
        return None  # it has not been there yet
    ratios = copter.filter.ratios
    return {
        "time_usec": boot_us(node),
        "flags": copter.filter.flags,
        "vel_ratio": ratios["velocity"],
        "pos_horiz_ratio": ratios["position"],
        "pos_vert_ratio": ratios["height"],
        "mag_ratio": ratios["compass"],
        "hagl_ratio": 0.001,
        "tas_ratio": math.nan,
        "pos_horiz_accuracy": 0.29,
        "pos_vert_accuracy": 0.31,
    }


def vibration(node: Px4Node) -> Fields:
    level, shaken = 0.0 if node.copter.landed else 0.02, node.seat.vibration
    clipped = int(node.seat.clipped)
    return {
        "time_usec": boot_us(node),
        "vibration_x": shaken,
        "vibration_y": 0.01 + shaken,
        "vibration_z": 0.11 + level + shaken,
        "clipping_0": clipped,
    }
