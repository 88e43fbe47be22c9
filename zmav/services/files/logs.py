"""The autopilot's flight logs by the log protocol: https://mavlink.io/en/services/log.html

A log's bytes come in LOG_DATA of 90 each, streamed from where they were asked for; what is lost is asked for again.
MAVFTP carries 239 a packet, but ArduPilot paces it: its SITL sent 40 kB/s by MAVFTP and 5 MB/s by the log protocol.
"""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import AsyncIterator
from typing import Any, NamedTuple

import msgspec

from zmav import wire
from zmav.errors import BadInput, Refused, Stale, TimedOut
from zmav.mavlink import Frame
from zmav.services.companion import Companion
from zmav.services.files.files import Files
from zmav.services.files.ftp import Ftp
from zmav.services.files.sink import Sink, TransferMeter
from zmav.services.link.port import Inbox, Port
from zmav.services.orders.orders import Handler, Report

ENTRY = struct.Struct("<IIHHH")
"""LOG_ENTRY: time_utc, size, id, num_logs, last_log_num"""
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
"""s without anything new"""
ERASE = 90.0
"""s that an erasure may take: a full flash chip is slow"""
ALL = 0xFFFF
EMPTY = 5
"""times that a list may be asked for in vain before it is taken for empty, where that is not said"""


class Listed(NamedTuple):
    """One LOG_ENTRY."""

    id: int
    size: int
    time_utc: int


class Logs:
    """Orders ``log_*``. Lives on the event loop."""

    patience, give_up = PATIENCE, GIVE_UP

    def __init__(self, companion: Companion, ftp: Ftp, files: Files) -> None:
        self._port, self._identity, self._ftp, self._files = companion.port, companion.identity, ftp, files

    @property
    def handlers(self) -> dict[str, Handler]:
        """The verbs of this service."""
        return {"log_list": self.listing, "log_get": self.get, "log_erase": self.erase}

    async def listing(self, args: wire.LogList, report: Report) -> dict[str, Any]:
        """All logs: ``{"logs": [LogEntry, ...]}``, oldest first. Raises :class:`Refused` while the vehicle is armed,
        where its autopilot then keeps its logs to itself.
        """
        async with self._turn("listing the logs", report) as source:
            found = await self._entries(source, report)
        if self._by_place:
            found.sort(key=lambda each: (each.time_utc, each.id))
        return {"logs": [msgspec.to_builtins(self._described(each)) for each in found]}

    async def get(self, args: wire.LogGet, report: Report) -> dict[str, Any]:
        """Fetch a log; its result is a :class:`zmav.wire.StoredFile`. An interrupted one is gone on with."""
        result: dict[str, Any] = msgspec.to_builtins(await self._files.transfer(self._fetch(args.log, report)))
        return result

    async def erase(self, args: wire.LogErase, report: Report) -> dict[str, Any]:
        """Erase all logs, and see that they are gone: ``{"erased": how many, "left": how many}``.

        One may be left, which the autopilot began again.
        """
        async with self._turn("erasing the logs", report) as source:
            before = await self._entries(source, report)
            deadline = time.monotonic() + ERASE
            while True:
                _send(self._port, source, "LOG_ERASE")
                with contextlib.suppress(TimedOut):  # it is busy
                    after = await self._entries(source, report)
                    if not {*before} & {*after}:
                        return {"erased": len(before), "left": len(after)}
                if time.monotonic() > deadline:
                    raise TimedOut(f"{len(after)} logs are still there after {ERASE:.0f} s", vehicle=self._port.name)

    # What there is.

    @contextlib.asynccontextmanager
    async def _turn(self, what: str, report: Report) -> AsyncIterator[tuple[int, int]]:
        autopilot = self._identity.autopilot
        if autopilot is None:
            raise Stale(f"the autopilot of {self._port.name} is not heard", vehicle=self._port.name)
        if self._identity.armed and not autopilot.logs_while_armed:
            words = "the autopilot gives out no logs while it is armed: land and disarm it first"
            raise Refused(words, vehicle=self._port.name, reasons=["Disarm for log download"])
        async with self._ftp.turn(what, report) as source:
            yield source

    @property
    def _by_place(self) -> bool:
        autopilot = self._identity.autopilot
        return autopilot is not None and autopilot.log_ids_are_places

    async def _entries(self, source: tuple[int, int], report: Report) -> list[Listed]:
        """All LOG_ENTRYs by id; what was lost of them is asked for again."""
        found: dict[int, Listed] = {}
        total, last = -1, 0
        deadline = time.monotonic() + self.give_up
        ask, silence = (0, ALL), 0
        with Inbox(self._port, source, "LOG_ENTRY") as mail:
            while True:
                _send(self._port, source, "LOG_REQUEST_LIST", start=ask[0], end=ask[1])
                while (frame := await mail.frame(self.patience)) is not None:
                    entry, total, newest = _entry(frame)
                    last = total - 1 if self._by_place else max(last, newest)
                    deadline = time.monotonic() + self.give_up
                    if total:
                        found[entry.id] = entry
                        report({"logs": len(found), "of": total})
                    wanted = set(range(last - total + 1, last + 1)) or set(found)
                    missing = sorted(wanted - set(found))
                    if not missing:
                        return [found[i] for i in sorted(found)]
                    ask = (missing[0], missing[-1])
                silence += not found
                if self._by_place and silence > EMPTY:
                    return []  # it says nothing where there is none
                if time.monotonic() > deadline:
                    words = "no list of logs came: this autopilot may have no log, or nowhere to write one"
                    raise TimedOut(words, vehicle=self._port.name)

    async def _entry(self, number: int, report: Report) -> Listed:
        async with self._turn(f"looking for log {number}", report) as source:
            found = await self._entries(source, report)
        for entry in found:
            if entry.id == number:
                return entry
        raise BadInput(f"there is no log {number}", field="log", value=number, expected="an id of log_list")

    def _described(self, entry: Listed) -> wire.LogEntry:
        t = float(entry.time_utc) if entry.time_utc else None
        day = time.strftime("_%Y-%m-%d_%H-%M-%S", time.gmtime(t)) if t else ""
        autopilot = self._identity.autopilot
        suffix = autopilot.log_suffix if autopilot else ""
        return wire.LogEntry(id=entry.id, size=entry.size, t=t, name=f"log_{entry.id}{day}{suffix}")

    async def _fetch(self, number: int, report: Report) -> wire.StoredFile:
        """The log protocol has no checksum; each frame has one."""
        entry = await self._entry(number, report)
        origin, identity = f"log/{self._described(entry).name}", f"{entry.size} {entry.time_utc}"
        store = self._files.store
        kept, dated = store.find(origin, identity), bool(entry.time_utc)
        if kept is not None and not kept.missing and dated:
            return self._files.stored(kept, by="store", resumed=kept.size)
        async with store.open(origin, identity, entry.size, resume=dated) as part:
            async with self._turn(f"getting log {entry.id}", report) as source:
                meter = TransferMeter(report, entry.size, part.resumed)
                await LogReader(self._port, source, entry.id, part, meter).run()
            await part.finish(None)
        return self._files.stored(part.meta, by="log", rate=meter.rate, resumed=part.resumed)


