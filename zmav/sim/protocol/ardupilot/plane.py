"""The MAVLink face of an ArduPlane: the commands and targets that it takes in its own way, and the reports that differ.

https://ardupilot.org/dev/docs/plane-commands-in-guided-mode.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from zmav import rotation
from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.arduplane.base import INITIALISING
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol import reports
from zmav.sim.protocol.ardupilot import commands
from zmav.sim.protocol.ardupilot import reports as common
from zmav.sim.protocol.ardupilot.commands import Handlers
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.base import Fields, Handler, Report, Target
from zmav.sim.protocol.channel import Command

_AUTO, _RTL, _LOITER = 10, 11, 12
_NO_ROLL, _NO_PITCH, _NO_YAW, _NO_THRUST, _NO_ATTITUDE = 1, 2, 4, 64, 128  # ATTITUDE_TARGET_TYPEMASK
# MAV_SYS_STATUS_SENSOR: what there is, is used and works, as recorded; then what comes and goes.
_PRESENT, _ENABLED, _HEALTHY = 0x1361FC1F, 0x1241801F, 0x0311800F
_AIRSPEED, _GPS, _AHRS, _PREARM = 0x10, 0x20, 0x00200000, 0x10000000
_CONTROL = 0x01207C00  # what arming enables
_CONTROL_HEALTHY = 0x7C00
FULL_RPM = 7000.0
MOTOR = 2  # of the servo outputs, from 0
_NO_TEMPERATURE = 32767


# ---- commands


def _go(number: int) -> Handler:
    """A change of mode that is acknowledged whether it works or not, as ArduPlane does."""

    def handler(node: MavNode[ArduPlane], c: Command) -> int:
        node.vehicle.set_mode(number)
        return CommandResult.ACCEPTED

    return handler


def _change_speed(node: MavNode[ArduPlane], c: Command) -> int:
    plane = node.vehicle
    if not plane.mode.changes_speed:
        return CommandResult.FAILED
    return math.isfinite(c.p1) and math.isfinite(c.p2) and plane.ask_speed(int(c.p1), c.p2)


def _circle(node: MavNode[ArduPlane], c: Command, where: Vector) -> bool:
    radius = c.p3 if math.isfinite(c.p3) and c.p3 > 0 else 0.0
    node.vehicle.guided.fly_to(where, radius, counter_clockwise=math.isfinite(c.p4) and c.p4 != 0)
    return True


HANDLERS: Handlers = {
    **commands.HANDLERS,
    17: _go(_LOITER),  # NAV_LOITER_UNLIM
    20: _go(_RTL),  # NAV_RETURN_TO_LAUNCH
    22: lambda node, c: CommandResult.FAILED,  # NAV_TAKEOFF, for planes that hover
    178: _change_speed,
    192: lambda node, c: commands.reposition(
        node, c, _circle, unasked=CommandResult.FAILED, outside=CommandResult.DENIED
    ),
    300: lambda node, c: (
        CommandResult.DENIED if c.p1 or c.p2 else node.vehicle.set_mode(_AUTO) or CommandResult.ACCEPTED
    ),
}


# ---- targets


def _attitude_target(plane: ArduPlane, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET: of the attitude the angles whose rate is not ignored, or all with none."""
    mask = msg["type_mask"]
    if plane.mode is not plane.guided:
        return
    if not all(math.isfinite(part) for part in (*msg["q"], msg["thrust"])):
        return
    whole = mask & (_NO_ROLL | _NO_PITCH | _NO_YAW) == (_NO_ROLL | _NO_PITCH | _NO_YAW) and not mask & _NO_ATTITUDE
    roll, pitch, _ = rotation.euler(msg["q"])
    plane.guided.force(
        roll=roll if whole or not mask & _NO_ROLL else None,
        pitch=pitch if whole or not mask & _NO_PITCH else None,
        throttle=None if mask & _NO_THRUST else msg["thrust"],
    )


# ---- reports


def heartbeat(node: MavNode[ArduPlane]) -> Fields:
    plane = node.vehicle
    mixes = plane.mode.number != INITIALISING and plane.params["STICK_MIXING"] > 0
    return common.heartbeat_with(node, manual=mixes, stabilised=True, guided=plane.mode.navigates)


def sys_status(node: MavNode[ArduPlane]) -> Fields:
    plane = node.vehicle
    has = plane.boot.has
    gps, ahrs = _GPS if has("gps") else 0, _AHRS if has("prearm") else 0
    health = _HEALTHY | gps | ahrs | (_AIRSPEED if has("airspeed") else 0)
    health |= _PREARM if node.prearm_ok else 0
    enabled = _ENABLED | gps | ahrs
    if plane.armed:
        enabled, health = enabled | _CONTROL, health | _CONTROL_HEALTHY
    return common.power_and_sensors(node, _PRESENT | gps, enabled, health)


