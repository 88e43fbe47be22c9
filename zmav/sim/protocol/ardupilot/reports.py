"""What an ArduPilot reports: one function per message, with ArduPilot's signs, units and fill-ins.

Each takes the vehicle's :class:`~zmav.sim.protocol.ardupilot.node.MavNode` and gives the message's fields, or None
where the vehicle has nothing to say yet. Field conventions follow recordings of ArduPilot SITL; messages:
https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math

from zmav import rotation
from zmav.sim.autopilots.ardupilot.boot import Flag
from zmav.sim.autopilots.ardupilot.fence import CEILING, CIRCLE, POLYGON
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.state import Doing
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.geo import Position
from zmav.sim.protocol import reports as base
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.base import GIT_HASH, Fields, Report
from zmav.sim.protocol.gimbal import REPORTS as GIMBAL_REPORTS
from zmav.sim.protocol.reports import axes, centidegrees, e7, int16, numbered
from zmav.sim.sensors.readings import Readings
from zmav.sim.sensors.suite import RANGE_MAX_M, RANGE_MIN_M

MOST_RPM = 10_000.0
_RTK, _RTK_M = 6, 0.3  # GPS_FIX_TYPE: what SITL's receiver claims; and the error from which on ours claims less
_DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
RECEIVED = 8  # channels of the receiver
# AUTOPILOT_VERSION.capabilities: float and int missions, float parameters, COMMAND_INT, FTP, attitude and
# position targets, flight termination, MAVLink 2, values cast to float, fences and rally points as missions.
CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000 | 0x4000 | 0x8000
VERSION = 0x04070000  # 4.7.0-dev

_ARMED, _MANUAL, _STABILIZE, _GUIDED, _CUSTOM = 128, 64, 16, 8, 1  # MAV_MODE_FLAG
_PREARM_BIT = 0x10000000
_AHRS_BIT = 0x00200000
_SENSORS_PRESENT = 0x5371FC2F
_SENSORS_ENABLED = 0x52619C2F
_SENSORS_WHEN_ARMED = 0x01006000
_SENSORS_HEALTHY = 0x47719C2F
_SENSORS_BOOTING = 0x5331FC0F, 0x52019C0F, 0x45119C0B


# ---- where it is, how it moves, and where it wants to go


def global_position_int(node: ArduNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    if not vehicle.boot.has("gps"):
        return {"hdg": centidegrees(s.yaw)}
    return base.global_position_int(node)


def vfr_hud(node: ArduNode) -> Fields:
    vehicle, s = node.vehicle, node.vehicle.sense
    wind_n, wind_e, wind_d = node.seat.wind
    airspeed = math.sqrt((s.vn - wind_n) ** 2 + (s.ve - wind_e) ** 2 + (s.vd - wind_d) ** 2)
    return {**base.vfr_hud(node, turning=vehicle.armed, located=vehicle.boot.has("gps")), "airspeed": airspeed}


def attitude_target(node: ArduNode) -> Fields | None:
    """Copter's."""
    wanted = node.seat.wanted()
    if wanted.thrust is None:
        return None
    return base.attitude_target(node, wanted.rate, wanted.thrust if node.vehicle.armed else 0.0)


def home_position(node: ArduNode) -> Fields | None:
    if not node.vehicle.boot.has("origin"):
        return None
    return {**base.home_position(node), "q": [math.nan] * 4}


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
    fields: Fields = {"coordinate_frame": 1}
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
        "type_mask": 0xFDF8,
        "lat_int": e7(place.lat_deg),
        "lon_int": e7(place.lon_deg),
        "alt": place.alt_amsl_m,
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


# ---- what sensors measure and outputs are given


def gps_raw_int(node: ArduNode) -> Fields:
    fix = node.seat.fix() if node.vehicle.boot.has("gps") else None
    if fix is None:
        return {"time_usec": 0, "eph": 65535, "epv": 65535}
    return {
        **base.gps_raw_int(node, fix),
        "fix_type": node.receiver.fix_type(_RTK if fix.fix_type >= 3 and fix.eph_m <= _RTK_M else fix.fix_type),
        "eph": round(fix.hdop * 100),
        "epv": round(fix.vdop * 100),
        "h_acc": round(fix.eph_m * 1000),
        "v_acc": round(fix.epv_m * 1000),
    }


