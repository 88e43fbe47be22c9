"""How the vehicle is: heartbeat, health, battery, time, versions."""

from __future__ import annotations

from zmav.sim.autopilots.ardupilot.boot import Flag
from zmav.sim.autopilots.ardupilot.fence import CEILING, CIRCLE, POLYGON
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.base import GIT_HASH, Fields
from zmav.sim.protocol.reports import boot_ms, int16

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


def heartbeat(node: ArduNode) -> Fields:
    vehicle = node.vehicle
    mode = _MANUAL | _STABILIZE | _CUSTOM
    if vehicle.mode.needs_position or vehicle.mode.number == 9 or vehicle.system_status == 1:
        mode |= _GUIDED
    if vehicle.armed:
        mode |= _ARMED
    return {
        "type": vehicle.MAV_TYPE,
        "autopilot": 3,
        "base_mode": mode,
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


def system_time(node: ArduNode) -> Fields:
    unix = node.unix_us if node.vehicle.boot.has("gps") else 0
    return {"time_unix_usec": unix, "time_boot_ms": boot_ms(node)}


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
