"""A file that only grows, and whose end is always that of something whole.

What is written waits in memory until :meth:`Tail.flush`, which brings all of it to the file or, where the disk is full,
nothing: the file is cut back to where it was. So a recorder that is killed loses what it had not flushed yet, and a
reader never finds half a record of its making.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path


class Tail:
    """Open for one writer, and locked: nobody may mend it meanwhile. OSError where it cannot be made, or is there."""

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
