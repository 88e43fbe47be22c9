"""Reading a file by MAVFTP: bursts for what is wanted in bulk, single reads for the holes that loss tears."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Protocol

from zmav.errors import Refused, TimedOut
from zmav.mavlink.ftp import Nak, Op, Packet
from zmav.services.files.ftp_requests import AFTER_BURST, Job, Talk
from zmav.services.files.gaps import UNKNOWN, Gaps
from zmav.services.files.progress import Meter

QUIET = 0.5
"""s without a packet after which a burst is over; longer where the link's answers take longer"""
BURST = 500
"""packets of one burst: ArduPilot's"""
AT_ONCE = 32
"""holes that are filled by single reads before the rest is weighed again"""
BULK = 8
"""packets' worth of a last gap above which it is the untouched rest of the file, and no hole"""
SHORT = 0.03
"""s of a round trip up to which a link is short"""
MOST_BARREN = 6
"""bursts or rounds of reads without a new byte after which there is no hope"""


class Sink(Protocol):
    """Where a file's bytes go."""

    gaps: Gaps

    def put(self, offset: int, data: bytes) -> int:
        """Take these bytes; gives how many of them had been missing."""

    def cut(self, size: int) -> None:
        """The file ends here."""


class NothingCame(TimedOut):
    """The server answers, but no data comes: perhaps its packets are too large for the link."""


class Memory:
    """A file in memory."""

    def __init__(self, limit: int = 1 << 24) -> None:
        self.gaps = Gaps([(0, UNKNOWN)])
        self.data = bytearray()
        self._limit = limit

    def put(self, offset: int, data: bytes) -> int:
        end = offset + len(data)
        if end > self._limit:
            raise Refused(f"the file is larger than {self._limit} bytes", size=end)
        if end > len(self.data):
            self.data.extend(bytes(end - len(self.data)))
        self.data[offset:end] = data
        return self.gaps.fill(offset, end)

    def cut(self, size: int) -> None:
        self.gaps.cut(size)
        del self.data[size:]


class Reader:
    """Fills a sink's gaps from the file that is open in ``talk``'s session, ``chunk`` bytes a packet.

    A file whose true size nobody knows (ArduPilot's generated ones) has a last gap that ends at ``UNKNOWN``; where the
    server says that it ends, it is cut. Every read asks for a whole chunk, though less may be missing: ArduPilot's
    generated files are laid out for reads of one size.
    """

    def __init__(self, talk: Talk, sink: Sink, chunk: int, meter: Meter) -> None:
        self._talk, self._sink, self._chunk, self._meter = talk, sink, chunk, meter
        self._bursts = True
        self._end_near = False
        self._rate = 0.0
        self._barren = 0
        self._any = False

    async def run(self) -> None:
        """Returns when nothing is missing. Raises :class:`TimedOut`, :class:`NothingCame` or :class:`Refused`."""
        while self._sink.gaps:
            self._barren += 1
            if self._barren > MOST_BARREN:
                raise NothingCame("the file server answers, but sends no data", chunk=self._chunk)
            start = self._burst_from() if self._bursts else None
            if start is None:
                await self._reads()
            else:
                await self._burst(start)

    async def _reads(self) -> None:
        try:
            await self._talk.pipeline(Op.READ_FILE, self._holes(), self._on_read)
        except TimedOut as e:
            if self._any:
                raise
            raise NothingCame(e.message, chunk=self._chunk) from e

    def _burst_from(self) -> int | None:
        """Where a burst had best begin; None: single reads are quicker.

        The untouched rest of the file comes first. What is then missing are holes: a burst sends all that follows the
        first of them, again where it came already, and a read costs a round trip.
        """
        gaps = list(self._sink.gaps)
        start, end = gaps[-1]
        if not self._end_near and end - start > BULK * self._chunk:
            return None if self._reads_are_quicker() else start
        if not self._rate:
            return None
        first = gaps[0][0]
        span = BURST * self._chunk
        near = [(a, min(b, a + self._chunk) if b >= UNKNOWN else b) for a, b in gaps if a - first < span]
        holes = sum(-(-(b - a) // self._chunk) for a, b in near)
        reads = holes * max(self._talk.patience / self._talk.in_flight, self._chunk / self._rate)
        burst = min(gaps[-1][0] - first, span) / self._rate + self._talk.patience
        return first if burst < reads else None

    def _reads_are_quicker(self) -> bool:
        """Some servers pace their bursts far below what a short link holds: reads then bring more, and cost it nothing
        that others need.
        """
        trip = self._talk.trip
        if not self._rate or trip is None or trip > SHORT:
            return False
        return self._talk.in_flight * self._chunk / trip > 1.5 * self._rate

    def _holes(self) -> Iterator[Job]:
        """What is missing, as reads; a file's unknown end is felt for with one."""
        count = 0
        for start, end in self._sink.gaps:
            for offset in range(start, start + 1 if end >= UNKNOWN else end, self._chunk):
                yield Job(offset, self._chunk)
                count += 1
                if count >= AT_ONCE:
                    return

    def _on_read(self, job: Job, answer: Packet) -> None:
        if answer.nak is Nak.EOF or (answer.nak is None and not answer.data):
            self._sink.cut(job.offset)
            self._barren = 0
        elif answer.nak is not None:
            raise Refused(f"reading failed: {answer.reason}", nak=answer.nak.name, reasons=[answer.reason])
        else:
            self._take(answer)

    def _take(self, packet: Packet) -> None:
        new = self._sink.put(packet.offset, packet.data)
        self._meter.add(new)
        if new:
            self._barren, self._any = 0, True
        end = packet.offset + len(packet.data)
        if 0 < len(packet.data) < self._chunk and any(b >= UNKNOWN for _, b in self._sink.gaps):
            self._sink.cut(end)  # a packet that is not full is the file's last

    async def _burst(self, start: int) -> None:
        """Ask for everything from ``start`` on, and take what comes until it ends or falls silent."""
        asked = last = self._talk.send(Op.BURST_READ_FILE, offset=start, size=self._chunk)
        began = at = time.monotonic()
        came, ended = 0, False
        while not ended and self._sink.gaps:
            packet = await self._talk.receive(max(QUIET, self._talk.patience) if came else self._talk.patience)
            if packet is None:
                break
            if packet.req_opcode != Op.BURST_READ_FILE:
                continue
            ours = 0 < (packet.seq - asked) & 0xFFFF < 1 << 15
            if packet.nak is None:
                if ours and not came:
                    self._talk.learn(time.monotonic() - began)
                self._take(packet)
                came, at = came + len(packet.data), time.monotonic()
                ended = ours and packet.burst_complete
            elif ours:  # and not the last word of the burst before
                self._judge(packet, came)
                ended = True
            last = packet.seq if ours else last
        if came:
            self._rate = came / max(at - began, 1e-3)
        self._talk.skip(last, AFTER_BURST)

    def _judge(self, packet: Packet, came: int) -> None:
        """A NAK ends a burst: at the file's end, or because this server cannot burst."""
        if packet.nak is Nak.EOF:
            # Where nothing came it may all have been lost: a single read will tell.
            self._end_near = True
            self._barren = 0 if came else self._barren
        elif packet.nak in (Nak.UNKNOWN_COMMAND, Nak.FAIL, Nak.INVALID_DATA_SIZE):
            self._bursts = False
        else:
            raise Refused(f"reading failed: {packet.reason}", nak=str(packet.nak), reasons=[packet.reason])
