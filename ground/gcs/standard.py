"""Which messages a ground control station needs, and how often: as long as one is there, they are wanted.

The groups are those of MAV_DATA_STREAM, by which older stations ask (REQUEST_DATA_STREAM), with the messages that
ArduPilot sends in each (https://ardupilot.org/dev/docs/mavlink-requesting-data.html); PX4's are added.
"""

from __future__ import annotations

from collections.abc import Mapping

GCS: Mapping[str, float] = {
    "ATTITUDE": 4.0,
    "GLOBAL_POSITION_INT": 4.0,
    "VFR_HUD": 4.0,
    "NAV_CONTROLLER_OUTPUT": 2.0,
    "GPS_RAW_INT": 2.0,
    "RC_CHANNELS": 2.0,
    "SYS_STATUS": 2.0,
    "BATTERY_STATUS": 1.0,
    "MISSION_CURRENT": 1.0,
    "POSITION_TARGET_GLOBAL_INT": 1.0,
    "SYSTEM_TIME": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "VIBRATION": 1.0,
    "SERVO_OUTPUT_RAW": 1.0,
    "HOME_POSITION": 0.2,
}
"""Hz. Only what ArduPilot and PX4 both send: an autopilot that is asked for what it lacks says so, each time"""
MORE: Mapping[str, float] = {
    "EKF_STATUS_REPORT": 1.0,
    "WIND": 1.0,
    "FENCE_STATUS": 1.0,
    "RAW_IMU": 2.0,
    "SCALED_IMU2": 2.0,
    "SCALED_IMU3": 2.0,
    "SCALED_PRESSURE": 2.0,
    "SCALED_PRESSURE2": 2.0,
    "LOCAL_POSITION_NED": 4.0,
    "POWER_STATUS": 1.0,
    "MEMINFO": 1.0,
    "GPS2_RAW": 2.0,
    "AHRS": 2.0,
    "AHRS2": 2.0,
    "RANGEFINDER": 2.0,
    "DISTANCE_SENSOR": 2.0,
    "TERRAIN_REPORT": 1.0,
    "ESC_TELEMETRY_1_TO_4": 1.0,
    "ATTITUDE_TARGET": 2.0,
    "ALTITUDE": 2.0,
    "ESTIMATOR_STATUS": 1.0,
}
SETS: Mapping[str, Mapping[str, float]] = {"none": {}, "gcs": GCS, "all": {**GCS, **MORE}}
"""what ``--streams`` names"""

ALL = 0
STREAMS: Mapping[int, tuple[str, ...]] = {
    ALL: (
        *GCS,
        "EKF_STATUS_REPORT",
        "RAW_IMU",
        "SCALED_PRESSURE",
        "LOCAL_POSITION_NED",
        "POWER_STATUS",
        "MEMINFO",
        "AHRS",
    ),
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3"),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "GPS2_RAW",
        "NAV_CONTROLLER_OUTPUT",
        "FENCE_STATUS",
        "POSITION_TARGET_GLOBAL_INT",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    4: ("ATTITUDE_TARGET", "POSITION_TARGET_LOCAL_NED"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "AHRS2"),
    11: ("VFR_HUD",),
    12: (
        "AHRS",
        "SYSTEM_TIME",
        "WIND",
        "RANGEFINDER",
        "DISTANCE_SENSOR",
        "BATTERY_STATUS",
        "EKF_STATUS_REPORT",
        "VIBRATION",
    ),
}
"""messages by MAV_DATA_STREAM"""
