"""The messages that a vehicle can send, by name."""

from __future__ import annotations

from zmav.sim.protocol import reports as base
from zmav.sim.protocol.ardupilot.reports import motion, sensors, status
from zmav.sim.protocol.base import Report

REPORTS: dict[str, Report] = {
    "HEARTBEAT": status.heartbeat,
    "SYS_STATUS": status.sys_status,
    "SYSTEM_TIME": status.system_time,
    "GPS_RAW_INT": sensors.gps_raw_int,
    "RAW_IMU": sensors.raw_imu,
    "SCALED_PRESSURE": sensors.scaled_pressure,
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "ATTITUDE_TARGET": motion.attitude_target,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": motion.global_position_int,
    "SERVO_OUTPUT_RAW": sensors.servo_output_raw,
    "MISSION_CURRENT": status.mission_current,
    "GPS_GLOBAL_ORIGIN": motion.gps_global_origin,
    "NAV_CONTROLLER_OUTPUT": motion.nav_controller_output,
    "RC_CHANNELS": sensors.rc_channels,
    "VFR_HUD": motion.vfr_hud,
    "POSITION_TARGET_LOCAL_NED": motion.position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": motion.position_target_global_int,
    "SCALED_IMU2": sensors.scaled_imu2,
    "SCALED_IMU3": sensors.scaled_imu3,
    "SCALED_PRESSURE2": sensors.scaled_pressure2,
    "RANGEFINDER": sensors.rangefinder,
    "DISTANCE_SENSOR": sensors.distance_sensor,
    "TERRAIN_REPORT": sensors.terrain_report,
    "ESC_TELEMETRY_1_TO_4": sensors.esc_telemetry,
    "POWER_STATUS": status.power_status,
    "BATTERY_STATUS": status.battery_status,
    "AUTOPILOT_VERSION": status.autopilot_version,
    "MEMINFO": status.meminfo,
    "AHRS": motion.ahrs,
    "SIMSTATE": motion.simstate,
    "WIND": sensors.wind,
    "AHRS2": motion.ahrs2,
    "EKF_STATUS_REPORT": status.ekf_status_report,
    "VIBRATION": sensors.vibration,
    "HOME_POSITION": motion.home_position,
    "EXTENDED_SYS_STATE": status.extended_sys_state,
    "FENCE_STATUS": status.fence_status,
    "RELAY_STATUS": sensors.relay_status,
    "CAMERA_FEEDBACK": sensors.camera_feedback,
    "GIMBAL_DEVICE_ATTITUDE_STATUS": sensors.gimbal_device_attitude_status,
}
