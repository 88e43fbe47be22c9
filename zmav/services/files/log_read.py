"""Reading one log by the log protocol: ask for a stretch, take what streams in, ask again for what was lost."""

from __future__ import annotations

import struct
import time
from typing import Any

from zmav.errors import TimedOut
from zmav.services.files.ftp_read import Sink
from zmav.services.files.progress import Meter
from zmav.services.link.mailbox import Mailbox
from zmav.services.link.port import Port

DATA = struct.Struct("<IHB90s")
"""LOG_DATA: ofs, id, count, data"""
CHUNK = 90
WINDOW = 1 << 21
"""bytes asked for at once"""
BULK = 8 * CHUNK
"""a last gap above this is the untouched rest of the log, and no hole"""
QUIET = 0.5
"""s without data after which a stream is over"""
PATIENCE = 1.0
GIVE_UP = 15.0
"""s without any new byte"""


def send(port: Port, target: tuple[int, int], name: str, **fields: Any) -> None:
    """A message of the log protocol."""
    port.send(name, target_system=target[0], target_component=target[1], **fields)


class LogReader:
    """Fills a sink's gaps with log ``number``.

    An autopilot that is sending ignores requests, so there is one at a time; holes near each other are asked for
    together, because to ask takes a round trip, in which much can be sent.
    """

    def __init__(self, port: Port, target: tuple[int, int], number: int, sink: Sink, meter: Meter) -> None:
        self._port, self._target, self._number = port, target, number
        self._sink, self._meter = sink, meter
        self._rate = 0.0
        self._trip = PATIENCE

    async def run(self) -> None:
        """Returns when nothing is missing; raises :class:`TimedOut`. Ends the transfer on the autopilot, too."""
        fresh = time.monotonic()
        with Mailbox(self._port, self._target, "LOG_DATA") as mail:
            try:
                while self._sink.gaps:
                    if await self._stretch(mail, *self._next()):
                        fresh = time.monotonic()
                    elif time.monotonic() - fresh > GIVE_UP:
                        words = f"no data of log {self._number} within {GIVE_UP:.0f} s"
                        raise TimedOut(words, vehicle=self._port.name)
            finally:
                send(self._port, self._target, "LOG_REQUEST_END")

    def _next(self) -> tuple[int, int]:
        """The stretch to ask for next: the untouched rest first, holes last."""
        gaps = list(self._sink.gaps)
        start, end = gaps[-1]
        if end - start <= BULK:
            start, end = self._sink.gaps.merged(CHUNK + int(self._rate * self._trip))[0]
        return start, min(end, start + WINDOW)

    async def _stretch(self, mail: Mailbox, start: int, end: int) -> int:
        """Ask for it, and take what comes until its end or until nothing comes; gives how many new bytes came."""
        send(self._port, self._target, "LOG_REQUEST_DATA", id=self._number, ofs=start, count=end - start)
        asked = at = time.monotonic()
        new = came = 0
        while self._sink.gaps:
            frame = await mail.get(max(QUIET, 2.0 * self._trip) if came else 2.0 * self._trip)
            if frame is None:
                break
            offset, number, count, data = DATA.unpack(frame.payload[: DATA.size].ljust(DATA.size, b"\0"))
            if number != self._number:
                continue
            at = time.monotonic()
            if not came:
                self._trip = min(max(at - asked, 0.1), PATIENCE)
            came += count
            new += self._take(offset, data[: min(count, CHUNK)])
            if count < CHUNK and start <= offset < end:
                if offset + count < end:
                    self._sink.cut(offset + count)  # it is shorter than it was listed
                break
            if start < offset + count and offset + count >= end:
                break
        if came:
            self._rate = came / max(at - asked, 1e-3)
        else:
            self._trip = min(self._trip * 1.5, PATIENCE)
            send(self._port, self._target, "LOG_REQUEST_END")  # or what it takes for under way holds ours up
        return new

    def _take(self, offset: int, data: bytes) -> int:
        new = self._sink.put(offset, data)
        self._meter.add(new)
        return new