def imu(node: ArduNode) -> Fields:
    seen = node.seat.readings()
    to_mg = 1000.0 / GRAVITY
    return {
        **axes("{}acc", (int16(part * to_mg) for part in seen.accel)),
        **axes("{}gyro", (int16(part * 1000.0) for part in seen.gyro)),
        "temperature": 3200,
        **compass(seen),
    }


def compass(seen: Readings) -> Fields:
    """Milligauss."""
    return axes("{}mag", (int16(1000.0 * part) for part in seen.mag))


def scaled_pressure(node: ArduNode) -> Fields:
    seen = node.seat.readings()
    return {
        "press_abs": seen.pressure_hpa,
        "press_diff": _pitot(node, seen),
        "temperature": 3100,
    }


def _pitot(node: ArduNode, seen: Readings) -> float:
    """Of the tube, where there is one."""
    params = node.vehicle.params
    return seen.diff_pressure_hpa if "ARSPD_TYPE" in params and params["ARSPD_TYPE"] > 0 else 0.0


def rangefinder(node: ArduNode) -> Fields | None:
    """The downward one, where RNGFND1_TYPE names any; 0 m without an echo."""
    if node.vehicle.params["RNGFND1_TYPE"] <= 0:
        return None
    metres = node.seat.readings().range_m
    return {"distance": 0.0 if math.isnan(metres) else metres, "voltage": 0.0}


def distance_sensor(node: ArduNode) -> Fields | None:
    if node.vehicle.params["RNGFND1_TYPE"] <= 0:
        return None
    metres = node.seat.readings().range_m
    return {
        "min_distance": round(RANGE_MIN_M * 100),
        "max_distance": round(RANGE_MAX_M * 100),
        "current_distance": 0 if math.isnan(metres) else round(metres * 100),
        "orientation": _DOWNWARD,
    }


def esc_telemetry(node: ArduNode) -> Fields:
    turning = [round(MOST_RPM * speed) for speed in node.seat.rotor_speeds()[:4]]
    volts = round(node.vehicle.voltage * 100)
    amps = min(round(node.vehicle.sense.current_a * 100 / node.vehicle.MOTORS), 65535)
    return {
        "temperature": [32] * 4,
        "voltage": [volts] * 4,
        "current": [amps] * 4,
        "totalcurrent": [round(node.vehicle.consumed_mah / 4)] * 4,
        "rpm": turning,
        "count": [int(node.vehicle.uptime * 400) % 65536] * 4,
    }


def vibration(node: ArduNode) -> Fields:
    level = (0.02 if not node.vehicle.landed else 0.003) + node.seat.vibration
    clipped = int(node.seat.clipped)
    return {**axes("vibration_{}", [level] * 3), "clipping_0": clipped, "clipping_1": clipped}


def rc_channels(node: ArduNode) -> Fields:
    pwm = [value % 65536 for value in node.vehicle.rc.pwm]
    return {"chancount": RECEIVED, "rssi": 255, **numbered("chan{}_raw", pwm)}


def servo_output_raw(node: ArduNode) -> Fields:
    """The motors on the first outputs, what DO_SET_SERVO set on the others; 0 where there is no signal."""
    outputs = [round(1000 + 1000 * u) for u in node.seat.outputs()]
    outputs += node.vehicle.servos[len(outputs) :]
    return numbered("servo{}_raw", outputs)


def centred_pulse(node: ArduNode, channel: int, value: float) -> int:
    """Of an output that goes from -1 to 1 about its trim, us."""
    params = node.vehicle.params
    low, middle, high = (params[f"SERVO{channel}_{part}"] for part in ("MIN", "TRIM", "MAX"))
    if params[f"SERVO{channel}_REVERSED"]:
        value = -value
    return round(middle + value * (high - middle if value > 0 else middle - low))


