"""SET_MESSAGE_INTERVAL and GET_MESSAGE_INTERVAL, one at a time: an acknowledgement does not say for which message.

https://mavlink.io/en/mavgen_python/howto_requestmessages.html
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from zmav.autopilots import Command
from zmav.mavlink.results import CommandResult
from zmav.services.link.port import Inbox, Port, is_ours

SET_MESSAGE_INTERVAL, GET_MESSAGE_INTERVAL = "MAV_CMD_SET_MESSAGE_INTERVAL", "MAV_CMD_GET_MESSAGE_INTERVAL"
TIMEOUT = 0.5
"""s for an acknowledgement"""
AFTER = 0.1
"""s for a MESSAGE_INTERVAL that comes after its acknowledgement: most come before"""
DEFAULT = 0.0
"""the interval that stands for whatever the autopilot does unasked; -1 stands for not at all"""


class IntervalAsker:
    """Asks one autopilot. Only one task may use it at a time. Lives on the event loop."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.silent = 0
        """times GET_MESSAGE_INTERVAL was not answered; after two it is not asked any more"""

    async def set(self, source: tuple[int, int], msgid: int, interval: float) -> int | None:
        """Have a message sent every ``interval`` µs; the MAV_RESULT, or None where nobody answered."""
        with Inbox(self._port, source, "COMMAND_ACK") as inbox:
            self.send(source, msgid, interval)
            deadline = time.monotonic() + TIMEOUT
            while (heard := await inbox.get(deadline - time.monotonic())) is not None:
                if self._answers(heard[1], SET_MESSAGE_INTERVAL):
                    return int(heard[1]["result"])
        return None

    def send(self, source: tuple[int, int], msgid: int, interval: float) -> None:
        """As :meth:`set`, without waiting for the answer."""
        self._send(source, SET_MESSAGE_INTERVAL, msgid, interval)

    async def get(self, source: tuple[int, int], msgid: int) -> float | None:
        """The interval in µs at which a message is sent now, -1: it is not; None where the autopilot does not say."""
        if msgid > 0xFFFF or self.silent >= 2:  # MESSAGE_INTERVAL has no room for a greater number
            return None
        with Inbox(self._port, source, "COMMAND_ACK", "MESSAGE_INTERVAL") as inbox:
            self._send(source, GET_MESSAGE_INTERVAL, msgid, 0.0)
            deadline = time.monotonic() + TIMEOUT
            while (heard := await inbox.get(deadline - time.monotonic())) is not None:
                name, fields = heard
                if name == "MESSAGE_INTERVAL":
                    self.silent = 0
                if name == "MESSAGE_INTERVAL" and fields["message_id"] == msgid:
                    return float(fields["interval_us"]) or None  # zero: it is not to be had
                if self._answers(fields, GET_MESSAGE_INTERVAL):
                    if fields["result"] != CommandResult.ACCEPTED:
                        return None
                    deadline = min(deadline, time.monotonic() + AFTER)
        self.silent += 1
        return None

    def _send(self, source: tuple[int, int], command: str, msgid: int, interval: float) -> None:
        message = Command(command, (float(msgid), interval)).message(self._port.dialect)
        self._port.send(message.name, **message.addressed(*source))

    def _answers(self, fields: Mapping[str, Any], command: str) -> bool:
        return fields.get("command") == self._port.dialect.value("MAV_CMD", command) and is_ours(fields, self._port)
