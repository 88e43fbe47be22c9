"""What PX4 sends unasked on its links: message -> Hz, as recorded on PX4 1.16 with its SIH quadrotor."""

from __future__ import annotations

from collections.abc import Mapping

ONBOARD = "onboard"
GROUND = "ground"
UDP = (ONBOARD, GROUND)
"""those of a PX4 in software in the loop; any other is a board's"""
MOST_HZ = 181.0
"""what such a link gives of a message, whatever is asked for"""

_ONBOARD: Mapping[str, float] = {
    "HEARTBEAT": 1,
    "SYS_STATUS": 5,
    "SYSTEM_TIME": 1,
    "PING": 1,
    "LINK_NODE_STATUS": 1,
    "GPS_RAW_INT": 8,
    "SCALED_PRESSURE": 1,
    "ATTITUDE": 100,
    "ATTITUDE_QUATERNION": 50,
    "LOCAL_POSITION_NED": 30,
    "GLOBAL_POSITION_INT": 50,
    "SERVO_OUTPUT_RAW": 10,
    "RC_CHANNELS": 20,  # with a radio
    "MISSION_CURRENT": 1,
    "VFR_HUD": 10,
    "ATTITUDE_TARGET": 10,
    "POSITION_TARGET_LOCAL_NED": 10,
    "POSITION_TARGET_GLOBAL_INT": 10,
    "HIGHRES_IMU": 50,
    "TIMESYNC": 10,
    "DISTANCE_SENSOR": 10,
    "ALTITUDE": 10,
    "BATTERY_STATUS": 0.5,
    "ESTIMATOR_STATUS": 1,
    "VIBRATION": 0.5,
    "HOME_POSITION": 0.5,
    "EXTENDED_SYS_STATE": 5,
    "ODOMETRY": 30,
    "TIME_ESTIMATE_TO_TARGET": 0.5,
    "CURRENT_EVENT_SEQUENCE": 1 / 3,
    "CURRENT_MODE": 0.5,
    "OPEN_DRONE_ID_LOCATION": 1,
    "OPEN_DRONE_ID_SYSTEM": 1,
}
_GROUND: Mapping[str, float] = {
    "HEARTBEAT": 1,
    "SYS_STATUS": 1,
    "PING": 0.1,
    "LINK_NODE_STATUS": 1,
    "GPS_RAW_INT": 5,
    "SCALED_PRESSURE": 1,
    "ATTITUDE": 50,
    "ATTITUDE_QUATERNION": 50,
    "LOCAL_POSITION_NED": 50,
    "GLOBAL_POSITION_INT": 50,
    "SERVO_OUTPUT_RAW": 50,
    "RC_CHANNELS": 5,  # with a radio
    "MISSION_CURRENT": 1,
    "VFR_HUD": 4,
    "ATTITUDE_TARGET": 50,
    "POSITION_TARGET_LOCAL_NED": 50,
    "POSITION_TARGET_GLOBAL_INT": 1,
    "DISTANCE_SENSOR": 0.5,
    "ALTITUDE": 1,
    "BATTERY_STATUS": 0.5,
    "ESTIMATOR_STATUS": 0.5,
    "VIBRATION": 0.1,
    "HOME_POSITION": 0.5,
    "EXTENDED_SYS_STATE": 1,
    "TIME_ESTIMATE_TO_TARGET": 0.5,
    "CURRENT_EVENT_SEQUENCE": 1 / 3,
    "CURRENT_MODE": 0.5,
    "OPEN_DRONE_ID_LOCATION": 1,
    "OPEN_DRONE_ID_SYSTEM": 1,
}


def rates(link: str) -> Mapping[str, float]:
    """Message -> Hz of a link of that name; any but the ground link is taken for an onboard one."""
    return _GROUND if link == GROUND else _ONBOARD
