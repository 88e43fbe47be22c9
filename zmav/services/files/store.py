"""The directory of fetched files on the vehicle's computer: bounded, resumable, and deaf to hostile names."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import re
import shutil
import tempfile
import time
from pathlib import Path

import msgspec

from zmav.errors import BadInput, Refused
from zmav.mavlink.ftp import crc32_of_file
from zmav.services.files.sink import Gaps

META = ".meta"
MOST = 1 << 30
"""bytes that are kept"""


def default_directory() -> Path:
    """The user's cache directory, or the temporary one where there is none to write in."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    if base.is_absolute() and os.access(_existing(base), os.W_OK):
        return base / "zmav" / "files"
    return Path(tempfile.gettempdir(), f"zmav-{os.getuid()}", "files")


def tiles_directory() -> Path:
    """Where tiles of ground are kept that were fetched."""
    return default_directory().parent / "tiles"


class Meta(msgspec.Struct, kw_only=True):
    """What lies beside each file. ``missing`` empty: it is whole, and ``crc32`` is its own checksum.

    ``identity`` is what tells that the autopilot's file is still the same: another size, checksum or time there, and
    what has come of it is worth nothing.
    """

    origin: str
    identity: str
    size: int
    missing: list[tuple[int, int]]
    t: float
    crc32: int = 0
    verified: bool = False


class PartialFile:
    """A file on its way into the store (a ``Sink``). Use it with ``async with``: what has come is noted at the end.

    Bytes are handed to the system at once, which is quick. Waiting for the disk is left to a thread: the event loop has
    setpoints to carry.
    """

    def __init__(self, store: Store, name: str, meta: Meta) -> None:
        self._store, self.name, self.meta = store, name, meta
        self.gaps = Gaps(meta.missing)
        self.resumed = meta.size - self.gaps.total
        self._file = os.open(store.directory / name, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)

    async def __aenter__(self) -> PartialFile:
        return self

    async def __aexit__(self, *_: object) -> None:
        try:
            with contextlib.suppress(OSError):  # a full disk must not hide what went wrong before
                await asyncio.to_thread(self._save)
        finally:
            os.close(self._file)

    def put(self, offset: int, data: bytes) -> int:
        """As ``Sink.put``; raises :class:`Refused` where the disk is full."""
        data = data[: max(self.meta.size - offset, 0)]
        new = self.gaps.fill(offset, offset + len(data))
        if new:
            try:
                os.pwrite(self._file, data, offset)
            except OSError as e:
                raise Refused(f"cannot keep the file: {e.strerror}", path=str(self._store.directory)) from e
        return new

    def cut(self, size: int) -> None:
        self.gaps.cut(size)
        self.meta.size = min(self.meta.size, size)

    def _save(self) -> None:
        """Note what has come, after it has reached the disk."""
        os.fdatasync(self._file)
        self._store.note(self.name, msgspec.structs.replace(self.meta, missing=list(self.gaps)))

    async def finish(self, expected: int | None) -> bool:
        """The file is whole: take its checksum. False where that is not the ``expected`` one."""
        os.ftruncate(self._file, self.meta.size)
        self.meta.crc32 = await asyncio.to_thread(crc32_of_file, self._store.directory / self.name)
        self.meta.verified = expected is not None and expected == self.meta.crc32
        self.meta.t = time.time()
        return expected is None or self.meta.verified


