"""What a PX4 multicopter reports, message by message, and which commands it takes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.protocol import reports as base
from zmav.sim.protocol.base import Handler, Report
from zmav.sim.protocol.px4 import motion, sensors, status
from zmav.sim.protocol.px4.commands import HANDLERS
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.reports import boot_ms, boot_us


def _located(report: Report) -> Report:
    """Nothing to say before it knows where it is."""
    return lambda node: report(node) if node.copter.position_ok else None


REPORTS: dict[str, Report] = {
    "HEARTBEAT": status.heartbeat,
    "SYS_STATUS": status.sys_status,
    "SYSTEM_TIME": lambda node: {"time_unix_usec": node.unix_us, "time_boot_ms": boot_ms(node)},
    "PING": lambda node: {"time_usec": boot_us(node), "seq": int(node.copter.uptime)},
    "LINK_NODE_STATUS": status.link_node_status,
    "GPS_RAW_INT": sensors.gps_raw_int,
    "SCALED_PRESSURE": lambda node: {
        "time_boot_ms": boot_ms(node),
        "press_abs": node.seat.readings().pressure_hpa,
        "temperature": 1180,
    },
    "ATTITUDE": base.attitude,
    "ATTITUDE_QUATERNION": base.attitude_quaternion,
    "LOCAL_POSITION_NED": base.local_position_ned,
    "GLOBAL_POSITION_INT": _located(base.global_position_int),
    "SERVO_OUTPUT_RAW": sensors.servo_output_raw,
    "MISSION_CURRENT": status.mission_current,
    "GPS_GLOBAL_ORIGIN": _located(base.gps_global_origin),
    "VFR_HUD": motion.vfr_hud,
    "ATTITUDE_TARGET": motion.attitude_target,
    "POSITION_TARGET_LOCAL_NED": motion.position_target_local_ned,
    "POSITION_TARGET_GLOBAL_INT": motion.position_target_global_int,
    "HIGHRES_IMU": sensors.highres_imu,
    "TIMESYNC": lambda node: {"tc1": 0, "ts1": node.nanoseconds()},
    "DISTANCE_SENSOR": sensors.distance_sensor,
    "ALTITUDE": _located(motion.altitude),
    "BATTERY_STATUS": status.battery_status,
    "AUTOPILOT_VERSION": status.autopilot_version,
    "ACTUATOR_OUTPUT_STATUS": sensors.actuator_output_status,
    "RC_CHANNELS": sensors.rc_channels,
    "ESTIMATOR_STATUS": sensors.estimator_status,
    "VIBRATION": sensors.vibration,
    "HOME_POSITION": _located(lambda node: {**base.home_position(node), "q": [1.0, 0.0, 0.0, 0.0]}),
    "EXTENDED_SYS_STATE": status.extended_sys_state,
    "PROTOCOL_VERSION": lambda node: {"version": 200, "min_version": 100, "max_version": 200},
    "ODOMETRY": _located(motion.odometry),
    "TIME_ESTIMATE_TO_TARGET": status.time_estimate_to_target,
    "CURRENT_EVENT_SEQUENCE": lambda node: {"sequence": node.events.sequence},
    "CURRENT_MODE": status.current_mode,
    "OPEN_DRONE_ID_LOCATION": _located(motion.open_drone_id_location),
    "OPEN_DRONE_ID_SYSTEM": _located(motion.open_drone_id_system),
}


class Px4CopterNode(Px4Node):
    """Speaks for one :class:`~zmav.sim.autopilots.px4.copter.Px4Copter`."""

    HANDLERS: ClassVar[Mapping[int, Handler]] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
