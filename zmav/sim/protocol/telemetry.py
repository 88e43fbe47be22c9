"""What an ArduCopter reports: one function per message, with ArduPilot's signs, units and fill-ins.

Each takes the vehicle's :class:`~zmav.sim.protocol.node.MavNode` and gives the message's fields, or None where the
vehicle has nothing to say yet. Field conventions follow recordings of ArduCopter SITL; messages:
https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from zmav.sim.autopilots.boot import Flag
from zmav.sim.autopilots.guided import Doing
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.geo import Position

if TYPE_CHECKING:
    from zmav.sim.protocol.node import MavNode

Fields = dict[str, Any]
Report = Callable[["MavNode"], "Fields | None"]

# AUTOPILOT_VERSION.capabilities: float and int missions, float parameters, COMMAND_INT, attitude and position
# targets, flight termination, MAVLink 2, values cast to float.
CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000
VERSION = 0x04070000  # 4.7.0-dev
GIT_HASH = "zmav-sim"

_ARMED, _MANUAL, _STABILIZE, _GUIDED, _CUSTOM = 128, 64, 16, 8, 1  # MAV_MODE_FLAG
_PREARM_BIT = 0x10000000
_AHRS_BIT = 0x00200000
_SENSORS_PRESENT = 0x5371FC2F
_SENSORS_ENABLED = 0x52619C2F
_SENSORS_WHEN_ARMED = 0x01006000
_SENSORS_HEALTHY = 0x47719C2F
_SENSORS_BOOTING = 0x5331FC0F, 0x52019C0F, 0x45119C0B


def _e7(degrees: float) -> int:
    return round(degrees * 1e7)


def _ms(node: MavNode) -> int:
    return int(node.copter.uptime * 1000.0)


def _us(node: MavNode) -> int:
    return int(node.copter.uptime * 1e6)


def _cdeg(yaw: float) -> int:
    return round(math.degrees(yaw) * 100.0) % 36000


def heartbeat(node: MavNode) -> Fields:
    copter = node.copter
    mode = _MANUAL | _STABILIZE | _CUSTOM
    if copter.mode.needs_position or copter.mode.number == 9 or copter.system_status == 1:
        mode |= _GUIDED
    if copter.armed:
        mode |= _ARMED
    return {
        "type": 13 if len(copter.airframe.rotors) == 6 else 2,
        "autopilot": 3,
        "base_mode": mode,
        "custom_mode": copter.mode.number,
        "system_status": copter.system_status,
        "mavlink_version": 3,
    }


def sys_status(node: MavNode) -> Fields:
    copter = node.copter
    if not copter.boot.has("gps"):
        present, enabled, health = _SENSORS_BOOTING
    else:
        present, enabled, health = _SENSORS_PRESENT, _SENSORS_ENABLED, _SENSORS_HEALTHY
        if not copter.boot.has("prearm"):
            enabled, health = enabled & ~_AHRS_BIT, health & ~_AHRS_BIT
        if copter.armed:
            enabled |= _SENSORS_WHEN_ARMED
        if node.prearm_ok:
            health |= _PREARM_BIT
    return {
        "onboard_control_sensors_present": present,
        "onboard_control_sensors_enabled": enabled,
        "onboard_control_sensors_health": health,
        "voltage_battery": round(copter.airframe.battery_v * 1000),
        "current_battery": round(copter.sense.current_a * 100),
        "battery_remaining": _battery_left(node),
    }


def _battery_left(node: MavNode) -> int:
    capacity = max(node.copter.params["BATT_CAPACITY"], 1.0)
    return max(round(100.0 * (1.0 - node.copter.consumed_mah / capacity)), 0)


def battery_status(node: MavNode) -> Fields:
    copter = node.copter
    volts = copter.airframe.battery_v
    return {
        "temperature": 32767,
        "voltages": [round(volts * 1000)] + [65535] * 9,
        "current_battery": round(copter.sense.current_a * 100),
        "current_consumed": round(copter.consumed_mah),
        "energy_consumed": round(copter.consumed_mah * volts * 0.036),  # hectojoules
        "battery_remaining": _battery_left(node),
        "charge_state": 1,
    }


def power_status(node: MavNode) -> Fields:
    return {"Vcc": 5000}


def meminfo(node: MavNode) -> Fields:
    return {"freemem": 65535, "freemem32": 524288}


def system_time(node: MavNode) -> Fields:
    unix = node.unix_us if node.copter.boot.has("gps") else 0
    return {"time_unix_usec": unix, "time_boot_ms": _ms(node)}


def gps_raw_int(node: MavNode) -> Fields:
    copter, s = node.copter, node.copter.sense
    if not copter.boot.has("gps"):
        return {"eph": 65535, "epv": 65535}
    here = copter.position
    speed = math.hypot(s.vn, s.ve)
    return {
        "time_usec": _us(node),
        "fix_type": 6,
        "lat": _e7(here.lat_deg),
        "lon": _e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "eph": 121,
        "epv": 200,
        "vel": min(round(speed * 100), 65534),
        "cog": _cdeg(math.atan2(s.ve, s.vn)),
        "satellites_visible": 10,
        "alt_ellipsoid": round(here.alt_amsl_m * 1000),
        "h_acc": 300,
        "v_acc": 300,
    }


def attitude(node: MavNode) -> Fields:
    s = node.copter.sense
    return {
        "time_boot_ms": _ms(node),
        "roll": s.roll,
        "pitch": s.pitch,
        "yaw": s.yaw,
        "rollspeed": s.p,
        "pitchspeed": s.q,
        "yawspeed": s.r,
    }


def attitude_quaternion(node: MavNode) -> Fields:
    s = node.copter.sense
    return {
        "time_boot_ms": _ms(node),
        "q1": s.qw,
        "q2": s.qx,
        "q3": s.qy,
        "q4": s.qz,
        "rollspeed": s.p,
        "pitchspeed": s.q,
        "yawspeed": s.r,
    }


def local_position_ned(node: MavNode) -> Fields | None:
    copter, s = node.copter, node.copter.sense
    if not copter.position_ok:
        return None
    x, y, z = copter.local
    return {"time_boot_ms": _ms(node), "x": x, "y": y, "z": z, "vx": s.vn, "vy": s.ve, "vz": s.vd}


def global_position_int(node: MavNode) -> Fields:
    copter, s = node.copter, node.copter.sense
    if not copter.boot.has("origin"):
        return {"time_boot_ms": _ms(node), "hdg": _cdeg(s.yaw)}
    here = copter.position
    return {
        "time_boot_ms": _ms(node),
        "lat": _e7(here.lat_deg),
        "lon": _e7(here.lon_deg),
        "alt": round(here.alt_amsl_m * 1000),
        "relative_alt": round((copter.home_world[2] - s.down) * 1000),
        "vx": round(s.vn * 100),
        "vy": round(s.ve * 100),
        "vz": round(s.vd * 100),
        "hdg": _cdeg(s.yaw),
    }


def vfr_hud(node: MavNode) -> Fields:
    copter, s = node.copter, node.copter.sense
    speed = math.hypot(s.vn, s.ve)
    return {
        "airspeed": speed,
        "groundspeed": speed,
        "heading": int(math.degrees(s.yaw)) % 360,
        "throttle": round(s.throttle * 100) if copter.armed else 0,
        "alt": copter.position.alt_amsl_m if copter.boot.has("origin") else 0.0,
        "climb": -s.vd,
    }


def ekf_status_report(node: MavNode) -> Fields:
    flags = node.copter.boot.ekf_flags
    known = 0.0 if flags in (Flag(0), Flag.UNINITIALIZED) else 1.0
    return {
        "flags": int(flags),
        "velocity_variance": 0.008 * known,
        "pos_horiz_variance": 0.004 * known,
        "pos_vert_variance": 0.0005 * known,
        "compass_variance": 0.011 * known,
    }


def rc_channels(node: MavNode) -> Fields:
    fields: Fields = {f"chan{i}_raw": pwm for i, pwm in enumerate(node.copter.pilot.pwm, start=1)}
    return {"time_boot_ms": _ms(node), "chancount": len(fields), "rssi": 255, **fields}


def servo_output_raw(node: MavNode) -> Fields:
    fields: Fields = {f"servo{i}_raw": round(1000 + 1000 * u) for i, u in enumerate(node.throttles(), start=1)}
    return {"time_usec": _us(node), **fields}


def raw_imu(node: MavNode) -> Fields:
    return {"time_usec": _us(node), **_imu(node)}


def scaled_imu2(node: MavNode) -> Fields:
    return {"time_boot_ms": _ms(node), **_imu(node)}


def _imu(node: MavNode) -> Fields:
    s = node.copter.sense
    to_mg = 1000.0 / GRAVITY
    return {
        "xacc": _i16(s.fx * to_mg),
        "yacc": _i16(s.fy * to_mg),
        "zacc": _i16(s.fz * to_mg),
        "xgyro": _i16(s.p * 1000.0),
        "ygyro": _i16(s.q * 1000.0),
        "zgyro": _i16(s.r * 1000.0),
        "temperature": 3200,
    }


def _i16(value: float) -> int:
    return min(max(round(value), -32768), 32767)


def scaled_pressure(node: MavNode) -> Fields:
    # The International Standard Atmosphere up to 11 km.
    height = node.copter.position.alt_amsl_m
    return {
        "time_boot_ms": _ms(node),
        "press_abs": 1013.25 * (1.0 - 2.25577e-5 * min(height, 40000.0)) ** 5.25588,
        "temperature": 3100,
    }


def vibration(node: MavNode) -> Fields:
    level = 0.02 if not node.copter.landed else 0.003
    return {"time_usec": _us(node), "vibration_x": level, "vibration_y": level, "vibration_z": level}


def nav_controller_output(node: MavNode) -> Fields:
    s = node.copter.sense
    fields: Fields = {
        "nav_roll": math.degrees(s.want_roll),
        "nav_pitch": math.degrees(s.want_pitch),
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


def _held_position(node: MavNode) -> Vector | None:
    """The position GUIDED flies to or holds, in the world's NED."""
    guided = node.copter.guided
    if node.copter.mode is guided and guided.doing in (Doing.POSITION, Doing.POSITION_VELOCITY):
        return guided.target.pos
    return None


