"""The autopilot's files as orders, and the bytes of what was fetched as answers to queries.

``do/file_get`` brings a file into the :class:`~zmav.services.files.store.Store`; ``file/{file}/*`` is then answered
with its chunks.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar

import msgspec
import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, Refused
from zmav.mavlink.ftp import Nak, Op, check_written, crc32, is_generated
from zmav.services.companion import Companion
from zmav.services.files.ftp import Ftp
from zmav.services.files.store import Meta, PartialFile, Store
from zmav.services.orders.orders import Handler, Report
from zmav.services.queries.questions import Reply
from zmav.wire.files import CHUNK, MOST_CHUNKS, read_offset

T = TypeVar("T")
ATTEMPTS = 2
GENERATED = 1 << 20
"""bytes that are read at most of a file whose size the autopilot only guesses"""


class Files:
    """Orders ``file_*``, on the event loop, and the keys ``file/**``, in the lane of questions."""

    def __init__(self, companion: Companion, ftp: Ftp, store: Store) -> None:
        self._port = companion.port
        key = {"fleet": companion.port.fleet, "vehicle": companion.port.name, "file": "*"}
        companion.questions.declare(keys.FILE.key(**key), self._on_info)
        companion.questions.declare(keys.FILE_CHUNK.key(**key, offset="*"), self._on_read)
        self.ftp, self.store = ftp, store
        self._transfers: list[asyncio.Task[Any]] = []
        """that have not ended, in their order: one is under way, and the others wait"""

    @property
    def handlers(self) -> dict[str, Handler]:
        """The verbs of this service."""
        return {
            "file_list": self.listing,
            "file_get": self.get,
            "file_put": self.put,
            "file_remove": lambda args, report: self._change(Op.REMOVE_FILE, args, report),
            "file_mkdir": lambda args, report: self._change(Op.CREATE_DIRECTORY, args, report),
            "file_rmdir": lambda args, report: self._change(Op.REMOVE_DIRECTORY, args, report),
            "file_cancel": self.cancel,
        }

    # Orders.

    async def listing(self, args: wire.FilePath, report: Report) -> dict[str, Any]:
        """The entries of a directory: ``{"entries": [FileEntry, ...]}``."""
        return {"entries": msgspec.to_builtins(await self.ftp.list(args.path, report))}

    async def get(self, args: wire.FileGet, report: Report) -> dict[str, Any]:
        """Fetch a file; its result is a :class:`zmav.wire.StoredFile`. Goes on where an earlier attempt was cut off,
        provided that the file is still the same one.
        """
        stored = await self.transfer(self.fetch(args.path, report))
        result: dict[str, Any] = msgspec.to_builtins(stored)
        return result

    async def put(self, args: wire.FilePut, report: Report) -> dict[str, Any]:
        """Write a file to the autopilot, and see by its checksum that it is there."""
        args.check()
        check_written(args.path)
        return await self.transfer(self._put(args, report))

    async def _put(self, args: wire.FilePut, report: Report) -> dict[str, Any]:
        meter = await self.ftp.put(args.path, args.data, report)
        found, sent = await self._crc(args.path, report), crc32(args.data)
        if found not in (None, sent):
            why = f"{args.path} was written, but its checksum is 0x{found:08x} and not 0x{sent:08x}"
            raise Refused(why, path=args.path)
        size = len(args.data)
        return {"path": args.path, "size": size, "verified": found is not None, "rate": round(meter.rate)}

    async def cancel(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """End the transfer under way, or the first that waits for something else. What has come of a file that is
        fetched is kept, to be gone on with.
        """
        task, what = self.ftp.under_way
        if task not in self._transfers:  # a plan or a listing; or between two turns of one, or before its first
            task, what = next(iter(self._transfers), None), "a transfer"
        ended = task is not None and task.cancel()
        return {"cancelled": what if ended else None}

    async def _change(self, op: Op, args: wire.FilePath, report: Report) -> dict[str, Any]:
        check_written(args.path)
        await self.ftp.change(op, args.path, report)
        return {}

    # Fetching.

    async def transfer(self, work: Coroutine[Any, Any, T]) -> T:
        """See ``work`` through as the transfer that ``file_cancel`` ends."""
        task = asyncio.ensure_future(work)
        self._transfers.append(task)
        task.add_done_callback(self._transfers.remove)  # however often who waits for it is cancelled
        return await task  # who is cancelled cancels it, and goes on when it has ended

    async def fetch(self, path: str, report: Report) -> wire.StoredFile:
        """Bring a file of the autopilot into the store. Only one whose checksum is known is gone on with."""
        for attempt in range(ATTEMPTS):
            expected = await self._crc(path, report)
            identity = "" if expected is None else f"{expected:08x}"
            kept = self.store.find(path, identity)
            if kept is not None and not kept.missing and kept.verified:
                return self.stored(kept, by="store", resumed=kept.size)
            resume = attempt == 0 and expected is not None
            part, rate, same = await self._fetch_once(path, identity, expected, resume, report)
            if same:
                break  # else it came out of two versions, or it grows as it is read
        return self.stored(part.meta, by="ftp", rate=rate, resumed=part.resumed)

    async def _fetch_once(
        self, path: str, identity: str, expected: int | None, resume: bool, report: Report
    ) -> tuple[PartialFile, float, bool]:
        async with contextlib.AsyncExitStack() as stack:

            def begin(size: int) -> PartialFile:
                size = max(size, GENERATED) if is_generated(path) else size
                part = self.store.open(path, identity, size, resume=resume)
                stack.push_async_exit(part)
                return part

            part, meter = await self.ftp.fetch(path, begin, report)
            same = await part.finish(expected)
        return part, meter.rate, same

    async def _crc(self, path: str, report: Report) -> int | None:
        """The autopilot's checksum; None where it cannot give one, or none that fits what we read."""
        if is_generated(path):
            return None
        report({"checking": True})
        try:
            return await self.ftp.crc32(path, report)
        except Refused as e:
            if e.detail.get("nak") not in (Nak.UNKNOWN_COMMAND.name, Nak.FAIL.name):
                raise
            return None
        finally:
            report({"checking": None})

    def stored(self, meta: Meta, *, by: str, rate: float = 0.0, resumed: int = 0) -> wire.StoredFile:
        return wire.StoredFile(
            file=self.store.name_of(meta.origin),
            path=meta.origin,
            size=meta.size,
            crc32=meta.crc32,
            t=meta.t,
            verified=meta.verified,
            by=by,
            rate=round(rate),
            resumed=resumed,
        )

    # What was fetched, as answers: in the lane of questions.

    def _on_info(self, query: zenoh.Query) -> Iterator[Reply]:
        """What a file is, or all files where the query's key says so."""
        for name, meta in self.store.files.copy().items():
            key = keys.FILE.key(self._port.fleet, self._port.name, file=name)
            if not meta.missing and query.key_expr.intersects(key):
                yield Reply(key, wire.encode(self.stored(meta, by="store")))

    def _on_read(self, query: zenoh.Query) -> Iterator[Reply]:
        *_, name, offset = str(query.key_expr).split("/")
        if "*" in name or ("*" in offset and offset != "*"):
            return  # somebody looks around
        asked = self._asked(query, offset)
        data = self.store.read(name, asked.offset, min(asked.length, CHUNK * MOST_CHUNKS))
        for at in range(0, len(data), CHUNK):
            key = keys.FILE_CHUNK.key(self._port.fleet, self._port.name, file=name, offset=asked.offset + at)
            yield Reply(key, data[at : at + CHUNK], keys.RAW)

    def _asked(self, query: zenoh.Query, offset: str) -> wire.FileQuery:
        if offset != "*":
            at = read_offset(offset)
            if at is None:
                text = f"{offset!r} is no offset"
                raise BadInput(text, field="offset", value=offset, expected="a number of bytes")
            return wire.FileQuery(offset=at, length=CHUNK)
        asked = wire.decode(query.payload.to_bytes() if query.payload else b"", wire.FileQuery, "query of a file")
        if asked.offset < 0 or asked.length < 0:
            raise BadInput("offset and length are 0 or more", field="offset", value=asked.offset, expected="0 or more")
        return asked
