"""MAVFTP beside the autopilot: its files, over the local link. https://mavlink.io/en/services/ftp.html

One conversation at a time: an autopilot has one session, or few, and a second transfer would only slow the first.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence

from zmav import wire
from zmav.errors import BadInput, Refused, Stale, TimedOut
from zmav.mavlink.ftp import MOST_DATA, Nak, Op, Packet, unpack_entries
from zmav.services.files.ftp_read import Memory, NothingCame, Reader, Sink
from zmav.services.files.ftp_requests import GIVE_UP, Job, Talk
from zmav.services.files.progress import Meter
from zmav.services.link.identity import Identity
from zmav.services.link.port import Port
from zmav.services.orders.orders import Report

CHUNKS = (MOST_DATA, 110, 64)
"""bytes of data a packet; a smaller one where nothing comes by the larger"""
BUSY_WAIT = 8.0
"""s to wait for a file server that another client uses"""
ABANDONED = 3.3
"""s until asking again: ArduPilot takes a session away after 3 s without a word from the server, refusals included"""
AGAIN = 0.5
HEARTBEAT_WAIT = 4.0
"""s to wait for an autopilot that has just fallen silent"""
CRC_RATE = 100_000.0
"""bytes/s at which a slow autopilot reads its card for a checksum"""
LONGEST_CRC = 120.0
BUSY = (Nak.INVALID_SESSION, Nak.NO_SESSIONS_AVAILABLE)


def generated(path: str) -> bool:
    """An ArduPilot file that is made as it is read (``@PARAM/param.pck``): its size and checksum are not known."""
    return path.lstrip("/").startswith("@") and not path.lstrip("/").startswith("@ROMFS")


def check_path(path: str, field: str = "path") -> bytes:
    """``path`` as the protocol carries it; raises :class:`BadInput`."""
    try:
        raw = path.encode()
    except UnicodeEncodeError:
        raw = b""
    if not 0 < len(raw) < MOST_DATA or b"\0" in raw:
        expected = f"1 to {MOST_DATA - 1} bytes of UTF-8 without NUL"
        raise BadInput(f"{path!r} cannot be a path: give {expected}", field=field, value=path, expected=expected)
    return raw


class Ftp:
    """The autopilot's files. Lives on the event loop.

    Everything raises :class:`Refused` with the server's reason in words (``nak`` in its detail),
    :class:`TimedOut` for a server that does not answer, :class:`Stale` for a silent autopilot, :class:`BadInput` for
    what cannot be a path.
    """

    def __init__(self, port: Port, identity: Identity) -> None:
        self._port, self._identity = port, identity
        self._turn = asyncio.Lock()
        self._what = ""
        self._seq = random.randrange(1 << 16)  # not where another run of ours ended
        self._dirty = True
        """a session of ours may still be open there, from before"""

    @property
    def under_way(self) -> str:
        """What is being done, in words; empty: nothing."""
        return self._what if self._turn.locked() else ""

    async def list(self, path: str, report: Report | None = None) -> list[wire.FileEntry]:
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
                if report is not None:
                    report({"entries": len(found)})

    async def crc32(self, path: str, size: int = 0, report: Report | None = None) -> int:
        """The server's :func:`zmav.mavlink.ftp.crc32` of a file; ``size``, where known, tells how long to wait."""
        raw = check_path(path)
        async with self._talk(f"checking {path}", report) as talk:
            give_up = GIVE_UP + min(size / CRC_RATE, LONGEST_CRC)
            answer = await self._ask(talk, Op.CALC_FILE_CRC32, raw, give_up=give_up)
        _check(answer, f"no checksum of {path}", path)
        return int.from_bytes(answer.data[:4], "little")

    async def remove(self, path: str, report: Report | None = None) -> None:
        await self._simple(Op.REMOVE_FILE, check_path(path), f"cannot remove {path}", path, report)

    async def rmdir(self, path: str, report: Report | None = None) -> None:
        """Remove an empty directory."""
        await self._simple(Op.REMOVE_DIRECTORY, check_path(path), f"cannot remove {path}", path, report)

    async def mkdir(self, path: str, report: Report | None = None) -> None:
        await self._simple(Op.CREATE_DIRECTORY, check_path(path), f"cannot make {path}", path, report)

    async def rename(self, path: str, to: str, report: Report | None = None) -> None:
        both = check_path(path) + b"\0" + check_path(to, "to")
        if len(both) >= MOST_DATA:
            why = f"the two paths together are longer than {MOST_DATA - 2} bytes"
            raise BadInput(why, field="to", value=to, expected="shorter paths")
        await self._simple(Op.RENAME, both, f"cannot rename {path}", path, report)

    async def _simple(self, op: Op, data: bytes, words: str, path: str, report: Report | None) -> None:
        async with self._talk(f"{op.name.lower().replace('_', ' ')} {path}", report) as talk:
            _check(await self._ask(talk, op, data), words, path)

    # Transfers.

    async def get(self, path: str, report: Report | None = None, limit: int = 1 << 24) -> bytes:
        """A whole file in memory, of ``limit`` bytes at most; for what other services need of the autopilot."""
        sink = Memory(limit)

        def begin(size: int) -> Sink:
            if not generated(path):
                sink.gaps.cut(size)
            return sink

        await self.fetch(path, begin, report)
        return bytes(sink.data)

    async def fetch(self, path: str, begin: Callable[[int], Sink], report: Report | None = None) -> Meter:
        """Read a file into the sink that ``begin(size)`` gives; only the sink's gaps are asked for.

        ``begin`` is called again with every attempt. ``size`` is the server's word, and a guess for a generated file.
        """
        raw = check_path(path)
        async with self._talk(f"getting {path}", report) as talk:
            for chunk in CHUNKS:
                answer = await self._open(talk, Op.OPEN_FILE_RO, raw, f"cannot read {path}", path)
                try:
                    size = int.from_bytes(answer.data[:4], "little")
                    sink = begin(size)
                    missing = min(sink.gaps.total, size)
                    meter = Meter(report or _nobody, None if generated(path) else size, max(size - missing, 0))
                    await Reader(talk, sink, chunk, meter).run()
                    return meter
                except NothingCame:
                    if chunk == CHUNKS[-1]:
                        raise
                finally:
                    await self._terminate(talk)
        raise AssertionError("unreachable: the last chunk size returns or raises")

    async def put(self, path: str, data: bytes, report: Report | None = None) -> Meter:
        """Write a whole file; an existing one is replaced. What is written in part is removed again."""
        raw = check_path(path)
        async with self._talk(f"putting {path}", report) as talk:
            await self._open(talk, Op.CREATE_FILE, raw, f"cannot write {path}", path)
            meter, whole = Meter(report or _nobody, len(data)), False
            try:
                await talk.pipeline(Op.WRITE_FILE, _parts(data), _written(path, meter))
                whole = True
            finally:
                await self._terminate(talk)
                if not whole and not generated(path):
                    with contextlib.suppress(TimedOut):
                        await talk.ask(Op.REMOVE_FILE, raw, give_up=2.0)
            return meter

    # Sessions.

    @contextlib.asynccontextmanager
    async def turn(self, what: str, report: Report | None) -> AsyncIterator[tuple[int, int]]:
        """Wait until no other transfer is under way, ``what`` in words; gives the autopilot's address."""
        if self._turn.locked() and report is not None:
            report({"waiting_for": self._what})
        async with self._turn:
            self._what = what
            if report is not None:
                report({"waiting_for": None})
            yield await self._heard()

    async def _heard(self) -> tuple[int, int]:
        """The autopilot's address; a few heartbeats in a row may be lost."""
        until = time.monotonic() + HEARTBEAT_WAIT
        while self._identity.source is None or not self._identity.connected:
            if time.monotonic() > until:
                raise Stale(f"the autopilot of {self._port.name} is not heard", vehicle=self._port.name)
            await asyncio.sleep(0.1)
        return self._identity.source

    @contextlib.asynccontextmanager
    async def _talk(self, what: str, report: Report | None) -> AsyncIterator[Talk]:
        """A conversation, when it is our turn."""
        async with self.turn(what, report) as source:
            with Talk(self._port, source, session=self._port.address[1], seq=self._seq) as talk:
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

    async def _open(self, talk: Talk, op: Op, raw: bytes, words: str, path: str) -> Packet:
        talk.session = self._port.address[1]
        self._dirty = True  # until the session is closed, and seen to be
        answer = await self._ask(talk, op, raw, busy=(Nak.FAIL, *BUSY))
        _check(answer, words, path)
        talk.session = answer.session
        return answer

    async def _terminate(self, talk: Talk) -> None:
        """Close the session, briefly: what we cannot close now is reset before the next transfer."""
        with contextlib.suppress(TimedOut):
            await talk.ask(Op.TERMINATE_SESSION, give_up=4.0)
            self._dirty = False


def _check(answer: Packet, words: str, path: str) -> None:
    """Raises :class:`Refused` for a NAK."""
    if answer.nak is not None:
        name, reason = answer.nak.name, answer.reason
        raise Refused(f"{words}: {reason}", path=path, nak=name, reasons=[reason])


def _parts(data: bytes) -> Iterator[Job]:
    for offset in range(0, len(data), MOST_DATA):
        part = data[offset : offset + MOST_DATA]
        yield Job(offset, len(part), part)


def _written(path: str, meter: Meter) -> Callable[[Job, Packet], None]:
    def written(job: Job, answer: Packet) -> None:
        _check(answer, f"cannot write {path} at byte {job.offset}", path)
        meter.add(job.size)

    return written


def _nobody(news: object) -> None:
    """A report that nobody reads."""
