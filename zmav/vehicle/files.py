"""Files and logs of a vehicle's autopilot, as a script has them.

The vehicle does what can fail on its own link: it fetches and writes by MAVFTP and the log protocol, retries, resumes.
What is left for the network is to copy bytes, in chunks that are asked for again until all are there.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from zmav import keys, wire
from zmav.errors import BadInput, TimedOut, ZmavError
from zmav.mavlink.ftp import crc32_of_file
from zmav.services.files.sink import TransferMeter
from zmav.wire.files import CHUNK, MOST_CHUNKS, read_offset

if TYPE_CHECKING:
    from zmav.client import Answer, Client
    from zmav.vehicle.vehicle import Vehicle

Progress = Callable[[dict[str, Any]], None]
FEWEST_CHUNKS = 4
ANSWER = 3.0
"""s for the chunks of one query"""
QUICK = 0.5
"""s: a query answered sooner may ask for more; and the shortest wait for one"""
GIVE_UP = 60.0
"""s without a new byte from a vehicle before a download is left; a later one goes on"""
PART = ".part"


class Files:
    """``vehicle.files``: raises as :class:`~zmav.vehicle.Vehicle`'s orders do."""

    def __init__(self, vehicle: Vehicle, client: Client) -> None:
        self._vehicle, self._client = vehicle, client

    async def list(self, path: str = "/") -> list[wire.FileEntry]:
        """A directory of the autopilot."""
        result = await self._vehicle.order("file_list", wire.FilePath(path=path))
        return msgspec.convert(result["entries"], list[wire.FileEntry])

    async def get(self, path: str, to: str | Path | None = None, progress: Progress | None = None) -> Path:
        """Copy a file of the autopilot to ``to``: a file, a directory, or None for the present one; gives where it is.

        ``progress`` is called with ``{"stage", "bytes", "size", "rate"}``: stage "autopilot" while the vehicle fetches
        it, "network" while it comes here. Both stages go on where an earlier call was cut off.
        """
        result = await self._vehicle.order("file_get", wire.FileGet(path=path), _staged(progress, "autopilot"))
        return await self.download(_stored(result), to, path.rstrip("/").rpartition("/")[2], progress)

    async def put(self, local: str | Path, path: str, progress: Progress | None = None) -> dict[str, Any]:
        """Write a file of this machine to ``path`` on the autopilot; one that is there is replaced.

        Gives ``{"path", "size", "verified", "rate"}``. Raises :class:`BadInput` for a file that cannot be read, or has
        more than a mebibyte, and for what an ArduPilot makes of its plans and parameters (``@MISSION/mission.dat``).
        """
        try:
            data = await asyncio.to_thread(Path(local).read_bytes)
        except OSError as e:
            raise BadInput(f"cannot read {local}: {e.strerror}", field="local", value=str(local)) from e
        return await self.put_bytes(data, path, progress)

    async def put_bytes(self, data: bytes, path: str, progress: Progress | None = None) -> dict[str, Any]:
        """As :meth:`put`, from memory."""
        args = wire.FilePut(path=path, data=data)
        args.check()  # here, too: nothing crosses the network in vain
        return await self._vehicle.order("file_put", args, _staged(progress, "autopilot"))

    async def remove(self, path: str) -> None:
        """Remove a file of the autopilot."""
        await self._vehicle.order("file_remove", wire.FilePath(path=path))

    async def mkdir(self, path: str) -> None:
        await self._vehicle.order("file_mkdir", wire.FilePath(path=path))

    async def rmdir(self, path: str) -> None:
        """Remove an empty directory of the autopilot."""
        await self._vehicle.order("file_rmdir", wire.FilePath(path=path))

    async def cancel(self) -> str | None:
        """End the transfer of a file or log that is under way there, or the first that waits; gives what it was."""
        cancelled: str | None = (await self._vehicle.order("file_cancel", wire.Order()))["cancelled"]
        return cancelled

    # From the vehicle's computer to here.

    async def download(
        self, stored: wire.StoredFile, to: str | Path | None, name: str, progress: Progress | None = None
    ) -> Path:
        """Copy what the vehicle's computer holds to ``to``, called ``name`` where that is a directory.

        What has come of it is kept beside it as ``NAME.CRC.part``, and gone on with by the next call.
        """
        target = _target(to, name)
        part = target.with_name(f"{target.name}.{stored.crc32:08x}{PART}")
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            with part.open("ab") as file:
                if file.tell() > stored.size:
                    file.truncate(0)
                await self._pull(stored, file.fileno(), os.fstat(file.fileno()).st_size, _staged(progress, "network"))
            if await asyncio.to_thread(crc32_of_file, part) != stored.crc32:
                part.unlink()
                raise ZmavError(f"{target.name} came with errors: get it again", file=stored.file)
            part.replace(target)
        except OSError as e:
            raise BadInput(f"cannot write {target}: {e.strerror}", field="to", value=str(target)) from e
        return target

    async def _pull(self, stored: wire.StoredFile, fd: int, have: int, progress: Progress | None) -> None:
        """Append to the file what it lacks, in order; what came ahead of a lost chunk waits for it in memory."""
        meter = TransferMeter(progress or (lambda news: None), stored.size, have)
        ahead: dict[int, bytes] = {}
        count, wait, fresh = FEWEST_CHUNKS * 8, ANSWER, time.monotonic()
        while have < stored.size:
            began = time.monotonic()
            ahead.update(await self._ask_chunks(stored, have, count * CHUNK, wait))
            start = have
            while (data := ahead.pop(have, None)) is not None:
                os.write(fd, data)
                have += len(data)
            ahead = {at: data for at, data in ahead.items() if at > have}
            meter.add(have - start)
            took, now = time.monotonic() - began, time.monotonic()
            if have - start < min(count * CHUNK, stored.size - start):  # too much at once, or too little patience
                count, wait = max(count // 2, FEWEST_CHUNKS), min(2.0 * wait, ANSWER)
            else:
                wait = min(max(4.0 * took, QUICK), ANSWER)
                count = min(count * 2, MOST_CHUNKS) if took < QUICK else count
            if have > start:
                fresh = now
            elif now - fresh > GIVE_UP:
                raise TimedOut(f"no bytes from {self._vehicle.name} for {GIVE_UP:.0f} s: get it again to go on")
            else:  # also where something came: made up, or behind a lost chunk, it brings us no farther
                await asyncio.sleep(0.2)

    async def _ask_chunks(self, stored: wire.StoredFile, offset: int, length: int, wait: float) -> Mapping[int, bytes]:
        """The chunks that come of one query, by their offsets; they come in order, so the last one ends it. What is no
        chunk, anybody but the vehicle made up.
        """
        key = keys.FILE_CHUNK.key(self._vehicle.fleet, self._vehicle.name, file=stored.file, offset="*")
        query = wire.FileQuery(offset=offset, length=length)
        end = min(offset + length, stored.size)

        def begins(answer: Answer) -> int | None:
            return read_offset(answer.key.rpartition("/")[2]) if 0 < len(answer.payload) <= CHUNK else None

        def last(answer: Answer) -> bool:
            at = begins(answer)
            return at is not None and at + len(answer.payload) >= end

        answers = await self._client.ask(key, wire.encode(query), wait, keys.FILE_CHUNK, last)
        return {at: answer.payload for answer in _good(answers) if (at := begins(answer)) is not None}


class Logs:
    """``vehicle.logs``: raises as :class:`~zmav.vehicle.Vehicle`'s orders do."""

    def __init__(self, vehicle: Vehicle, files: Files) -> None:
        self._vehicle, self._files = vehicle, files

    async def list(self) -> list[wire.LogEntry]:
        """The autopilot's logs, oldest first. ArduPilot gives out none while armed: :class:`Refused`."""
        result = await self._vehicle.order("log_list", wire.LogList())
        return msgspec.convert(result["logs"], list[wire.LogEntry])

    async def get(
        self, log: int | wire.LogEntry, to: str | Path | None = None, progress: Progress | None = None
    ) -> Path:
        """Copy a log to ``to``, as :meth:`Files.get`; its name there is the entry's, or ``log_ID``."""
        number = log if isinstance(log, int) else log.id
        args = wire.LogGet(log=number)
        stored = _stored(await self._vehicle.order("log_get", args, _staged(progress, "autopilot")))
        suffix = Path(stored.path).suffix.lower()
        name = f"log_{number}{suffix}" if isinstance(log, int) else log.name
        return await self._files.download(stored, to, name, progress)

    async def erase(self) -> int:
        """Erase all logs of the autopilot; gives how many there were."""
        return int((await self._vehicle.order("log_erase", wire.LogErase()))["erased"])


def _staged(progress: Progress | None, stage: str) -> Progress | None:
    if progress is None:
        return None
    said = progress
    return lambda news: said({"stage": stage, **news})


def _good(answers: Sequence[Answer | ZmavError]) -> list[Answer]:
    """The answers; raises what the vehicle refused."""
    found = []
    for answer in answers:
        if isinstance(answer, ZmavError):
            raise answer
        found.append(answer)
    return found


def _stored(result: dict[str, Any]) -> wire.StoredFile:
    return msgspec.convert(result, wire.StoredFile)


def _target(to: str | Path | None, name: str) -> Path:
    """Where a download goes; no name that an autopilot gives leads out of the directory."""
    safe = name.replace("\\", "/").rpartition("/")[2].lstrip(".") or "file"
    target = Path(to) if to is not None else Path()
    with contextlib.suppress(OSError):
        if target.is_dir() or str(to).endswith("/"):
            return target / safe
    return target
