"""Orders to what a vehicle carries (servos, relays, gimbal, camera), and any other MAV_CMD by its name."""

from __future__ import annotations

import math
from typing import Any

from zmav import wire
from zmav.autopilots import Command
from zmav.autopilots.base import HERE
from zmav.errors import BadInput, Refused, Unsupported
from zmav.mavlink import command_type
from zmav.services.authority.bounds import Bounds
from zmav.services.link.port import Port
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report

NAN = math.nan
YAW_LOCK = 16
"""GIMBAL_MANAGER_FLAGS_YAW_LOCK"""
PWM = (500, 2500)
"""µs that a servo output can be set to"""
SHOTS = 1000


class Payload:
    """Handlers of the orders in :mod:`zmav.verbs` that move nothing but the payload. Lives on the event loop."""

    def __init__(self, port: Port, commander: Commander, bounds: Bounds) -> None:
        self._port, self._do, self._bounds = port, commander, bounds

    async def servo(self, args: wire.SetServo, report: Report) -> dict[str, Any]:
        """One output to a PWM; raises :class:`Refused` where the autopilot keeps that output for itself."""
        _within("output", args.output, 1, 32)
        _within("pwm", args.pwm, *PWM)
        await self._do.command(self._do.autopilot().servo(args.output, args.pwm))
        return {"output": args.output, "pwm": args.pwm}

    async def relay(self, args: wire.SetRelay, report: Report) -> dict[str, Any]:
        """MAV_CMD_DO_SET_RELAY."""
        _within("relay", args.relay, 0, 15)
        await self._do.command(Command("MAV_CMD_DO_SET_RELAY", (float(args.relay), float(args.on))))
        return {"relay": args.relay, "on": args.on}

    async def gimbal(self, args: wire.Gimbal, report: Report) -> dict[str, Any]:
        """Gimbal protocol v2 (MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW); v1 (DO_MOUNT_CONTROL) where that is not known.

        https://mavlink.io/en/services/gimbal_v2.html
        """
        _within("pitch", args.pitch, -math.pi, math.pi)
        _within("yaw", args.yaw, -math.pi, math.pi)
        pitch, yaw = math.degrees(args.pitch), math.degrees(args.yaw)
        flags = float(YAW_LOCK if args.yaw_lock else 0)
        try:
            await self._do.command(
                Command("MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW", (pitch, yaw, NAN, NAN, flags, 0.0, float(args.gimbal)))
            )
            return {"protocol": 2}
        except Unsupported:
            mavlink_targeting = 2.0
            await self._do.command(
                Command("MAV_CMD_DO_MOUNT_CONTROL", (pitch, 0.0, yaw, 0.0, 0.0, 0.0, mavlink_targeting))
            )
            return {"protocol": 1}

    async def trigger(self, args: wire.Trigger, report: Report) -> dict[str, Any]:
        """Take pictures: MAV_CMD_IMAGE_START_CAPTURE, or DO_SET_CAM_TRIGG_DIST where a distance is given.

        https://mavlink.io/en/services/camera.html; an autopilot without it is asked by DO_DIGICAM_CONTROL, one by one.
        """
        _within("count", args.count, 1, SHOTS)
        _within("interval", args.interval, 0.0, 3600.0)
        if args.distance is not None:
            _within("distance", args.distance, 0.0, 10_000.0)
            await self._do.command(Command("MAV_CMD_DO_SET_CAM_TRIGG_DIST", (args.distance, 0.0, 1.0)))
            return {"distance": args.distance}
        if args.count > 1 and args.interval <= 0:
            raise BadInput("several pictures need an interval", field="interval", value=args.interval, expected="s")
        try:
            await self._do.command(
                Command("MAV_CMD_IMAGE_START_CAPTURE", (float(args.camera), args.interval, float(args.count)))
            )
        except (Unsupported, Refused):
            if args.count > 1:
                raise
            await self._do.command(Command("MAV_CMD_DO_DIGICAM_CONTROL", (0.0, 0.0, 0.0, 0.0, 1.0)))
        return {"count": args.count}

    async def command(self, args: wire.RunCommand, report: Report) -> dict[str, Any]:
        """Any MAV_CMD, its parameters checked against the dialect; the result holds what the acknowledgement said."""
        command = self.judge_command(args)
        with self._do.beside():
            ack = await self._do.command(command, report)
        return {"command": command.name, "result_param2": ack.result_param2}

    def judge_command(self, args: wire.RunCommand) -> Command:
        """The command, where the bounds permit it."""
        command = self._built(args)
        self._bounds.check_command(command, force=args.force)
        return command

    def _built(self, args: wire.RunCommand) -> Command:
        kind = command_type(self._port.dialect, args.command)
        params = kind.fill(args.params, self._port.dialect)
        if args.frame is None:
            return Command(kind.name, params)
        frame = args.frame.upper()
        frame = frame if frame.startswith("MAV_FRAME_") else f"MAV_FRAME_{frame}"
        self._port.dialect.value("MAV_FRAME", frame)
        local = "LOCAL" in frame or "BODY" in frame
        scale = 1e4 if local else 1e7
        nowhere = HERE if self._do.autopilot().ignores_frames else 0
        place = [nowhere if math.isnan(p) else round(p * scale) for p in params[4:6]]
        if any(abs(p) > 0x7FFFFFFF for p in place):
            raise BadInput("param5 or param6 is out of range", field="params", value=args.params, expected="a place")
        return Command(kind.name, (*params[:4], *place, params[6]), frame)


def _within(field: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        expected = f"{low:g} to {high:g}"
        raise BadInput(f"{field} must be from {expected}", field=field, value=value, expected=expected)
