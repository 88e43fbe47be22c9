"""Servo outputs, and any other MAV_CMD by its name: relays, gimbal, camera."""

from __future__ import annotations

import math
from typing import Any

from zmav import wire
from zmav.autopilots import Command
from zmav.autopilots.base import HERE
from zmav.errors import BadInput
from zmav.mavlink import command_type
from zmav.services.authority.bounds import Bounds
from zmav.services.companion import Companion
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report

PWM = (500, 2500)
"""µs that a servo output can be set to"""


class Payload:
    """Handlers of ``servo`` and ``command``. Lives on the event loop."""

    def __init__(self, companion: Companion, commander: Commander, bounds: Bounds) -> None:
        self._port, self._do, self._bounds = companion.port, commander, bounds

    async def servo(self, args: wire.SetServo, report: Report) -> dict[str, Any]:
        """One output to a PWM; raises :class:`Refused` where the autopilot keeps that output for itself."""
        _within("output", args.output, 1, 32)
        _within("pwm", args.pwm, *PWM)
        await self._do.command(self._do.autopilot().servo(args.output, args.pwm))
        return {"output": args.output, "pwm": args.pwm}

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
        raise BadInput.wrong(field, value, f"{low:g} to {high:g}")