class Store:
    """Files by name. Reading is thread-safe; the rest is the event loop's."""

    def __init__(self, directory: Path, most: int = MOST) -> None:
        self.directory, self.most = directory, most
        self._files: dict[str, Meta] | None = None

    @property
    def files(self) -> dict[str, Meta]:
        """What there is, whole or in part; looked up on the disk once."""
        if self._files is None:
            self._files = self._look()
        return self._files

    def _look(self) -> dict[str, Meta]:
        found: dict[str, Meta] = {}
        for path in self.directory.glob("*" + META) if self.directory.is_dir() else ():
            name = path.name[: -len(META)]
            with contextlib.suppress(OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                meta = msgspec.json.decode(path.read_bytes(), type=Meta)
                size = (self.directory / name).stat().st_size
                if meta.missing or size == meta.size:
                    found[name] = meta
        return found

    def note(self, name: str, meta: Meta) -> None:
        """Write a file's meta, whole or not at all. Any thread."""
        path = self.directory / (name + META)
        fresh = path.with_name(path.name + "~")
        fresh.write_bytes(msgspec.json.encode(meta))
        fresh.replace(path)
        self.files[name] = meta

    @staticmethod
    def name_of(origin: str) -> str:
        """The name, and the part of the key, under which what came from ``origin`` is kept: no path has a say in it."""
        base = re.sub(r"[^a-z0-9._-]+", "_", origin.rpartition("/")[2].lower()).strip("._") or "file"
        return f"{hashlib.sha256(origin.encode()).hexdigest()[:10]}-{base[-60:]}"

    def find(self, origin: str, identity: str) -> Meta | None:
        """What is kept of it: whole, in part, or None."""
        meta = self.files.get(self.name_of(origin))
        return meta if meta is not None and meta.identity == identity else None

    def open(self, origin: str, identity: str, size: int, *, resume: bool = True) -> PartialFile:
        """Begin to keep a file, or go on where the same one was left.

        Makes room by removing what is oldest. Raises :class:`Refused` where there cannot be enough.
        """
        name = self.name_of(origin)
        meta = self.find(origin, identity) if resume else None
        if meta is None or meta.size != size:
            self.remove(name)
            meta = Meta(origin=origin, identity=identity, size=size, missing=[(0, size)] if size else [], t=time.time())
        self._make_room(name, size)
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            part = PartialFile(self, name, meta)
            self.note(name, meta)
        except OSError as e:
            raise Refused(f"cannot keep files in {self.directory}: {e.strerror}", path=str(self.directory)) from e
        return part

    def _make_room(self, name: str, size: int) -> None:
        if size > self.most:
            why = f"{size} bytes are more than the vehicle's computer keeps ({self.most})"
            raise Refused(why, size=size, most=self.most)
        others = sorted((meta.t, each) for each, meta in self.files.items() if each != name)
        used = sum(self._size(each) for _, each in others)
        for _, each in others:
            if used + size <= self.most and size - self._size(name) <= self._free():
                return
            used -= self._size(each)
            self.remove(each)
        if size - self._size(name) > self._free():
            why = f"{size} bytes do not fit on the vehicle's computer: {self._free()} are free"
            raise Refused(why, path=str(self.directory), size=size)

    def _free(self) -> int:
        return shutil.disk_usage(_existing(self.directory)).free

    def _size(self, name: str) -> int:
        try:
            return (self.directory / name).stat().st_size
        except OSError:
            return 0

    def remove(self, name: str) -> None:
        self.files.pop(name, None)
        for path in (self.directory / name, self.directory / (name + META)):
            with contextlib.suppress(OSError):
                path.unlink()

    def whole(self, name: str) -> Meta:
        """A file that is there in full; raises :class:`BadInput` for any other name: only what is listed is opened."""
        meta = self.files.get(name)
        if meta is None or meta.missing:
            text = f"no file {name!r} is kept here: fetch it by do/file_get or do/log_get"
            raise BadInput(text, field="file", value=name, expected="the result of do/file_get")
        return meta

    def read(self, name: str, offset: int, length: int) -> bytes:
        """Bytes of a whole file; fewer at its end."""
        self.whole(name)
        try:
            with (self.directory / name).open("rb") as file:
                file.seek(offset)
                return file.read(length)
        except OSError as e:
            raise BadInput(f"file {name!r} is gone: {e.strerror}", field="file", value=name, expected="") from e


def _existing(path: Path) -> Path:
    """The path, or the nearest directory above it that there is."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return path