def mission_current(node: MavNode) -> Fields:
    return {"mission_state": 1}


def extended_sys_state(node: MavNode) -> Fields:
    copter = node.copter
    if copter.landed and not (copter.armed and copter.guided.taking_off):
        return {"landed_state": 1}
    if copter.mode is copter.guided and copter.guided.taking_off:
        return {"landed_state": 3}
    return {"landed_state": 4 if copter.mode.number == 9 else 2}


def home_position(node: MavNode) -> Fields | None:
    copter = node.copter
    if not copter.boot.has("origin"):
        return None
    home, origin = copter.home_world, copter.origin_world
    place = copter.place(home)
    return {
        "latitude": _e7(place.lat_deg),
        "longitude": _e7(place.lon_deg),
        "altitude": round(place.alt_amsl_m * 1000),
        "x": home[0] - origin[0],
        "y": home[1] - origin[1],
        "z": home[2] - origin[2],
        "q": [math.nan] * 4,
        "time_usec": _us(node),
    }


def gps_global_origin(node: MavNode) -> Fields | None:
    copter = node.copter
    if not copter.boot.has("origin"):
        return None
    place = copter.place(copter.origin_world)
    return {
        "latitude": _e7(place.lat_deg),
        "longitude": _e7(place.lon_deg),
        "altitude": round(place.alt_amsl_m * 1000),
        "time_usec": _us(node),
    }


