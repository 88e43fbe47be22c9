"""What a PX4 multicopter reports, message by message (None where it has nothing to say), and which commands it takes.

Fill-ins are those of a recorded one. Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.px4.ground import Stage
from zmav.sim.autopilots.px4.modes import LAND, MISSION, OFFBOARD, TAKEOFF
from zmav.sim.autopilots.px4.offboard import Motion
from zmav.sim.protocol import reports as base
from zmav.sim.protocol.base import GIT_HASH, Fields, Handler, Report
from zmav.sim.protocol.gimbal import REPORTS as GIMBAL_REPORTS
from zmav.sim.protocol.px4.commands import HANDLERS
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.reports import axes, e7, int16

FARTHEST_M = 100.0  # of the rangefinder of PX4's own simulation
_DISARMED_PWM, _LEAST_PWM = 900, 1000
_INERTIAL, _MAG, _BARO = 0x3F, 0x1C0, 0x1A00  # HIGHRES_IMU_UPDATED_FLAGS
_MAG_HZ, _BARO_HZ = 14.25, 10.0  # as recorded
_MOST_OUTPUTS, _CHANNELS, _NO_CHANNEL = 32, 18, 65535
# Float and int missions, int commands, bytewise parameters, FTP, attitude, position and global targets, termination,
# MAVLink 2, fence, rally: what PX4 1.16.1 says of itself, and its version.
CAPABILITIES = 0xE8FF
TAKES_TORQUE = 0x400  # MAV_PROTOCOL_CAPABILITY_SET_ACTUATOR_TARGET, now reserved
VERSIONS = {"1.16": 0x011001FF, "1.13": 0x010D03FF}
_ARMED, _MANUAL, _STABILIZE, _GUIDED, _AUTO, _CUSTOM = 128, 64, 16, 8, 4, 1  # MAV_MODE_FLAG
_PRESENT, _ENABLED, _HEALTHY, _PREARM = 0x0300402F, 0x0301402F, 0x0320C83F, 0x10000000
_GPS = 0x20  # MAV_SYS_STATUS_SENSOR
_QUADROTOR, _HEXAROTOR = 2, 13
_NOT_MEASURED = -100  # cA


# ---- where it is, how it moves, and where it wants to go


def odometry(node: Px4Node) -> Fields:
    copter, s = node.copter, node.copter.sense
    return {
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
        "altitude_monotonic": amsl,
        "altitude_amsl": amsl,
        "altitude_local": -copter.local[2],
        "altitude_relative": height,
        "altitude_terrain": 0.0,
        "bottom_clearance": max(-copter.sense.down, 0.0),
    }


def vfr_hud(node: Px4Node) -> Fields:
    copter = node.copter
    return base.vfr_hud(node, turning=copter.armed and not copter.landed, located=copter.position_ok)


# ---- where it wants to go


def attitude_target(node: Px4Node) -> Fields:
    copter, wanted = node.copter, node.seat.wanted()
    if not copter.armed or copter.ground.stage in (Stage.STANDING, Stage.TOUCHED):
        return base.attitude_target(node, (0.0, 0.0, 0.0), 0.0)
    return base.attitude_target(node, wanted.rate, wanted.thrust or 0.0)


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
    fields: Fields = {"coordinate_frame": 1}
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
        "coordinate_frame": 5,
        "lat_int": e7(place.lat_deg),
        "lon_int": e7(place.lon_deg),
        "alt": 0.0 if copter.mode is LAND else place.alt_amsl_m,
        **loops,
    }


# ---- what sensors measure and outputs are given


def gps_raw_int(node: Px4Node) -> Fields:
    fix = node.seat.fix()
    h_acc = max(900, round(fix.eph_m * 1000))
    quality = {"eph": 70, "epv": 110, "h_acc": h_acc, "v_acc": 1780, "vel_acc": 400}
    return {**base.gps_raw_int(node, fix), **quality}


def highres_imu(node: Px4Node) -> Fields:
    seen = node.seat.readings()
    # A compass and a barometer are slower than the messages: these say what is new.
    now = node.copter.uptime
    sampled, node.imu_seen = node.imu_seen, (int(now * _MAG_HZ), int(now * _BARO_HZ))
    fresh = [_MAG * (sampled[0] != node.imu_seen[0]), _BARO * (sampled[1] != node.imu_seen[1])]
    return {
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
        "max_distance": round(FARTHEST_M * 100),
        "current_distance": round(100.0 * metres),
        "orientation": 25,
    }


def servo_output_raw(node: Px4Node) -> Fields:
    armed = node.copter.armed
    pwm = [round(_LEAST_PWM + 1000 * u) if armed else _DISARMED_PWM for u in node.seat.outputs()]
    pwm += [_DISARMED_PWM] * (16 - len(pwm))
    return base.numbered("servo{}_raw", pwm)


def actuator_output_status(node: Px4Node) -> Fields:
    """The outputs in use, µs of PWM."""
    armed, outputs = node.copter.armed, node.seat.outputs()
    pwm = [_LEAST_PWM + 1000.0 * u if armed else float(_DISARMED_PWM) for u in outputs]
    return {"active": len(pwm), "actuator": pwm + [0.0] * (_MOST_OUTPUTS - len(pwm))}


def rc_channels(node: Px4Node) -> Fields | None:
    """What the pilot's radio gives; nothing without one."""
    pilot = node.copter.pilot
    if not pilot.heard:
        return None
    pwm = [*pilot.pwm, *[_NO_CHANNEL] * (_CHANNELS - len(pilot.pwm))]
    return {
        "chancount": len(pilot.pwm),
        "rssi": 100,
        **base.numbered("chan{}_raw", pwm),
    }


