"""A serial line with an ear on it: what the autopilot received, and when."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from pathlib import Path
from typing import NamedTuple

from zmav.mavlink import Splitter, decode, load_dialect

TARGETS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT")
STEP = 1e-3
"""m/s: setpoint number n asks for n times this to the north"""


class Heard(NamedTuple):
    """One target that the autopilot was given."""

    at: float
    """monotonic s"""
    number: int
    """of the setpoint; 0: it is to hold"""


class Tap:
    """``with Tap(theirs, ours)``: a pseudo-terminal at ``ours`` that leads to the one at ``theirs``, once it exists."""

    def __init__(self, theirs: Path, ours: Path) -> None:
        self._theirs, self._ours = theirs, ours
        self.heard: list[Heard] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tap")

    def __enter__(self) -> Tap:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._ours.symlink_to(os.ttyname(self._slave))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        while not self._theirs.exists():
            if self._ended.wait(0.05):
                return
        line = os.open(self._theirs, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(line)
            self._carry(line)
        finally:
            os.close(line)

    def _carry(self, line: int) -> None:
        dialect = load_dialect()
        splitter, ids = Splitter(dialect), {dialect.message(name).id for name in TARGETS}
        while not self._ended.is_set():
            ready, _, _ = select.select([self._master, line], [], [], 0.2)
            for fd in ready:
                with contextlib.suppress(BlockingIOError, OSError):  # nobody has opened the other end yet, or any more
                    data = os.read(fd, 4096)
                    _write(line if fd == self._master else self._master, data)
                    if fd == self._master:
                        now = time.monotonic()
                        for frame in splitter.feed(data):
                            if frame.msgid in ids:
                                self.heard.append(Heard(now, round(decode(frame, dialect)["vx"] / STEP)))


def _write(fd: int, data: bytes) -> None:
    while data:
        select.select([], [fd], [], 1.0)
        data = data[os.write(fd, data) :]