def wind(node: ArduNode) -> Fields | None:
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


# ---- how it is


def heartbeat(node: ArduNode) -> Fields:
    """Copter's."""
    mode, status = node.vehicle.mode, node.vehicle.system_status
    return heartbeat_with(
        node, manual=True, stabilised=True, guided=mode.needs_position or mode.number == 9 or status == 1
    )


def heartbeat_with(node: ArduNode, *, manual: bool, stabilised: bool, guided: bool) -> Fields:
    """HEARTBEAT with those MAV_MODE_FLAG; whether it is armed is added."""
    vehicle = node.vehicle
    flags = _ARMED * vehicle.armed | _MANUAL * manual | _STABILIZE * stabilised | _GUIDED * guided | _CUSTOM
    return {
        "type": vehicle.MAV_TYPE,
        "autopilot": 3,
        "base_mode": flags,
        "custom_mode": vehicle.mode.number,
        "system_status": vehicle.system_status,
        "mavlink_version": 3,
    }


def sys_status(node: ArduNode) -> Fields:
    vehicle = node.vehicle
    if not vehicle.boot.has("gps"):
        present, enabled, health = _SENSORS_BOOTING
    else:
        present, enabled, health = _SENSORS_PRESENT, _SENSORS_ENABLED, _SENSORS_HEALTHY
        if not vehicle.boot.has("prearm"):
            enabled, health = enabled & ~_AHRS_BIT, health & ~_AHRS_BIT
        if vehicle.armed:
            enabled |= _SENSORS_WHEN_ARMED
        if node.prearm_ok:
            health |= _PREARM_BIT
    return power_and_sensors(node, present, enabled, health)


def power_and_sensors(node: ArduNode, present: int, enabled: int, health: int) -> Fields:
    """SYS_STATUS with those MAV_SYS_STATUS_SENSOR."""
    vehicle = node.vehicle
    return {
        "onboard_control_sensors_present": present,
        "onboard_control_sensors_enabled": enabled,
        "onboard_control_sensors_health": health,
        "voltage_battery": round(vehicle.voltage * 1000),
        "current_battery": int16(vehicle.sense.current_a * 100),
        "battery_remaining": _battery_left(node),
    }


def battery_status(node: ArduNode) -> Fields:
    vehicle = node.vehicle
    volts = vehicle.voltage
    return {
        "temperature": 32767,
        "voltages": [round(volts * 1000)] + [65535] * 9,
        "current_battery": int16(vehicle.sense.current_a * 100),
        "current_consumed": round(vehicle.consumed_mah),
        "energy_consumed": round(vehicle.consumed_mah * volts * 0.036),  # hectojoules
        "battery_remaining": _battery_left(node),
        "charge_state": 1,
    }


def _battery_left(node: ArduNode) -> int:
    return round(100.0 * node.vehicle.battery_left)


def ekf_status_report(node: ArduNode) -> Fields:
    flags, ratios = node.vehicle.ekf_flags, node.vehicle.filter.ratios
    known = 0.0 if flags in (Flag(0), Flag.UNINITIALIZED) else 1.0
    return {
        "flags": int(flags),
        "velocity_variance": ratios["velocity"] * known,
        "pos_horiz_variance": ratios["position"] * known,
        "pos_vert_variance": ratios["height"] * known,
        "compass_variance": ratios["compass"] * known,
    }


def extended_sys_state(node: ArduNode) -> Fields:
    vehicle = node.vehicle
    if vehicle.armed and vehicle.taking_off:
        return {"landed_state": 3}
    if vehicle.landed:
        return {"landed_state": 1}
    return {"landed_state": 4 if vehicle.mode.is_landing else 2}


def mission_current(node: ArduNode) -> Fields:
    """MISSION_STATE: none there, not started, active or complete."""
    vehicle, mission = node.vehicle, node.vehicle.mission
    state = {State.STOPPED: 2, State.RUNNING: 3, State.COMPLETE: 5}[mission.state] if mission.present else 1
    return {
        "seq": mission.current,
        "total": max(len(mission) - 1, 0),
        "mission_state": state,
        "mission_mode": int(vehicle.mode is vehicle.auto),
    }


