"""The MAVLink face of an ArduRover: the commands and targets that it takes in its own way, and the reports that differ.

https://ardupilot.org/dev/docs/mavlink-rover-commands.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from zmav import rotation
from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.ardupilot.state import INFO
from zmav.sim.autopilots.ardurover.rover import ArduRover
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol import reports
from zmav.sim.protocol.ardupilot import commands
from zmav.sim.protocol.ardupilot import reports as common
from zmav.sim.protocol.ardupilot.commands import Handlers, enter
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.setpoint import BODY_FRAMES, LOCAL_FRAMES, local_place, point
from zmav.sim.protocol.base import Fields, Report, Target
from zmav.sim.protocol.channel import Command

_AUTO, _RTL = 10, 11
_POS, _VEL, _ACC, _NO_YAW, _NO_YAW_RATE = 0x007, 0x038, 0x1C0, 0x400, 0x800  # POSITION_TARGET_TYPEMASK
_NO_TURN, _NO_THRUST = 4, 64  # ATTITUDE_TARGET_TYPEMASK
_GLOBAL = (0, 3, 5, 6, 10, 11)
_FARTHEST, _FASTEST_TURN = 1e7, 100.0
# MAV_SYS_STATUS_SENSOR: what there is, is used and works, as recorded; then what comes and goes.
_PRESENT, _ENABLED, _HEALTHY = 0x1331DC0F, 0x1201800F, 0x0311810F
_GPS, _AHRS, _PREARM, _LOGGING = 0x20, 0x00200000, 0x10000000, 0x01000000
_STABILISES, _DRIVES = 0x0C00, 0x5000


# ---- commands


def _change_speed(node: MavNode[ArduRover], c: Command) -> int:
    """Airspeed is taken for ground speed; climbs and descents there are none."""
    if int(c.p1) in (2, 3):
        return CommandResult.DENIED
    return node.vehicle.mode.set_speed(c.p2)


def _go(node: MavNode[ArduRover], c: Command, where: Vector) -> bool:
    """A speed is refused where there was no place to go to before, as in ArduRover."""
    if c.p1 > 0 and not node.vehicle.mode.set_speed(c.p1):
        return False
    node.vehicle.guided.go((where[0], where[1]))
    return True


HANDLERS: Handlers = {
    **commands.HANDLERS,
    20: enter(_RTL),  # NAV_RETURN_TO_LAUNCH
    178: _change_speed,
    192: lambda node, c: commands.reposition(node, c, _go),
    300: lambda node, c: CommandResult.DENIED if c.p1 or c.p2 else node.vehicle.set_mode(_AUTO),
}


# ---- targets


def _refused(rover: ArduRover, msg: dict[str, Any], name: str) -> bool:
    """Accelerations are not taken, and it says so."""
    if msg["type_mask"] & _ACC:
        return False
    rover.say(INFO, f"Ignoring {name}; set ACC_IGNORE in mask")
    return True


def _local_target(rover: ArduRover, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_LOCAL_NED: a place, or a way and a speed."""
    frame = msg["coordinate_frame"]
    if not rover.takes_targets or frame not in LOCAL_FRAMES:
        return
    if not rover.boot.has("origin") or _refused(rover, msg, "SET_POSITION_TARGET_LOCAL_NED"):
        return
    if msg["type_mask"] & _POS:
        _way(rover, msg, rover.sense.yaw if frame in BODY_FRAMES else 0.0)
    elif abs(msg["x"]) <= _FARTHEST and abs(msg["y"]) <= _FARTHEST:
        rover.guided.go(local_place(rover, msg)[:2])


