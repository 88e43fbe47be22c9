"""What PX4 sends unasked on its links, as recorded on PX4 1.16 with its SIH quadrotor."""

from __future__ import annotations

from collections.abc import Mapping

ONBOARD = "onboard"
GROUND = "ground"
UDP = (ONBOARD, GROUND)
"""those of a PX4 in software in the loop; any other is a board's"""
MOST_HZ = 181.0
"""what such a link gives of a message, whatever is asked for"""

HZ: Mapping[str, tuple[float, float]] = {
    "HEARTBEAT": (1, 1),
    "SYS_STATUS": (5, 1),
    "SYSTEM_TIME": (1, 0),
    "PING": (1, 0.1),
    "LINK_NODE_STATUS": (1, 1),
    "GPS_RAW_INT": (8, 5),
    "SCALED_PRESSURE": (1, 1),
    "ATTITUDE": (100, 50),
    "ATTITUDE_QUATERNION": (50, 50),
    "LOCAL_POSITION_NED": (30, 50),
    "GLOBAL_POSITION_INT": (50, 50),
    "SERVO_OUTPUT_RAW": (10, 50),
    "RC_CHANNELS": (20, 5),  # with a radio
    "MISSION_CURRENT": (1, 1),
    "VFR_HUD": (10, 4),
    "ATTITUDE_TARGET": (10, 50),
    "POSITION_TARGET_LOCAL_NED": (10, 50),
    "POSITION_TARGET_GLOBAL_INT": (10, 1),
    "HIGHRES_IMU": (50, 0),
    "TIMESYNC": (10, 0),
    "DISTANCE_SENSOR": (10, 0.5),
    "ALTITUDE": (10, 1),
    "BATTERY_STATUS": (0.5, 0.5),
    "ESTIMATOR_STATUS": (1, 0.5),
    "VIBRATION": (0.5, 0.1),
    "HOME_POSITION": (0.5, 0.5),
    "EXTENDED_SYS_STATE": (5, 1),
    "ODOMETRY": (30, 0),
    "TIME_ESTIMATE_TO_TARGET": (0.5, 0.5),
    "CURRENT_EVENT_SEQUENCE": (1 / 3, 1 / 3),
    "CURRENT_MODE": (0.5, 0.5),
    "OPEN_DRONE_ID_LOCATION": (1, 1),
    "OPEN_DRONE_ID_SYSTEM": (1, 1),
}
"""message -> Hz on the onboard link, and on the ground link; 0: it is not sent"""


def rate(link: str, name: str) -> float:
    """Hz of a message on a link of that name; any but the ground link is taken for an onboard one."""
    return HZ.get(name, (0, 0))[link == GROUND]