def fence_status(node: ArduNode) -> Fields | None:
    fence = node.vehicle.fence
    if not fence.enabled:
        return None
    kinds = ((CIRCLE | POLYGON, 3), (CEILING, 2))
    return {
        "breach_status": int(fence.breached != 0),
        "breach_count": fence.breaches,
        "breach_type": next((number for kind, number in kinds if fence.breached & kind), 0),
        "breach_time": int(fence.breach_time * 1000.0) if fence.breaches else 0,
        "breach_mitigation": 1,
    }


def autopilot_version(node: ArduNode) -> Fields:
    return {
        "capabilities": CAPABILITIES,
        "flight_sw_version": VERSION,
        "flight_custom_version": list(GIT_HASH.encode("ascii")),
        "uid": node.uid,
        "uid2": list(node.uid.to_bytes(8, "little")) + [0] * 10,
    }


def camera_feedback(node: ArduNode) -> Fields | None:
    """Asked for before the first picture it is all zeros, as ArduPilot's."""
    picture = node.vehicle.camera.last
    if picture is None:
        return {"img_idx": 0} if node.vehicle.camera.there else None
    place, (roll, pitch, yaw) = picture.place, map(math.degrees, picture.attitude)
    return {
        "time_usec": node.unix_us,
        "img_idx": picture.number,
        "lat": e7(place.lat_deg),
        "lng": e7(place.lon_deg),
        "alt_msl": place.alt_amsl_m,
        "alt_rel": picture.height,
        "roll": roll,
        "pitch": pitch,
        "yaw": yaw,
        "completed_captures": picture.number,
    }


REPORTS: dict[str, Report] = {
    **GIMBAL_REPORTS,
    "CAMERA_FEEDBACK": camera_feedback,
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "SYSTEM_TIME": lambda node: {"time_unix_usec": node.unix_us if node.vehicle.boot.has("gps") else 0},
    "GPS_RAW_INT": gps_raw_int,
    "RAW_IMU": imu,
    "SCALED_PRESSURE": scaled_pressure,
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "ATTITUDE_TARGET": attitude_target,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": global_position_int,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "MISSION_CURRENT": mission_current,
    "GPS_GLOBAL_ORIGIN": lambda node: base.gps_global_origin(node) if node.vehicle.boot.has("origin") else None,
    "NAV_CONTROLLER_OUTPUT": nav_controller_output,
    "RC_CHANNELS": rc_channels,
    "VFR_HUD": vfr_hud,
    "POSITION_TARGET_LOCAL_NED": position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    "SCALED_IMU2": imu,
    # There is no third IMU, but a compass.
    "SCALED_IMU3": lambda node: compass(node.seat.readings()),
    "SCALED_PRESSURE2": lambda node: {**scaled_pressure(node), "press_diff": 0.0},  # without a pitot tube
    "RANGEFINDER": rangefinder,
    "DISTANCE_SENSOR": distance_sensor,
    "ESC_TELEMETRY_1_TO_4": esc_telemetry,
    "POWER_STATUS": lambda node: {"Vcc": 5000},
    "BATTERY_STATUS": battery_status,
    "AUTOPILOT_VERSION": autopilot_version,
    "MEMINFO": lambda node: {"freemem": 65535, "freemem32": 524288},
    "AHRS": lambda node: {"error_rp": 0.004, "error_yaw": 0.004},
    "WIND": wind,
    "AHRS2": ahrs2,
    "EKF_STATUS_REPORT": ekf_status_report,
    "VIBRATION": vibration,
    "HOME_POSITION": home_position,
    "EXTENDED_SYS_STATE": extended_sys_state,
    "FENCE_STATUS": fence_status,
    "TERRAIN_REQUEST": lambda node: node.vehicle.terrain.request(),
    "TERRAIN_REPORT": lambda node: node.vehicle.terrain.report(),
}
