"""How a PX4 is: heartbeat, health, battery, time, versions; with the fill-ins of a recorded one.

Messages: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

from zmav.sim.autopilots.px4.modes import LAND, MISSION, OFFBOARD, TAKEOFF
from zmav.sim.protocol.base import GIT_HASH, Fields
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.reports import boot_us, int16

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
    return {"timestamp": boot_us(node), "tx_rate": 24000, "messages_sent": sum(c.sent for c in node.channels)}


def time_estimate_to_target(node: Px4Node) -> Fields:
    copter = node.copter
    home = 0 if copter.landed or not copter.has_home else round(copter.navigator.way_home_s)
    return {"safe_return": home, "land": -1, "mission_next_item": -1, "mission_end": -1, "commanded_action": -1}


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