def vfr_hud(node: MavNode[ArduPlane]) -> Fields:
    plane = node.vehicle
    return {**reports.vfr_hud(node, turning=plane.armed, located=plane.boot.has("gps")), "airspeed": plane.eas}


def airspeed(node: MavNode[ArduPlane]) -> Fields:
    """Of the pitot tube: equivalent, and the pressure behind it in pascals."""
    eas = node.vehicle.eas
    return {"airspeed": eas, "temperature": _NO_TEMPERATURE, "raw_press": eas * eas / 2.0, "flags": 2}


def nav_controller_output(node: MavNode[ArduPlane]) -> Fields | None:
    """Not in MANUAL. The error of the airspeed is told times 100, as ArduPlane does."""
    plane = node.vehicle
    if plane.mode.number == 0:
        return None
    flown, way = plane.sp.flown(), plane.way
    return {
        "nav_roll": math.degrees(flown.roll),
        "nav_pitch": math.degrees(flown.pitch),
        "nav_bearing": int(math.degrees(flown.bearing)),
        "target_bearing": int(math.degrees(way.bearing)),
        "wp_dist": min(int(way.distance), 65535),
        "alt_error": flown.height + plane.sense.down,
        "aspd_error": flown.speed_error * 100.0 / plane.eas2tas,
        "xtrack_error": flown.cross_track,
    }


def position_target_global_int(node: MavNode[ArduPlane]) -> Fields | None:
    plane = node.vehicle
    return common.target_place(node, None if plane.mode.number == 0 else plane.way.end)


def servo_output_raw(node: MavNode[ArduPlane]) -> Fields:
    """Aileron, elevator, throttle and rudder; what DO_SET_SERVO set on the others."""
    outputs = list(node.vehicle.servos)
    for index, value in enumerate(node.seat.outputs()):
        pulse = _motor_pulse if index == MOTOR else common.centred_pulse
        outputs[index] = pulse(node, index + 1, value)
    return reports.numbered("servo{}_raw", outputs)


def _motor_pulse(node: MavNode[ArduPlane], channel: int, value: float) -> int:
    params = node.vehicle.params
    low, high = params[f"SERVO{channel}_MIN"], params[f"SERVO{channel}_MAX"]
    if params[f"SERVO{channel}_REVERSED"]:
        low, high = high, low
    return round(low + value * (high - low))


def esc_telemetry(node: MavNode[ArduPlane]) -> Fields:
    """The one motor, at the place of its output."""
    plane, s = node.vehicle, node.vehicle.sense

    def motor(value: int) -> list[int]:
        return [0] * MOTOR + [value, 0]

    return {
        "temperature": motor(32),
        "voltage": motor(min(round(plane.voltage * 100), 65535)),
        "current": motor(min(round(s.current_a * 100), 65535)),
        "totalcurrent": motor(min(round(plane.consumed_mah), 65535)),
        "rpm": motor(round(FULL_RPM * math.sqrt(max(s.throttle, 0.0)))),
        "count": motor(int(plane.uptime * 37) % 65536),
    }


def extended_sys_state(node: MavNode[ArduPlane]) -> Fields:
    plane = node.vehicle
    if not plane.flying:
        return {"landed_state": 1}
    if plane.taking_off:
        return {"landed_state": 3}
    return {"landed_state": 4 if plane.landing.active or plane.mode.is_landing else 2}


def fence_status(node: MavNode[ArduPlane]) -> Fields | None:
    """What is done about a breach is not told."""
    fields = common.fence_status(node)
    return None if fields is None else {**fields, "breach_mitigation": 0}


REPORTS: dict[str, Report] = {
    **common.REPORTS,
    "FENCE_STATUS": fence_status,
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "VFR_HUD": vfr_hud,
    "AIRSPEED": airspeed,
    "NAV_CONTROLLER_OUTPUT": nav_controller_output,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    "POSITION_TARGET_LOCAL_NED": lambda node: None,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "ESC_TELEMETRY_1_TO_4": esc_telemetry,
    "EXTENDED_SYS_STATE": extended_sys_state,
}


class PlaneNode(MavNode[ArduPlane]):
    """Speaks for one :class:`ArduPlane`."""

    HANDLERS: ClassVar[Handlers] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
    TARGETS: ClassVar[Mapping[str, Target]] = {
        "SET_ATTITUDE_TARGET": _attitude_target,
    }
