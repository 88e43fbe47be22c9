"""Reading a file by MAVFTP: bursts for its untouched rest, single reads for the holes that loss tears."""

from __future__ import annotations

import time
from collections.abc import Iterator

from zmav.errors import Refused, TimedOut
from zmav.mavlink.ftp import MOST_DATA, Nak, Op, Packet
from zmav.services.files.ftp_requests import AFTER_BURST, Job, Talk
from zmav.services.files.sink import Sink, TransferMeter

QUIET = 0.5
"""s without a packet after which a burst is over; longer where the link's answers take longer"""
AT_ONCE = 32
"""holes that are filled by single reads before the rest is weighed again"""
BULK = 8 * MOST_DATA
"""bytes of a last gap above which it is the untouched rest of the file, and no hole"""
MOST_BARREN = 6
"""bursts or rounds of reads without a new byte after which there is no hope"""


class FtpReader:
    """Fills a sink's gaps from the file that is open in ``talk``'s session; where the server says that it ends, it is
    cut. Every read asks for a whole packet, though less may be missing: ArduPilot's generated files
    (``@PARAM/param.pck``) are laid out for reads of one size.
    """

    def __init__(self, talk: Talk, sink: Sink, meter: TransferMeter) -> None:
        self._talk, self._sink, self._meter = talk, sink, meter
        self._bursts = True
        self._barren = 0

    async def run(self) -> None:
        """Returns when nothing is missing. Raises :class:`TimedOut` or :class:`Refused`."""
        while self._sink.gaps:
            self._barren += 1
            if self._barren > MOST_BARREN:
                raise TimedOut("the file server answers, but sends no data")
            *_, (start, end) = self._sink.gaps
            if self._bursts and end - start > BULK:
                await self._burst(start)
            else:
                await self._talk.pipeline(Op.READ_FILE, self._holes(), self._on_read)

    def _holes(self) -> Iterator[Job]:
        """What is missing, as reads."""
        count = 0
        for start, end in self._sink.gaps:
            for offset in range(start, end, MOST_DATA):
                yield Job(offset, MOST_DATA)
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
            self._barren = 0

    async def _burst(self, start: int) -> None:
        """Ask for everything from ``start`` on, and take what comes until it ends or falls silent."""
        asked = last = self._talk.send(Op.BURST_READ_FILE, offset=start, size=MOST_DATA)
        began = time.monotonic()
        came = ended = False
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
                came, ended = True, ours and packet.burst_complete
            elif ours:  # and not the last word of the burst before
                self._judge(packet)
                ended = True
            last = packet.seq if ours else last
        self._talk.skip(last, AFTER_BURST)

    def _judge(self, packet: Packet) -> None:
        """A NAK ends the bursts: at the file's end single reads fill what was lost, and tell where the end is."""
        if packet.nak not in (Nak.EOF, Nak.UNKNOWN_COMMAND, Nak.FAIL, Nak.INVALID_DATA_SIZE):
            raise Refused(f"reading failed: {packet.reason}", nak=str(packet.nak), reasons=[packet.reason])
        self._bursts = False
