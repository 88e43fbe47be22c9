"""What an ArduPilot reports: one function per message, with ArduPilot's signs, units and fill-ins.

Each takes the vehicle's :class:`~zmav.sim.protocol.ardupilot.node.MavNode` and gives the message's fields, or None
where the vehicle has nothing to say yet. Field conventions follow recordings of ArduPilot SITL; messages:
https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

from zmav.sim.protocol import reports as base
from zmav.sim.protocol.ardupilot.reports import motion, sensors, status
from zmav.sim.protocol.base import Report
from zmav.sim.protocol.reports import boot_ms, boot_us

REPORTS: dict[str, Report] = {
    "HEARTBEAT": status.heartbeat,
    "SYS_STATUS": status.sys_status,
    "SYSTEM_TIME": status.system_time,
    "GPS_RAW_INT": sensors.gps_raw_int,
    "RAW_IMU": lambda node: {"time_usec": boot_us(node), **sensors.imu(node)},
    "SCALED_PRESSURE": sensors.scaled_pressure,
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "ATTITUDE_TARGET": motion.attitude_target,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": motion.global_position_int,
    "SERVO_OUTPUT_RAW": sensors.servo_output_raw,
    "MISSION_CURRENT": status.mission_current,
    "GPS_GLOBAL_ORIGIN": lambda node: base.gps_global_origin(node) if node.vehicle.boot.has("origin") else None,
    "NAV_CONTROLLER_OUTPUT": motion.nav_controller_output,
    "RC_CHANNELS": sensors.rc_channels,
    "VFR_HUD": motion.vfr_hud,
    "POSITION_TARGET_LOCAL_NED": motion.position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": motion.position_target_global_int,
    "SCALED_IMU2": lambda node: {"time_boot_ms": boot_ms(node), **sensors.imu(node)},
    # There is no third IMU, but a compass.
    "SCALED_IMU3": lambda node: {"time_boot_ms": boot_ms(node), **sensors.compass(node.seat.readings())},
    "SCALED_PRESSURE2": lambda node: {**sensors.scaled_pressure(node), "press_diff": 0.0},  # without a pitot tube
    "RANGEFINDER": sensors.rangefinder,
    "DISTANCE_SENSOR": sensors.distance_sensor,
    "TERRAIN_REPORT": sensors.terrain_report,
    "ESC_TELEMETRY_1_TO_4": sensors.esc_telemetry,
    "POWER_STATUS": lambda node: {"Vcc": 5000},
    "BATTERY_STATUS": status.battery_status,
    "AUTOPILOT_VERSION": status.autopilot_version,
    "MEMINFO": lambda node: {"freemem": 65535, "freemem32": 524288},
    "AHRS": lambda node: {"error_rp": 0.004, "error_yaw": 0.004},
    "SIMSTATE": motion.simstate,
    "WIND": sensors.wind,
    "AHRS2": motion.ahrs2,
    "EKF_STATUS_REPORT": status.ekf_status_report,
    "VIBRATION": sensors.vibration,
    "HOME_POSITION": motion.home_position,
    "EXTENDED_SYS_STATE": status.extended_sys_state,
    "FENCE_STATUS": status.fence_status,
}