def autopilot_version(node: MavNode) -> Fields:
    return {
        "capabilities": CAPABILITIES,
        "flight_sw_version": VERSION,
        "flight_custom_version": list(GIT_HASH.encode("ascii")),
        "uid": node.uid,
        "uid2": list(node.uid.to_bytes(8, "little")) + [0] * 10,
    }


def position_target_local_ned(node: MavNode) -> Fields | None:
    copter, guided = node.copter, node.copter.guided
    if copter.mode is not guided or guided.doing in (Doing.HOLD, Doing.ATTITUDE):
        return None
    mask = 0xC00  # yaw and yaw rate
    fields: Fields = {"time_boot_ms": _ms(node), "coordinate_frame": 1}
    north, east, down = copter.origin_world
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


def position_target_global_int(node: MavNode) -> Fields | None:
    pos = _held_position(node)
    if pos is None:
        return None
    place = node.copter.place(pos)
    return {
        "time_boot_ms": _ms(node),
        "type_mask": 0xFDF8,
        "lat_int": _e7(place.lat_deg),
        "lon_int": _e7(place.lon_deg),
        "alt": place.alt_amsl_m,
    }


def simstate(node: MavNode) -> Fields:
    copter, s = node.copter, node.copter.sense
    true: Position = copter.place((s.true_north, s.true_east, s.true_down))
    return {
        "roll": s.roll,
        "pitch": s.pitch,
        "yaw": s.yaw,
        "xacc": s.fx,
        "yacc": s.fy,
        "zacc": s.fz,
        "xgyro": s.p,
        "ygyro": s.q,
        "zgyro": s.r,
        "lat": _e7(true.lat_deg),
        "lng": _e7(true.lon_deg),
    }


