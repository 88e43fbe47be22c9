"""The folder of recordings: one recorder at a time, a folder for each session in it, how much room is left; and what a
recording is made of.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from pathlib import Path
from typing import NamedTuple

from zmav.errors import BadConfig

LOCK = ".recording"
MAGIC = b"\x89MCAP0\r\n"
"""the first and the last bytes of an .mcap"""


class Record(NamedTuple):
    """``at``: ns UTC of its recording; ``key``: on which it came, empty for a vehicle's frames."""

    at: int
    key: str
    data: bytes


class Folder:
    """Locked from the moment it is made until it is closed, or its process ends.

    Raises :class:`BadConfig` where another recorder writes here, or nobody may.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(path / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as e:
            text = f"cannot record to {path}: {e.strerror}"
            raise BadConfig(text, field="out", value=str(path), expected="a folder that can be written to") from e
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            holder = _words(os.pread(self._lock, 32, 0))
            os.close(self._lock)
            text = f"another recorder{holder} writes to {path}: give each its own folder by --out"
            raise BadConfig(text, field="out", value=str(path), expected="a folder that nobody records to") from e
        with contextlib.suppress(OSError):  # a full disk: who holds it is then not said
            os.ftruncate(self._lock, 0)
            os.pwrite(self._lock, str(os.getpid()).encode(), 0)
        self.unfinished = [file for file in self.recordings() if not _is_whole_or_nobodys(file)]
        """what a recorder that was killed left behind"""

    def close(self) -> None:
        """Let another recorder have it; twice is harmless."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Folder:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def session(self) -> Path:
        """A new folder, called by the time; BadConfig where it cannot be made."""
        name = time.strftime("%Y-%m-%d_%H-%M-%S")
        for number in range(1, 1000):
            path = self.path / (name if number == 1 else f"{name}.{number}")
            try:
                path.mkdir()
            except FileExistsError:
                continue
            except OSError as e:
                text = f"cannot record to {self.path}: {e.strerror}"
                raise BadConfig(text, field="out", value=str(path), expected="room for a folder") from e
            return path
        raise BadConfig(f"{self.path} has a thousand sessions of this second", field="out", value=str(self.path))

    def free(self) -> int:
        """Bytes that this user may still write to its file system. OSError where the folder is gone."""
        return shutil.disk_usage(self.path).free

    def recordings(self) -> list[Path]:
        """Every .mcap in it, by name: by age within this recorder's own."""
        return sorted(self.path.glob("*/record.*.mcap"))


def is_whole(path: Path) -> bool:
    """Whether an .mcap ends as a finished one does. OSError where it cannot be read."""
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) < 2 * len(MAGIC):
            return False
        file.seek(-len(MAGIC), os.SEEK_END)
        return file.read() == MAGIC


def _is_whole_or_nobodys(path: Path) -> bool:
    """What is empty, or cannot be read, nobody can mend."""
    try:
        return not path.stat().st_size or is_whole(path)
    except OSError:
        return True


def _words(pid: bytes) -> str:
    return f" (process {pid.decode()})" if pid.isdigit() else ""


class Tail:
    """A file that only grows, and whose end is always that of something whole: what is written waits in memory until
    :meth:`flush`, which brings all of it to the file or, where the disk is full, nothing.

    Open for one writer, and locked: nobody may mend it meanwhile. OSError where it cannot be made, or is there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.size = 0
        """bytes in the file"""
        self._waiting: list[bytes] = []
        self._waits = 0

    def write(self, data: bytes) -> int:
        self._waiting.append(data)
        self._waits += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size + self._waits

    def flush(self) -> None:
        """Bring what waits to the file, where it outlives this process. OSError: nothing of it is there, nor waits."""
        if not self._waiting:
            return
        data = memoryview(b"".join(self._waiting))
        self._waiting.clear()
        self._waits, done = 0, 0
        try:
            while done < len(data):
                done += os.write(self.fd, data[done:])
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self.fd, self.size)
            raise
        self.size += done

    @property
    def gone(self) -> bool:
        """Whether somebody took the file away: what is written then is lost."""
        return os.fstat(self.fd).st_nlink == 0

    def close(self) -> None:
        os.close(self.fd)

    def finish(self) -> None:
        """Bring what waits to the disk, and close it; after an OSError, too."""
        try:
            self.flush()
            os.fdatasync(self.fd)
        finally:
            self.close()

    def abandon(self) -> bool:
        """Close it as it is, readable to its last flush. False: it holds nothing, so it is gone."""
        with contextlib.suppress(OSError):
            self.flush()
        with contextlib.suppress(OSError):  # a disk that is read-only by now
            self.close()
            if not self.size:
                self.path.unlink(missing_ok=True)
                return False
        return True