def estimator_status(node: Px4Node) -> Fields | None:
    copter = node.copter
    if copter.filter.good and not copter.position_ok:
        return None  # it has not been there yet
    ratios = copter.filter.ratios
    return {
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
        "vibration_x": shaken,
        "vibration_y": 0.01 + shaken,
        "vibration_z": 0.11 + level + shaken,
        "clipping_0": clipped,
    }


# ---- how it is


def heartbeat(node: Px4Node) -> Fields:
    copter, mode = node.copter, node.copter.mode
    flags = _CUSTOM
    if copter.armed:
        flags |= _ARMED
    if mode.auto:
        flags |= _AUTO | _GUIDED | _STABILIZE
    elif mode.manual:
        flags |= _MANUAL | _STABILIZE
    elif mode is OFFBOARD and copter.offboard.known:
        flags |= _STABILIZE
    return {
        "type": _HEXAROTOR if len(copter.airframe.rotors) == 6 else _QUADROTOR,
        "autopilot": 12,
        "base_mode": flags,
        "custom_mode": mode.custom,
        "system_status": copter.system_status,
        "mavlink_version": 3,
    }


def current_mode(node: Px4Node) -> Fields:
    copter = node.copter
    return {
        "standard_mode": copter.mode.standard,
        "custom_mode": copter.mode.custom,
        "intended_custom_mode": copter.wanted.custom,
    }


def sys_status(node: Px4Node) -> Fields:
    copter = node.copter
    healthy = _HEALTHY if copter.filter.has_fix else _HEALTHY & ~_GPS
    return {
        "onboard_control_sensors_present": _PRESENT,
        "onboard_control_sensors_enabled": _ENABLED,
        "onboard_control_sensors_health": healthy | (_PREARM if copter.checks_ok else 0),
        "onboard_control_sensors_health_extended": 1,
        "load": 140,
        "voltage_battery": round(copter.battery.volts * 1000),
        "current_battery": _current(node),
        "battery_remaining": round(copter.battery.remaining * 100.0),
    }


def _current(node: Px4Node) -> int:
    amperes = node.copter.battery.amperes
    return _NOT_MEASURED if amperes is None else int16(amperes * 100.0)


