"""What the autopilot says, for services that live on the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from zmav.mavlink import Frame, decode
from zmav.services.companion import Companion
from zmav.waiting import on_loop

Handler = Callable[[Mapping[str, Any], Frame], object]


class AutopilotMessages:
    """Calls each of ``handlers``, by message, on the event loop with fields and frame of every such message that
    the vehicle's autopilot itself sends, from :meth:`start` to :meth:`close`. What the dialect lacks never comes.
    """

    def __init__(self, companion: Companion, handlers: Mapping[str, Handler]) -> None:
        self._port, self._identity, self._handlers = companion.port, companion.identity, handlers
        self._stops: list[Callable[[], None]] = []

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        for name, handler in self._handlers.items():
            if name in self._port.dialect.by_name:
                self._stops.append(self._port.listen(name, on_loop(loop, self._taken_by(handler))))

    def _taken_by(self, handler: Handler) -> Callable[[Frame], None]:
        def take(frame: Frame) -> None:
            if (frame.sysid, frame.compid) == self._identity.source:
                handler(decode(frame, self._port.dialect), frame)

        return take

    def close(self) -> None:
        for stop in self._stops:
            stop()