def ahrs(node: MavNode) -> Fields:
    return {"error_rp": 0.004, "error_yaw": 0.004}


def ahrs2(node: MavNode) -> Fields | None:
    copter, s = node.copter, node.copter.sense
    if not copter.boot.has("ekf_started"):
        return None
    here = copter.position if copter.boot.has("origin") else Position(0.0, 0.0, 0.0)
    return {
        "roll": s.roll,
        "pitch": s.pitch,
        "yaw": s.yaw,
        "altitude": here.alt_amsl_m,
        "lat": _e7(here.lat_deg),
        "lng": _e7(here.lon_deg),
    }


def wind(node: MavNode) -> Fields | None:
    copter = node.copter
    if not copter.position_ok:
        return None
    north, east, down = node.wind
    # Where it comes from.
    return {
        "direction": math.degrees(math.atan2(-east, -north)),
        "speed": math.hypot(north, east),
        "speed_z": down,
    }


REPORTS: dict[str, Report] = {
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "SYSTEM_TIME": system_time,
    "GPS_RAW_INT": gps_raw_int,
    "RAW_IMU": raw_imu,
    "SCALED_PRESSURE": scaled_pressure,
    "ATTITUDE": attitude,
    "ATTITUDE_QUATERNION": attitude_quaternion,
    "LOCAL_POSITION_NED": local_position_ned,
    "GLOBAL_POSITION_INT": global_position_int,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "MISSION_CURRENT": mission_current,
    "GPS_GLOBAL_ORIGIN": gps_global_origin,
    "NAV_CONTROLLER_OUTPUT": nav_controller_output,
    "RC_CHANNELS": rc_channels,
    "VFR_HUD": vfr_hud,
    "POSITION_TARGET_LOCAL_NED": position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    "SCALED_IMU2": scaled_imu2,
    "POWER_STATUS": power_status,
    "BATTERY_STATUS": battery_status,
    "AUTOPILOT_VERSION": autopilot_version,
    "MEMINFO": meminfo,
    "AHRS": ahrs,
    "SIMSTATE": simstate,
    "WIND": wind,
    "AHRS2": ahrs2,
    "EKF_STATUS_REPORT": ekf_status_report,
    "VIBRATION": vibration,
    "HOME_POSITION": home_position,
    "EXTENDED_SYS_STATE": extended_sys_state,
}
