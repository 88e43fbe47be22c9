"""The files of one simulated autopilot: a small tree in memory, some of it made as it is read."""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import Protocol

from zmav.mavlink.ftp import DirectoryEntry, Nak

MOST = 8 << 20
"""bytes that clients can write; beyond them the card is full"""
MOST_NAMES = 1024
"""files and directories, likewise"""


class Readable(Protocol):
    """A file's bytes, each part of them made when it is read or before."""

    def __getitem__(self, part: slice, /) -> bytes:
        """Fewer than were asked for at its end."""


Maker = Callable[[str, int], Readable]
"""Makes a file's bytes: the part of its path behind "?", and the size of the reads it will be read by"""
Taker = Callable[[bytes], None]
"""Takes what was written in place of such a file, when it is closed"""
Stored = Callable[[], dict[str, bytes]]
"""The files of a directory that another part of the vehicle keeps, by name"""


class FileError(Exception):
    """Why an operation failed, as a server says it."""

    def __init__(self, nak: Nak, number: int = 0) -> None:
        super().__init__(nak.name)
        self.nak, self.number = nak, number


NOT_FOUND = FileError(Nak.FILE_NOT_FOUND)


class FileSystem:
    """Directories and files by absolute path; a path that begins with ``@`` names a generated file."""

    def __init__(self, *directories: str) -> None:
        self._directories = {"/"}
        self._files: dict[str, bytearray] = {}
        self._makers: dict[str, tuple[Maker, Callable[[], int]]] = {}
        self._takers: dict[str, Taker] = {}
        self._coming: dict[str, bytearray] = {}
        self._stored: dict[str, tuple[Stored, Callable[[str], bool]]] = {}
        for directory in directories:
            parts = directory.strip("/").split("/")
            self._directories.update("/" + "/".join(parts[: i + 1]) for i in range(len(parts)))

    def generate(self, path: str, maker: Maker, size: Callable[[], int], take: Taker | None = None) -> None:
        """Have ``path`` made again whenever it is opened; ``size`` is what it is said to have before. ``take``: who is
        given what is written to it; None: it cannot be written.
        """
        self._makers[path] = (maker, size)
        if take is not None:
            self._takers[path] = take

    def attach(self, directory: str, stored: Stored, remove: Callable[[str], bool]) -> None:
        """Show files that are kept elsewhere; ``remove(name)`` says whether there was one."""
        self._stored[directory] = (stored, remove)

    # ---- looking

    def list(self, path: str) -> list[DirectoryEntry]:
        path = normal(path)
        if path not in self._directories:
            raise NOT_FOUND
        inside = "/" if path == "/" else path + "/"
        names = [DirectoryEntry(name, None) for p in self._directories if (name := _child(p, inside))]
        names += [DirectoryEntry(name, len(data)) for p, data in self._files.items() if (name := _child(p, inside))]
        if path in self._stored:
            names += [DirectoryEntry(name, len(data)) for name, data in self._stored[path][0]().items()]
        return sorted(names, key=lambda entry: entry.name)

    def size(self, path: str) -> int:
        made = self._makers.get(path.partition("?")[0])
        return made[1]() if made else len(self._data(normal(path)))

    def open(self, path: str, read_size: int) -> Readable:
        """A file's bytes now, to be read in steps of ``read_size``."""
        base, _, query = path.partition("?")
        made = self._makers.get(base)
        return made[0](query, read_size) if made else bytes(self._data(normal(path)))

    def _data(self, path: str) -> bytes | bytearray:
        if path in self._files:
            return self._files[path]
        directory, _, name = path.rpartition("/")
        if directory in self._stored:
            data = self._stored[directory][0]().get(name)
            if data is not None:
                return data
        raise NOT_FOUND

    # ---- changing

    def create(self, path: str) -> None:
        """An empty file, in place of one that is there."""
        if path in self._takers:
            self._coming[path] = bytearray()
            return
        path = normal(path)
        if path in self._directories or self._parent(path) in self._stored:
            raise FileError(Nak.FILE_PROTECTED)
        self._check_parent(path)
        self._files[path] = bytearray()

    def write(self, path: str, offset: int, data: bytes) -> None:
        coming = self._coming.get(path)
        file = self._files.get(normal(path)) if coming is None else coming
        if file is None:
            raise NOT_FOUND
        growth = max(offset + len(data) - len(file), 0)
        if sum(map(len, (*self._files.values(), *self._coming.values()))) + growth > MOST:
            raise FileError(Nak.FAIL_ERRNO, errno.ENOSPC)
        if offset > len(file):
            file.extend(bytes(offset - len(file)))
        file[offset : offset + len(data)] = data

    def close(self, path: str) -> None:
        """Whoever wrote it is through."""
        coming = self._coming.pop(path, None)
        if coming is not None:
            self._takers[path](bytes(coming))

    def remove(self, path: str) -> None:
        path = normal(path)
        if path in self._directories:
            raise FileError(Nak.FAIL_ERRNO, errno.EISDIR)
        if self._files.pop(path, None) is None:
            directory, _, name = path.rpartition("/")
            if directory not in self._stored or not self._stored[directory][1](name):
                raise NOT_FOUND

    def mkdir(self, path: str) -> None:
        path = normal(path)
        if path in self._directories or path in self._files:
            raise FileError(Nak.FILE_EXISTS)
        self._check_parent(path)
        self._directories.add(path)

    def rmdir(self, path: str) -> None:
        path = normal(path)
        if path not in self._directories:
            raise NOT_FOUND
        if path == "/" or self.list(path) or path in self._stored:
            raise FileError(Nak.FAIL_ERRNO, errno.ENOTEMPTY)
        self._directories.discard(path)

    def rename(self, path: str, to: str) -> None:
        path, to = normal(path), normal(to)
        if path not in self._files:
            raise NOT_FOUND
        self._check_parent(to)
        if to in self._directories:
            raise FileError(Nak.FILE_EXISTS)
        self._files[to] = self._files.pop(path)

    def _check_parent(self, path: str) -> None:
        if self._parent(path) not in self._directories:
            raise NOT_FOUND
        if len(self._files) + len(self._directories) > MOST_NAMES:
            raise FileError(Nak.FAIL_ERRNO, errno.ENOSPC)

    @staticmethod
    def _parent(path: str) -> str:
        return path.rpartition("/")[0] or "/"


def normal(path: str) -> str:
    """``path`` from the root, without empty parts; one that climbs with ``..`` names nothing."""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if ".." in parts or path.startswith("@"):
        raise NOT_FOUND
    return "/" + "/".join(parts)


def _child(path: str, inside: str) -> str:
    """The name of what lies directly ``inside``; empty for anything else."""
    name = path[len(inside) :] if path.startswith(inside) else ""
    return "" if "/" in name else name