def _global_target(rover: ArduRover, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_GLOBAL_INT; the altitude is not looked at."""
    if not rover.takes_targets or msg["coordinate_frame"] not in _GLOBAL:
        return
    where = point(rover, msg["lat_int"], msg["lon_int"], 0.0, 0)
    if not msg["type_mask"] & _POS and where is None:
        return
    if _refused(rover, msg, "SET_POSITION_TARGET_GLOBAL_INT"):
        return
    if msg["type_mask"] & _POS or where is None:
        _way(rover, msg, 0.0)
    else:
        rover.guided.go((where[0], where[1]))


def _way(rover: ArduRover, msg: dict[str, Any], about: float) -> None:
    """A velocity, a velocity with a heading or a turn rate, a heading or a turn rate alone."""
    mask = msg["type_mask"]
    moves, faces, turns = not mask & _VEL, not mask & _NO_YAW, not mask & _NO_YAW_RATE
    numbers = (msg["vx"], msg["vy"]) if moves else ()
    numbers += (msg["yaw"],) if faces else ()
    numbers += (msg["yaw_rate"],) if turns else ()
    if not all(math.isfinite(n) for n in numbers) or (faces and turns):
        return
    speed = yaw = 0.0
    if moves:
        speed = min(math.hypot(msg["vx"], msg["vy"]), rover.params["WP_SPEED"])
        yaw = about + math.atan2(msg["vy"], msg["vx"])
        if (faces or turns) and msg["vx"] < 0:
            speed = -speed  # the nose is told otherwise: it backs up
    if turns:
        rover.guided.turn(min(max(msg["yaw_rate"], -_FASTEST_TURN), _FASTEST_TURN), speed)
    elif faces:
        rover.guided.head(about + msg["yaw"], speed)
    elif moves:
        rover.guided.head(yaw, speed)


def _attitude_target(rover: ArduRover, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET: a heading or a turn rate, and the thrust as a share of WP_SPEED."""
    mask = msg["type_mask"]
    if not rover.takes_targets or mask & _NO_THRUST or not math.isfinite(msg["thrust"]):
        return
    speed = rover.params["WP_SPEED"] * min(max(msg["thrust"], -1.0), 1.0)
    yaw = rotation.heading(msg["q"])
    if not mask & _NO_TURN:
        rate = msg["body_yaw_rate"]
        if math.isfinite(rate):
            rover.guided.turn(min(max(rate, -_FASTEST_TURN), _FASTEST_TURN), speed)
    elif math.isfinite(yaw):
        rover.guided.head(yaw, speed)


# ---- reports


def heartbeat(node: MavNode[ArduRover]) -> Fields:
    mode = node.vehicle.mode
    steered = mode.by_stick or node.vehicle.params["STICK_MIXING"] > 0
    return common.heartbeat_with(node, manual=steered, stabilised=False, guided=mode.autopilot)


def sys_status(node: MavNode[ArduRover]) -> Fields:
    """Controllers are enabled, and healthy, in the modes that have them."""
    rover = node.vehicle
    mode = rover.mode
    control = _STABILISES if mode.stabilises else 0
    control |= _DRIVES if mode.autopilot else 0
    gps = _GPS if rover.boot.has("gps") else 0
    ahrs = _AHRS if rover.boot.has("prearm") else 0
    located = _AHRS if rover.position_ok else 0
    ready = _PREARM if node.prearm_ok else 0
    enabled = _ENABLED | gps | ahrs | control | (_LOGGING if rover.ever_armed else 0)
    return common.power_and_sensors(node, _PRESENT | gps, enabled, _HEALTHY | gps | located | control | ready)


def vfr_hud(node: MavNode[ArduRover]) -> Fields:
    """The airspeed is the speed over the ground, without a sensor of its own; a throttle backwards is one too."""
    fields = reports.vfr_hud(node, turning=node.vehicle.armed, located=node.vehicle.boot.has("origin"))
    return {**fields, "airspeed": fields["groundspeed"]}


def nav_controller_output(node: MavNode[ArduRover]) -> Fields | None:
    """Only where it drives by itself; the bearing of the moment is told on a turn on the spot, and in LOITER."""
    mode = node.vehicle.mode
    if not mode.autopilot:
        return None
    bearing = round(math.degrees(mode.bearing)) % 360
    return {
        "nav_bearing": bearing if mode.number == 5 else 0,
        "target_bearing": bearing,
        "wp_dist": min(int(mode.distance), 65535),
        "xtrack_error": mode.cross_track,
    }


def position_target_global_int(node: MavNode[ArduRover]) -> Fields | None:
    mode = node.vehicle.mode
    return common.target_place(node, mode.place if mode.autopilot else None)


def servo_output_raw(node: MavNode[ArduRover]) -> Fields:
    """Steering on the first output and throttle on the third."""
    first, third = node.seat.outputs()
    outputs = list(node.vehicle.servos)
    outputs[0], outputs[2] = common.centred_pulse(node, 1, first), common.centred_pulse(node, 3, third)
    return reports.numbered("servo{}_raw", outputs)


def rc_channels_scaled(node: MavNode[ArduRover]) -> Fields:
    """Steering and throttle, -10000 to 10000."""
    first, third = node.seat.outputs()
    return {"rssi": 255, "chan1_scaled": round(first * 10000.0), "chan3_scaled": round(third * 10000.0)}


REPORTS: dict[str, Report] = {
    **common.REPORTS,
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "VFR_HUD": vfr_hud,
    "NAV_CONTROLLER_OUTPUT": nav_controller_output,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
    "POSITION_TARGET_LOCAL_NED": lambda node: None,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "RC_CHANNELS_SCALED": rc_channels_scaled,
    "EXTENDED_SYS_STATE": lambda node: {"landed_state": 0},  # it does not say whether it has landed
    "ESC_TELEMETRY_1_TO_4": lambda node: None,
    "WIND": lambda node: None,
}


class RoverNode(MavNode[ArduRover]):
    """Speaks for one :class:`ArduRover`."""

    HANDLERS: ClassVar[Handlers] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
    TARGETS: ClassVar[Mapping[str, Target]] = {
        "SET_POSITION_TARGET_LOCAL_NED": _local_target,
        "SET_POSITION_TARGET_GLOBAL_INT": _global_target,
        "SET_ATTITUDE_TARGET": _attitude_target,
    }
