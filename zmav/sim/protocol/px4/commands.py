"""COMMAND_LONG and COMMAND_INT, with PX4's verdicts.

Protocol: https://mavlink.io/en/services/command.html. PX4's receiver acknowledges what it does itself, its commander
the rest; DO_SET_MODE is acknowledged by both. The frame of a COMMAND_INT is not looked at: altitudes are above mean sea
level.
"""

from __future__ import annotations

import math

from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.px4 import events, modes
from zmav.sim.autopilots.px4.modes import Mode
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol.base import SHARED_HANDLERS, Handler, request_message, send_message, set_interval
from zmav.sim.protocol.channel import CHANGE_MODE, CUSTOM_MODE, Command
from zmav.sim.protocol.gimbal import REPORTS as GIMBAL_REPORTS
from zmav.sim.protocol.px4.node import UDP, Px4Node
from zmav.sim.protocol.px4.setpoint import point

_REBOOT = 1
_AVAILABLE_MODES = 435


# ---- the commander's


def _set_mode(node: Px4Node, c: Command) -> int:
    if not (math.isfinite(c.p1) and math.isfinite(c.p2) and int(c.p1) & CUSTOM_MODE):
        return CommandResult.TEMPORARILY_REJECTED
    numbers = (int(c.p2), int(c.p3) if math.isfinite(c.p3) else 0)
    if numbers in modes.NOT_SIMULATED:
        node.copter.say(4, f"{modes.NOT_SIMULATED[numbers]} is not simulated\t")
        return CommandResult.UNSUPPORTED
    mode = modes.BY_NUMBERS.get(numbers)
    return mode is not None and node.copter.set_mode(mode)


def _enter(mode: Mode) -> Handler:
    return lambda node, c: node.copter.set_mode(mode)


def _takeoff(node: Px4Node, c: Command) -> int:
    navigator = node.copter.navigator
    navigator.takeoff_amsl = c.z if math.isfinite(c.z) else None
    done = node.copter.set_mode(modes.TAKEOFF)
    if not done:
        navigator.takeoff_amsl = None
    return done


def _reposition(node: Px4Node, c: Command) -> int:
    """Fly to a place and HOLD there; what is NaN stays as it is."""
    copter = node.copter
    if not math.isfinite(c.p2) or int(c.p2) != CHANGE_MODE:
        return CommandResult.UNSUPPORTED
    here = copter.position
    lat, lon = c.degrees if all(map(math.isfinite, c.degrees)) else (here.lat_deg, here.lon_deg)
    place = point(copter, lat, lon, c.z if math.isfinite(c.z) else here.alt_amsl_m, 0)
    if place is None:
        return CommandResult.DENIED
    if not copter.set_mode(modes.HOLD):
        return CommandResult.TEMPORARILY_REJECTED
    speed = c.p1 if math.isfinite(c.p1) and c.p1 > 0 else None
    _go(node, place, c.p4 if math.isfinite(c.p4) else None, speed)
    return CommandResult.ACCEPTED


def _go(node: Px4Node, place: Vector, yaw: float | None, speed: float | None) -> None:
    """The commander has changed the mode already when the navigator looks at the fence."""
    copter = node.copter
    if copter.params["GF_ACTION"] and copter.geofence.at(place):
        copter.tell(events.OUTSIDE_FENCE)
    else:
        copter.navigator.reposition(place, yaw, speed)


def _change_speed(node: Px4Node, c: Command) -> int:
    """A speed that is not above zero goes back to the parameter's."""
    node.copter.cruise_speed = c.p2 if math.isfinite(c.p2) and c.p2 > 0 else None
    return CommandResult.ACCEPTED


def _set_home(node: Px4Node, c: Command) -> int:
    copter = node.copter
    if not copter.position_ok:
        return CommandResult.TEMPORARILY_REJECTED
    if c.p1 == 1:
        copter.home_world = (copter.sense.north, copter.sense.east, copter.sense.down)
    else:
        place = point(copter, *c.degrees, c.z, 0)
        if place is None:
            return CommandResult.DENIED
        copter.home_world = place
    return CommandResult.ACCEPTED


def _terminate(node: Px4Node, c: Command) -> int:
    """The motors stop, and the mode is left by a reboot only."""
    if not c.p1 > 0.5:
        return CommandResult.DENIED
    node.copter.terminate()
    return CommandResult.ACCEPTED


def _reboot(node: Px4Node, c: Command) -> int:
    if node.copter.armed:
        return CommandResult.TEMPORARILY_REJECTED
    if c.p1 != _REBOOT or c.channel.link in UDP:  # in software in the loop it has nothing to start it again
        return CommandResult.DENIED
    node.reboot_after_ack()
    return CommandResult.ACCEPTED


def _mission_start(node: Px4Node, c: Command) -> int:
    copter = node.copter
    if not copter.mission.able:
        return CommandResult.TEMPORARILY_REJECTED
    if math.isfinite(c.p1) and c.p1 > 0 and not copter.mission.jump(int(c.p1)):
        return CommandResult.TEMPORARILY_REJECTED
    if not copter.armed and not copter.arm():
        return CommandResult.TEMPORARILY_REJECTED
    return copter.set_mode(modes.MISSION)


# ---- the receiver's


def _set_interval(node: Px4Node, c: Command) -> int:
    """Two messages are sent at a rate of their own."""
    return CommandResult.FAILED if node.name_in(c) in ("HEARTBEAT", "MISSION_CURRENT") else set_interval(node, c)


def _available_modes(node: Px4Node, c: Command) -> int:
    """One mode by its index (from 1), or all of them: https://mavlink.io/en/services/standard_modes.html"""
    wanted = int(c.p2) if math.isfinite(c.p2) else 0
    shown = [mode for mode in modes.MODES if mode is not modes.TERMINATION]
    if not 0 <= wanted <= len(shown):
        return CommandResult.DENIED
    for index, mode in enumerate(shown, start=1):
        if wanted in (0, index):
            c.channel.send(
                "AVAILABLE_MODES",
                number_modes=len(shown),
                mode_index=index,
                standard_mode=mode.standard,
                custom_mode=mode.custom,
                properties=0,
                mode_name=mode.name.replace("_", " ").capitalize(),
            )
    return CommandResult.ACCEPTED


def _request_message(node: Px4Node, c: Command) -> int:
    if c.p1 == _AVAILABLE_MODES:
        return _available_modes(node, c)
    if node.name_in(c) in GIMBAL_REPORTS and not node.gimbal.there:
        return CommandResult.DENIED
    return request_message(node, c)


def _ask_for(name: str) -> Handler:
    return lambda node, c: send_message(node, c, name)


HANDLERS: dict[int, Handler] = {
    **SHARED_HANDLERS,
    17: _enter(modes.HOLD),  # NAV_LOITER_UNLIM
    20: _enter(modes.RTL),
    21: _enter(modes.LAND),
    22: _takeoff,
    176: _set_mode,
    178: _change_speed,
    179: _set_home,
    185: _terminate,
    192: _reposition,
    246: _reboot,
    300: _mission_start,
    401: lambda node, c: node.copter.health.tell() or CommandResult.ACCEPTED,
    410: _ask_for("HOME_POSITION"),
    511: _set_interval,
    512: _request_message,
    519: _ask_for("PROTOCOL_VERSION"),
    520: _ask_for("AUTOPILOT_VERSION"),
}