def battery_status(node: Px4Node) -> Fields:
    battery = node.copter.battery
    return {
        "battery_function": 1,
        "type": 1,
        "temperature": 32767,
        "voltages": [round(battery.volts * 1000)] + [65535] * 9,
        "current_battery": _current(node),
        "current_consumed": round(battery.consumed_mah),
        "energy_consumed": -1,
        "battery_remaining": round(battery.remaining * 100.0),
        "charge_state": battery.charge_state,
    }


def extended_sys_state(node: Px4Node) -> Fields:
    copter = node.copter
    if copter.landed:
        return {"landed_state": 1}
    return {"landed_state": {TAKEOFF: 3, LAND: 4}.get(copter.mode, 2)}


def link_node_status(node: Px4Node) -> Fields:
    sent = sum(channel.sent for channel in node.channels)
    return {"timestamp": int(node.copter.uptime * 1e6), "tx_rate": 24000, "messages_sent": sent}


def autopilot_version(node: Px4Node) -> Fields:
    version = VERSIONS[node.firmware]
    return {
        "capabilities": CAPABILITIES | (TAKES_TORQUE if node.firmware == "1.13" else 0),
        "flight_sw_version": version,
        "middleware_sw_version": version,
        "os_sw_version": 0x061221FF,
        "board_version": 1,
        "flight_custom_version": list(GIT_HASH.encode("ascii")),
        "middleware_custom_version": list(GIT_HASH.encode("ascii")),
        "uid": node.uid,
    }


def mission_current(node: Px4Node) -> Fields:
    copter, mission = node.copter, node.copter.mission
    if not mission.able:
        return {"seq": 0, "total": 65535}
    return {
        "seq": mission.current,
        "total": len(mission.items),
        "mission_state": mission.state,
        "mission_mode": 1 if copter.mode is MISSION else 2,
        "mission_id": mission.items.opaque_id,
        "fence_id": copter.fence.opaque_id,
        "rally_points_id": copter.rally.opaque_id,
    }


def _located(report: Report) -> Report:
    """Nothing to say before it knows where it is."""
    return lambda node: report(node) if node.copter.position_ok else None


REPORTS: dict[str, Report] = {
    **GIMBAL_REPORTS,
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "SYSTEM_TIME": lambda node: {"time_unix_usec": node.unix_us},
    "PING": lambda node: {"seq": int(node.copter.uptime)},
    "LINK_NODE_STATUS": link_node_status,
    "GPS_RAW_INT": gps_raw_int,
    "SCALED_PRESSURE": lambda node: {
        "press_abs": node.seat.readings().pressure_hpa,
        "temperature": 1180,
    },
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": _located(base.global_position_int),
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "MISSION_CURRENT": mission_current,
    "GPS_GLOBAL_ORIGIN": _located(base.gps_global_origin),
    "VFR_HUD": vfr_hud,
    "ATTITUDE_TARGET": attitude_target,
    "POSITION_TARGET_LOCAL_NED": position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    "HIGHRES_IMU": highres_imu,
    "TIMESYNC": lambda node: {"tc1": 0, "ts1": node.nanoseconds()},
    "DISTANCE_SENSOR": distance_sensor,
    "ALTITUDE": _located(altitude),
    "BATTERY_STATUS": battery_status,
    "AUTOPILOT_VERSION": autopilot_version,
    "ACTUATOR_OUTPUT_STATUS": actuator_output_status,
    "RC_CHANNELS": rc_channels,
    "ESTIMATOR_STATUS": estimator_status,
    "VIBRATION": vibration,
    "HOME_POSITION": _located(lambda node: {**base.home_position(node), "q": [1.0, 0.0, 0.0, 0.0]}),
    "EXTENDED_SYS_STATE": extended_sys_state,
    "PROTOCOL_VERSION": lambda node: {"version": 200, "min_version": 100, "max_version": 200},
    "ODOMETRY": _located(odometry),
    "CURRENT_EVENT_SEQUENCE": lambda node: {"sequence": node.events_sent},
    "CURRENT_MODE": current_mode,
}


class Px4CopterNode(Px4Node):
    """Speaks for one :class:`~zmav.sim.autopilots.px4.copter.Px4Copter`."""

    HANDLERS: ClassVar[Mapping[int, Handler]] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
