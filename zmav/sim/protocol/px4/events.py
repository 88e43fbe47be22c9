"""The events microservice: https://mavlink.io/en/services/events.html

Every event has the next sequence number and goes to every link; one that was missed can be asked for again while it is
remembered.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from zmav.sim.autopilots.px4.events import Event
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender

REMEMBERED = 20
_ARGUMENTS = 40
_UNAVAILABLE = 0  # MAV_EVENT_ERROR_REASON


class EventPart(Part):
    """The events of one vehicle; ``sequence`` is the latest one's number."""

    def __init__(self, everyone: Callable[[], list[Channel]], boot_ms: Callable[[], int]) -> None:
        self.sequence = 0
        self._everyone = everyone
        self._boot_ms = boot_ms
        self._sent: deque[dict[str, Any]] = deque(maxlen=REMEMBERED)

    def answers(self) -> Mapping[str, Answer]:
        return {"REQUEST_EVENT": self.request}

    def send(self, event: Event, arguments: bytes) -> None:
        self.sequence = (self.sequence + 1) & 0xFFFF
        fields = {
            "id": event.id,
            "event_time_boot_ms": self._boot_ms(),
            "sequence": self.sequence,
            "log_levels": event.levels,
            "arguments": list(arguments.ljust(_ARGUMENTS, b"\0")),
        }
        self._sent.append(fields)
        for channel in self._everyone():
            channel.send("EVENT", **fields)

    def request(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """Somebody missed the events from ``first_sequence`` to ``last_sequence``."""
        first, last = msg["first_sequence"], msg["last_sequence"]
        known = {fields["sequence"]: fields for fields in self._sent}
        for number in range(first, min(last, first + REMEMBERED) + 1):
            if number in known:
                channel.send("EVENT", **known[number])
            else:
                channel.send(
                    "RESPONSE_EVENT_ERROR",
                    target_system=sender[0],
                    target_component=sender[1],
                    sequence=number,
                    sequence_oldest_available=min(known, default=self.sequence),
                    reason=_UNAVAILABLE,
                )
