"""The messages that a PX4 can send, by name."""

from __future__ import annotations

from zmav.sim.protocol import reports as base
from zmav.sim.protocol.base import Report
from zmav.sim.protocol.px4 import motion, sensors, status

REPORTS: dict[str, Report] = {
    "HEARTBEAT": status.heartbeat,
    "SYS_STATUS": status.sys_status,
    "SYSTEM_TIME": status.system_time,
    "PING": status.ping,
    "LINK_NODE_STATUS": status.link_node_status,
    "GPS_RAW_INT": sensors.gps_raw_int,
    "SCALED_PRESSURE": sensors.scaled_pressure,
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": motion.global_position_int,
    "SERVO_OUTPUT_RAW": sensors.servo_output_raw,
    "MISSION_CURRENT": status.mission_current,
    "GPS_GLOBAL_ORIGIN": motion.gps_global_origin,
    "VFR_HUD": motion.vfr_hud,
    "ATTITUDE_TARGET": motion.attitude_target,
    "POSITION_TARGET_LOCAL_NED": motion.position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": motion.position_target_global_int,
    "HIGHRES_IMU": sensors.highres_imu,
    "TIMESYNC": status.timesync,
    "DISTANCE_SENSOR": sensors.distance_sensor,
    "ALTITUDE": motion.altitude,
    "BATTERY_STATUS": status.battery_status,
    "AUTOPILOT_VERSION": status.autopilot_version,
    "ACTUATOR_OUTPUT_STATUS": sensors.actuator_output_status,
    "RC_CHANNELS": sensors.rc_channels,
    "ESTIMATOR_STATUS": sensors.estimator_status,
    "VIBRATION": sensors.vibration,
    "HOME_POSITION": motion.home_position,
    "EXTENDED_SYS_STATE": status.extended_sys_state,
    "PROTOCOL_VERSION": status.protocol_version,
    "ODOMETRY": motion.odometry,
    "TIME_ESTIMATE_TO_TARGET": status.time_estimate_to_target,
    "CURRENT_EVENT_SEQUENCE": status.current_event_sequence,
    "CURRENT_MODE": status.current_mode,
    "OPEN_DRONE_ID_LOCATION": motion.open_drone_id_location,
    "OPEN_DRONE_ID_SYSTEM": motion.open_drone_id_system,
}
