"""The autopilot's flight logs: listed and erased by the log protocol, fetched by it or as files.

https://mavlink.io/en/services/log.html. A log's bytes come in LOG_DATA of 90 each, streamed from where they were asked
for; what is lost is asked for again. MAVFTP carries 239 a packet, but ArduPilot paces it: its SITL sent 40 kB/s by
MAVFTP and 5 MB/s by the log protocol, which therefore comes first, while MAVFTP gives the checksum that it lacks.
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
from zmav.services.files.files import Files
from zmav.services.files.ftp import Ftp
from zmav.services.files.log_read import LogReader, send
from zmav.services.files.progress import Meter
from zmav.services.link.identity import Identity
from zmav.services.link.mailbox import Mailbox
from zmav.services.link.port import Port
from zmav.services.orders.orders import Handler, Report

ENTRY = struct.Struct("<IIHHH")
"""LOG_ENTRY: time_utc, size, id, num_logs, last_log_num"""
PATIENCE = 1.0
GIVE_UP = 15.0
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

    def __init__(self, port: Port, identity: Identity, ftp: Ftp, files: Files) -> None:
        self._port, self._identity, self._ftp, self._files = port, identity, ftp, files

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
        """Fetch a log; its result is a :class:`zmav.wire.StoredFile`. An interrupted one is gone on with.

        By the log protocol, else as a file; ``by`` ("log" or "ftp") insists on one of them.
        """
        if args.by not in ("", "ftp", "log"):
            raise BadInput(f"no way {args.by!r} to get a log", field="by", value=args.by, expected="ftp or log")
        entry = await self._entry(args.log, report)
        try:
            if args.by == "ftp":
                raise TimedOut("not asked for")
            stored = await self._files.transfer(self._by_protocol(entry, report))
        except TimedOut:
            path = None if args.by == "log" else await self._path_of(entry, report)
            if path is None and args.by == "ftp":
                why = f"no file of the autopilot can be told to be log {entry.id}: get it by the log protocol"
                raise Refused(why, vehicle=self._port.name) from None
            if path is None:
                raise
            stored = await self._files.transfer(self._files.fetch(path, report))
        result: dict[str, Any] = msgspec.to_builtins(stored)
        return result

    async def erase(self, args: wire.LogErase, report: Report) -> dict[str, Any]:
        """Erase all logs, and see that they are gone: ``{"erased": how many, "left": how many}``.

        One may be left, which the autopilot began again.
        """
        async with self._turn("erasing the logs", report) as source:
            before = await self._entries(source, report)
            deadline = time.monotonic() + ERASE
            while True:
                send(self._port, source, "LOG_ERASE")
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
        deadline = time.monotonic() + GIVE_UP
        ask, silence = (0, ALL), 0
        with Mailbox(self._port, source, "LOG_ENTRY") as mail:
            while True:
                send(self._port, source, "LOG_REQUEST_LIST", start=ask[0], end=ask[1])
                while (frame := await mail.get(PATIENCE)) is not None:
                    entry, total, newest = _entry(frame)
                    last = total - 1 if self._by_place else max(last, newest)
                    deadline = time.monotonic() + GIVE_UP
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

    # The two ways.

    async def _path_of(self, entry: Listed, report: Report) -> str | None:
        """The one file of that size in the autopilot's directories of logs."""
        autopilot = self._identity.autopilot
        found: list[str] = []
        places = list(autopilot.log_directories) if autopilot else []
        while places:
            place = places.pop(0)
            try:
                entries = await self._ftp.list(place, report)
            except Refused:
                continue  # not on this board
            for each in entries:
                path = f"{place}/{each.name}"
                if each.directory:
                    places.append(path)
                elif each.size == entry.size:
                    found.append(path)
        return found[0] if len(found) == 1 else None

    async def _by_protocol(self, entry: Listed, report: Report) -> wire.StoredFile:
        """The log protocol has no checksum: the file's is asked for, where it can be told which that is."""
        origin, identity = f"log/{self._described(entry).name}", f"{entry.size} {entry.time_utc}"
        store = self._files.store
        kept = store.find(origin, identity)
        if kept is not None and not kept.missing and kept.verified:
            return self._files.stored(kept, by="store", resumed=kept.size)
        expected = await self._checksum(entry, report)
        for resume in (bool(entry.time_utc) and not (kept and not kept.missing), False):
            async with store.open(origin, identity, entry.size, resume=resume) as part:
                async with self._turn(f"getting log {entry.id}", report) as source:
                    meter = Meter(report, entry.size, part.resumed)
                    await LogReader(self._port, source, entry.id, part, meter).run()
                if await part.finish(expected):
                    break
        return self._files.stored(part.meta, by="log", rate=meter.rate, resumed=part.resumed)

    async def _checksum(self, entry: Listed, report: Report) -> int | None:
        """Of the file that this log is; None where that cannot be told."""
        try:
            path = await self._path_of(entry, report)
            return None if path is None else await self._ftp.crc32(path, entry.size, report)
        except (Refused, TimedOut):
            return None


def _entry(frame: Frame) -> tuple[Listed, int, int]:
    """The entry, how many logs there are, and the highest id."""
    time_utc, size, number, count, last = ENTRY.unpack(frame.payload[: ENTRY.size].ljust(ENTRY.size, b"\0"))
    return Listed(number, size, time_utc), count, last
