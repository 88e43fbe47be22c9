"""What a level of setpoints needs of the autopilot's parameters, and what the autopilot answers to those that are
commands: the two ways in which setpoints can be sent and yet not be flown.
"""

from __future__ import annotations

import time
from typing import Any

from zmav.autopilots import Autopilot, Level, Need, Target
from zmav.autopilots.base import Fields
from zmav.errors import Refused, Unsupported
from zmav.mavlink import Frame
from zmav.mavlink.results import CommandResult
from zmav.services.authority.may_move import SetpointCounts
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.port import is_ours
from zmav.services.orders.orders import Handler, Report
from zmav.services.params.params import Params

COMMANDS = ("MAV_CMD_DO_SET_SERVO", "MAV_CMD_DO_SET_ACTUATOR", "MAV_CMD_DO_REPOSITION")
ANSWER_WITHIN = 1.0
"""s after a setpoint in which an answer may be meant for it"""


TAKEN = (CommandResult.ACCEPTED, CommandResult.IN_PROGRESS)


class ParamPreconditions:
    """Judges each setpoint's level; a parameter that is not known yet is not held against it. On the event loop.

    ``counts`` gets each setpoint that the autopilot refuses.
    """

    def __init__(self, companion: Companion, params: Params, counts: SetpointCounts) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self._params, self._counts = params, counts
        self._numbers = {companion.port.dialect.value("MAV_CMD", name): name for name in COMMANDS}
        self._said: set[Need] = set()
        self._level: Level | None = None
        self._at = 0.0
        self._acks = AutopilotMessages(companion, {"COMMAND_ACK": self._on_ack})

    def start(self) -> None:
        self._acks.start()

    def close(self) -> None:
        self._acks.close()

    def check(self, autopilot: Autopilot, target: Target) -> None:
        """Raise :class:`Unsupported` with what to set where such setpoints would do nothing; say it once where they
        would do something else than they say.
        """
        self._level, self._at = target.level, time.monotonic()
        for need in autopilot.needs(target):
            source = self._identity.source
            why = need.unmet(self._params.value, source[0]) if source else None
            if why is None:
                self._said.discard(need)
            elif need.fatal:
                raise Unsupported(why, field=target.level, value=target.level, expected=why, count="parameter")
            elif need not in self._said:
                self._said.add(need)
                self._events.emit("setpoint", "warning", f"{target.level} setpoints: {why}", why="parameter")

    def explained(self, arm: Handler) -> Handler:
        """``arm``, whose refusal says which parameter of the autopilot stands against it, too."""

        async def explained(args: Any, report: Report) -> dict[str, Any]:
            try:
                return await arm(args, report)
            except Refused as e:
                source, autopilot = self._identity.source, self._identity.autopilot
                if source is None or autopilot is None or self._identity.armed or e.detail.get("reasons"):
                    raise  # the autopilot's own reasons are the better ones
                needs = [need.unmet(self._params.value, source[0]) for need in autopilot.arming_needs]
                unmet = [why for why in needs if why is not None]
                if not unmet:
                    raise
                raise Refused("; ".join((e.message, *unmet)), **{**e.detail, "reasons": unmet}) from e

        return explained

    def _on_ack(self, ack: Fields, frame: Frame) -> None:
        if time.monotonic() - self._at > ANSWER_WITHIN:
            return
        name, result = self._numbers.get(ack["command"]), ack["result"]
        if name is None or not is_ours(ack, self._port) or result in TAKEN:
            return
        self._counts.add("refused")
        said = (self._port.dialect.enum_name("MAV_RESULT", result) or str(result)).removeprefix("MAV_RESULT_")
        text = f"{self._level} setpoint: {name} refused: {said}"
        self._events.emit("setpoint", "warning", text, limit="sp refused", why="refused")
