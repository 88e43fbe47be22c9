"""Commands about the mission, the fence, and what the vehicle carries, with ArduPilot's verdicts.

https://ardupilot.org/dev/docs/mavlink-commands.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.vehicle import INFO
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol.ardupilot import commands
from zmav.sim.protocol.ardupilot.commands import Handlers, place
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.command import ACCEPTED, DENIED, FAILED, UNSUPPORTED, Command

_AUTO = 3
_E7 = 1e7


def _mission_start(node: ArduNode, c: Command) -> int:
    """AUTO, and off the ground with the throttle stick down too."""
    if c.p1 or c.p2:
        return DENIED
    vehicle = node.vehicle
    if not vehicle.set_mode(_AUTO):
        return FAILED
    vehicle.auto_armed = vehicle.armed
    if vehicle.mission.state is not State.RUNNING:
        vehicle.mission.start_or_resume()
    return ACCEPTED


def _set_current(node: ArduNode, c: Command) -> int:
    """DO_SET_MISSION_CURRENT; ``p2`` 1: with the jumps' counters back at zero, and running again."""
    mission, seq = node.vehicle.mission, int(c.p1)
    if not 0 <= seq < len(mission):
        return DENIED
    again = c.p2 == 1
    if again:
        mission.reset()
    if not mission.set_current(seq):
        return FAILED
    if again:
        mission.resume()
    node.after_ack(c.channel, "MISSION_CURRENT")
    return ACCEPTED


def _pause_continue(node: ArduNode, c: Command) -> int:
    vehicle = node.vehicle
    if int(c.p1) == 1:
        vehicle.auto.resume()
        return ACCEPTED
    if int(c.p1) != 0:
        return DENIED
    if not vehicle.auto.pause():
        node.say(INFO, "Failed to pause")
        return FAILED
    return ACCEPTED


def _region_of_interest(node: ArduNode, c: Command) -> int:
    x, y = (c.x, c.y) if c.as_int else (c.x * _E7, c.y * _E7)
    where: Vector | None = None
    if x != 0 or y != 0 or c.z != 0:
        where = place(node, x, y, c.z, c.frame)
        if where is None:
            return DENIED
    node.vehicle.region_of_interest(where)
    return ACCEPTED


def _mount_control(node: ArduNode, c: Command) -> int:
    """Pitch, roll and yaw about the nose, degrees; the last parameter is the mount's mode."""
    gimbal = node.vehicle.payload.gimbal
    if c.z in (0, 1):
        return gimbal.rest(int(c.z))
    angles = (c.p1, c.p2, c.p3)
    if not all(math.isfinite(angle) for angle in angles):
        return DENIED
    return gimbal.aim(c.p2, c.p1, c.p3, locked=False)


def _gimbal_pitch_yaw(node: ArduNode, c: Command) -> int:
    flags = int(c.x) if math.isfinite(c.x) else 0
    gimbal = int(c.z) if math.isfinite(c.z) else 0
    return node.vehicle.payload.gimbal_manager((c.p1, c.p2, c.p3, c.p4), flags, gimbal)


def _shoot(node: ArduNode, c: Command) -> int:
    """DO_DIGICAM_CONTROL: accepted whatever comes of it."""
    if c.x == 1:
        node.vehicle.payload.camera.shoot()
    return ACCEPTED


def _trigger_distance(node: ArduNode, c: Command) -> int:
    camera = node.vehicle.payload.camera
    camera.spacing_m = c.p1
    if c.p3 == 1:
        camera.shoot()
    return ACCEPTED


def _start_capture(node: ArduNode, c: Command) -> int:
    if c.p1 < 0:
        return UNSUPPORTED
    if not math.isfinite(c.p3) or c.p1 > 1:
        return FAILED
    return node.vehicle.payload.capture(c.p2, c.p3)


def _stop_capture(node: ArduNode, c: Command) -> int:
    if c.p1 < 0 or (c.p1 > 0 and not node.vehicle.payload.camera.present):
        return UNSUPPORTED
    node.vehicle.payload.camera.stop()
    return ACCEPTED


HANDLERS: Handlers = {
    **commands.HANDLERS,
    181: lambda node, c: node.vehicle.payload.set_relay(int(c.p1), int(c.p2)),
    183: lambda node, c: node.vehicle.payload.set_servo(int(c.p1), min(max(int(c.p2), 0), 65535)),
    193: _pause_continue,
    195: _region_of_interest,
    197: lambda node, c: node.vehicle.region_of_interest(None) or ACCEPTED,
    201: _region_of_interest,
    203: _shoot,
    204: lambda node, c: node.vehicle.payload.gimbal.present,
    205: _mount_control,
    206: _trigger_distance,
    224: _set_current,
    300: _mission_start,
    1000: _gimbal_pitch_yaw,
    2000: _start_capture,
    2001: _stop_capture,
}
