"""MAVFTP beside the autopilot: its files, over the local link. https://mavlink.io/en/services/ftp.html

One conversation at a time: an autopilot has one session, or few, and a second transfer would only slow the first. A
file is read in bursts for its untouched rest, and by single reads for the holes that loss tears.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from typing import Any, TypeVar

from zmav import wire
from zmav.errors import BadInput, Refused, Stale, TimedOut
from zmav.mavlink.ftp import MOST_DATA, Nak, Op, Packet, unpack_entries
from zmav.services.companion import Companion
from zmav.services.files.ftp_requests import AFTER_BURST, GIVE_UP, Job, Talk
from zmav.services.files.sink import Sink, TransferMeter
from zmav.services.orders.orders import Report

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
        """What is missing, as reads; looked up for each, for an answer may say that the file is shorter."""
        at = 0
        for _ in range(AT_ONCE):
            at = next((max(start, at) for start, end in self._sink.gaps if end > at), -1)
            if at < 0:
                return
            yield Job(at, MOST_DATA)
            at += MOST_DATA

    def _on_read(self, job: Job, answer: Packet) -> None:
        if answer.nak is Nak.EOF or (answer.nak is None and not answer.data):
            self._sink.cut(job.offset)
            self._barren = 0
        else:
            _check(answer, "reading failed")
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
            if packet.req_opcode != Op.BURST_READ_FILE or packet.session != self._talk.session:
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
            _check(packet, "reading failed")
        self._bursts = False


S = TypeVar("S", bound=Sink)
BUSY_WAIT = 8.0
"""s to wait for a file server that another client uses"""
ABANDONED = 3.3
"""s until asking again: ArduPilot takes a session away after 3 s without a word from the server, refusals included"""
AGAIN = 0.5
HEARTBEAT_WAIT = 4.0
"""s to wait for an autopilot that has just fallen silent"""
CRC_GIVE_UP = 30.0
"""s for a checksum: a slow autopilot reads its card at 100 kB/s"""
BUSY = (Nak.INVALID_SESSION, Nak.NO_SESSIONS_AVAILABLE)
MAYBE_BUSY = (Nak.FAIL, *BUSY)
"""what a file that cannot be opened now is refused with"""


def check_path(path: str) -> bytes:
    """``path`` as the protocol carries it; raises :class:`BadInput`."""
    try:
        raw = path.encode()
    except UnicodeEncodeError:
        raw = b""
    if not 0 < len(raw) < MOST_DATA or b"\0" in raw:
        expected = f"1 to {MOST_DATA - 1} bytes of UTF-8 without NUL"
        raise BadInput(f"{path!r} cannot be a path: give {expected}", field="path", value=path, expected=expected)
    return raw


class Ftp:
    """The autopilot's files. Lives on the event loop.

    Everything raises :class:`Refused` with the server's reason in words (``nak`` in its detail),
    :class:`TimedOut` for a server that does not answer, :class:`Stale` for a silent autopilot, :class:`BadInput` for
    what cannot be a path.
    """

    def __init__(self, companion: Companion) -> None:
        self._port, self._identity = companion.port, companion.identity
        self._turn = asyncio.Lock()
        self._what = ""
        self._holder: asyncio.Task[Any] | None = None
        self._wanted = 0
        """turns that somebody has or waits for"""
        self._seq = random.randrange(1 << 16)  # not where another run of ours ended
        self._dirty = True
        """a session of ours may still be open there, from before"""

    @property
    def under_way(self) -> tuple[asyncio.Task[Any] | None, str]:
        """Whose turn it is, and what is being done, in words; None, and empty: nobody's."""
        return (self._holder, self._what) if self._turn.locked() else (None, "")

    @property
    def idle(self) -> bool:
        """Nobody has a turn, nor waits for one: who asks for it now has it at once."""
        return self._wanted == 0

    async def list(self, path: str, report: Report) -> list[wire.FileEntry]:
        """The entries of a directory, as the server orders them, without ``.`` and ``..``."""
        raw, found = check_path(path), list[wire.FileEntry]()
        async with self._talk(f"listing {path}", report) as talk:
            offset = 0
            while True:
                answer = await self._ask(talk, Op.LIST_DIRECTORY, raw, offset=offset)
                if answer.nak is Nak.EOF:
                    return found
                _check(answer, f"cannot list {path}", path)
                entries = unpack_entries(answer.data)
                if not entries:
                    return found
                offset += len(entries)
                found += [
                    wire.FileEntry(name=e.name, size=e.size, directory=e.size is None)
                    for e in entries
                    if e is not None and e.name not in (".", "..")
                ]
                report({"entries": len(found)})

    async def crc32(self, path: str, report: Report) -> int:
        """The server's :func:`zmav.mavlink.ftp.crc32` of a file."""
        raw = check_path(path)
        async with self._talk(f"checking {path}", report) as talk:
            answer = await self._ask(talk, Op.CALC_FILE_CRC32, raw, give_up=CRC_GIVE_UP)
        _check(answer, f"no checksum of {path}", path)
        return int.from_bytes(answer.data[:4], "little")

    async def change(self, op: Op, path: str, report: Report) -> None:
        """Remove a file or an empty directory, or make a directory, as ``op`` says."""
        raw, words = check_path(path), op.name.lower().replace("_", " ")
        async with self._talk(f"{words} {path}", report) as talk:
            _check(await self._ask(talk, op, raw), f"cannot {words} {path}", path)

    # Transfers.

    async def fetch(
        self,
        path: str,
        begin: Callable[[int], S],
        report: Report,
        busy: Sequence[Nak] = MAYBE_BUSY,
        give_up: float = math.inf,
    ) -> tuple[S, TransferMeter]:
        """Read a file into the sink that ``begin(size)`` gives; only the sink's gaps are asked for. ``size`` is the
        server's word, and more than there is of a file that is made as it is read. ``busy``: refusals after which it
        is tried again for a while. ``give_up``: s without a packet of the server's after which it is given up, where
        that is sooner than usual.
        """
        raw = check_path(path)
        async with self._talk(f"getting {path}", report, give_up) as talk:
            answer = await self._open(talk, Op.OPEN_FILE_RO, raw, f"cannot read {path}", path, busy)
            try:
                size = int.from_bytes(answer.data[:4], "little")
                sink = begin(size)
                meter = TransferMeter(report, size, max(size - sink.gaps.total, 0))
                await FtpReader(talk, sink, meter).run()
                return sink, meter
            finally:
                await self._terminate(talk)

    async def put(self, path: str, data: bytes, report: Report) -> TransferMeter:
        """Write a whole file; an existing one is replaced. What is written in part is removed again."""
        raw = check_path(path)
        async with self._talk(f"putting {path}", report) as talk:
            await self._open(talk, Op.CREATE_FILE, raw, f"cannot write {path}", path)
            meter, whole = TransferMeter(report, len(data)), False
            try:
                await talk.pipeline(Op.WRITE_FILE, _parts(data), _written(path, meter))
                whole = True
            finally:
                await self._terminate(talk)
                if not whole:
                    with contextlib.suppress(TimedOut):
                        await talk.ask(Op.REMOVE_FILE, raw, give_up=2.0)
            return meter

    # Sessions.

    @contextlib.asynccontextmanager
    async def turn(self, what: str, report: Report) -> AsyncIterator[tuple[int, int]]:
        """Wait until no other transfer is under way, ``what`` in words; gives the autopilot's address."""
        if self._turn.locked():
            report({"waiting_for": self._what})
        self._wanted += 1
        try:
            async with self._turn:
                self._what, self._holder = what, asyncio.current_task()
                report({"waiting_for": None})
                yield await self._heard()
        finally:
            self._wanted -= 1

    async def _heard(self) -> tuple[int, int]:
        """The autopilot's address; a few heartbeats in a row may be lost."""
        until = time.monotonic() + HEARTBEAT_WAIT
        while self._identity.source is None or not self._identity.connected:
            if time.monotonic() > until:
                raise Stale(f"the autopilot of {self._port.name} is not heard", vehicle=self._port.name)
            await asyncio.sleep(0.1)
        return self._identity.source

    @contextlib.asynccontextmanager
    async def _talk(self, what: str, report: Report, give_up: float = math.inf) -> AsyncIterator[Talk]:
        """A conversation, when it is our turn."""
        async with self.turn(what, report) as source:
            with Talk(self._port, source, self._port.address[1], self._seq, give_up) as talk:
                try:
                    if self._dirty:
                        await talk.ask(Op.RESET_SESSIONS)
                        self._dirty = False
                    yield talk
                finally:
                    self._seq = talk.seq

    async def _ask(
        self, talk: Talk, op: Op, data: bytes, *, offset: int = 0, give_up: float = GIVE_UP, busy: Sequence[Nak] = BUSY
    ) -> Packet:
        """A request; who finds the server in another client's hands waits a little."""
        until = time.monotonic() + BUSY_WAIT
        while True:
            answer = await talk.ask(op, data, offset=offset, give_up=give_up)
            if answer.nak not in busy or time.monotonic() > until:
                return answer
            await asyncio.sleep(ABANDONED if answer.nak is Nak.INVALID_SESSION else AGAIN)
            if answer.nak is Nak.FAIL:
                until -= BUSY_WAIT / 2.0  # it may mean anything: two more attempts are enough
            if answer.nak is not Nak.INVALID_SESSION:
                await talk.ask(Op.RESET_SESSIONS)

    async def _open(
        self, talk: Talk, op: Op, raw: bytes, words: str, path: str, busy: Sequence[Nak] = MAYBE_BUSY
    ) -> Packet:
        talk.session = self._port.address[1]
        self._dirty = True  # until the session is closed, and seen to be
        answer = await self._ask(talk, op, raw, busy=busy)
        _check(answer, words, path)
        talk.session = answer.session
        return answer

    async def _terminate(self, talk: Talk) -> None:
        """Close the session, briefly: what we cannot close now is reset before the next transfer."""
        with contextlib.suppress(TimedOut):
            await talk.ask(Op.TERMINATE_SESSION, give_up=4.0)
            self._dirty = False


def _check(answer: Packet, words: str, path: str | None = None) -> None:
    """Raises :class:`Refused` for a NAK."""
    if answer.nak is not None:
        name, reason = answer.nak.name, answer.reason
        where = {} if path is None else {"path": path}
        raise Refused(f"{words}: {reason}", **where, nak=name, reasons=[reason])


def _parts(data: bytes) -> Iterator[Job]:
    for offset in range(0, len(data), MOST_DATA):
        part = data[offset : offset + MOST_DATA]
        yield Job(offset, len(part), part)


def _written(path: str, meter: TransferMeter) -> Callable[[Job, Packet], None]:
    def written(job: Job, answer: Packet) -> None:
        _check(answer, f"cannot write {path} at byte {job.offset}", path)
        meter.add(job.size)

    return written