class LogReader:
    """Fills a sink's gaps with log ``number``.

    An autopilot that is sending ignores requests, so there is one at a time; holes near each other are asked for
    together, because to ask takes a round trip, in which much can be sent.
    """

    def __init__(self, port: Port, target: tuple[int, int], number: int, sink: Sink, meter: TransferMeter) -> None:
        self._port, self._target, self._number = port, target, number
        self._sink, self._meter = sink, meter
        self._rate = 0.0
        self._trip = PATIENCE

    async def run(self) -> None:
        """Returns when nothing is missing; raises :class:`TimedOut`. Ends the transfer on the autopilot, too."""
        fresh = time.monotonic()
        with Inbox(self._port, self._target, "LOG_DATA") as mail:
            try:
                while self._sink.gaps:
                    if await self._stretch(mail, *self._next()):
                        fresh = time.monotonic()
                    elif time.monotonic() - fresh > GIVE_UP:
                        words = f"no data of log {self._number} within {GIVE_UP:.0f} s"
                        raise TimedOut(words, vehicle=self._port.name)
            finally:
                _send(self._port, self._target, "LOG_REQUEST_END")

    def _next(self) -> tuple[int, int]:
        """The stretch to ask for next: the untouched rest first, holes last."""
        *_, (start, end) = self._sink.gaps
        if end - start <= BULK:
            start, end = self._sink.gaps.merged(CHUNK + int(self._rate * self._trip))[0]
        return start, min(end, start + WINDOW)

    async def _stretch(self, mail: Inbox, start: int, end: int) -> int:
        """Ask for it, and take what comes until its end or until nothing comes; gives how many new bytes came."""
        _send(self._port, self._target, "LOG_REQUEST_DATA", id=self._number, ofs=start, count=end - start)
        asked = at = time.monotonic()
        new = came = 0
        while self._sink.gaps:
            frame = await mail.frame(max(QUIET, 2.0 * self._trip) if came else 2.0 * self._trip)
            if frame is None:
                break
            offset, number, count, data = DATA.unpack(frame.payload[: DATA.size].ljust(DATA.size, b"\0"))
            if number != self._number:
                continue
            at = time.monotonic()
            if not came:
                self._trip = min(max(at - asked, 0.1), PATIENCE)
            came += count
            fresh = self._sink.put(offset, data[: min(count, CHUNK)])
            self._meter.add(fresh)
            new += fresh
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
            _send(self._port, self._target, "LOG_REQUEST_END")  # or what it takes for under way holds ours up
        return new


def _send(port: Port, target: tuple[int, int], name: str, **fields: Any) -> None:
    """A message of the log protocol."""
    port.send(name, target_system=target[0], target_component=target[1], **fields)


def _entry(frame: Frame) -> tuple[Listed, int, int]:
    """The entry, how many logs there are, and the highest id."""
    time_utc, size, number, count, last = ENTRY.unpack(frame.payload[: ENTRY.size].ljust(ENTRY.size, b"\0"))
    return Listed(number, size, time_utc), count, last
