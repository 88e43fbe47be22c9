"""Replay links: a recording played as if an autopilot were there, in its own time, faster, or as fast as possible."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from zmav.errors import LinkDown
from zmav.links.base import Link, LinkFinished
from zmav.links.tlog import TlogReader
from zmav.links.url import ReplayUrl

# A step between two records that is longer than this, or backwards, is a clock that was set or a pause in the
# recording; it is played as no time at all.
LONGEST_STEP_S = 60.0


class ReplayLink(Link):
    """Plays a .tlog; ``on_data`` gets exactly one recorded frame a call.

    At the end the state is DOWN with "end of recording", and nothing is retried.
    A recording does not listen: ``send`` returns False and counts, so that nobody waits for an answer. Damage is
    skipped: ``counters.skipped`` has the bytes, ``last_error`` the place. ``now`` and ``pause`` are for tests: a clock
    in seconds, and a wait of so many seconds that returns True when the link is being closed.
    """

    recorded = True

    def __init__(
        self,
        target: ReplayUrl,
        now: Callable[[], float] = time.monotonic,
        pause: Callable[[float], bool] | None = None,
    ) -> None:
        super().__init__(str(target))
        self._target = target
        self._now = now
        self._pause = pause or self._closing.wait
        self._file: BinaryIO | None = None
        self._reader: TlogReader | None = None
        self._records: Iterator[tuple[int, bytes]] = iter(())
        self._last_us: int | None = None
        self._due = 0.0

    def _open(self) -> str:
        try:
            self._file = Path(self._target.path).open("rb")  # noqa: SIM115 - closed by _release
        except OSError as error:
            raise LinkDown(f"cannot open {self._target.path}: {error.strerror or error}", url=self.url) from error
        self._reader = TlogReader(self._file, self._closing.is_set)
        self._records = iter(self._reader)
        self._last_us = None
        pace = f"{self._target.speed:g} times real time" if self._target.speed else "as fast as possible"
        return f"playing {self._target.path}, {pace}"

    def _read(self) -> bytes:
        record = next(self._records, None)
        self._tell_damage()
        if record is None:
            if not self._closing.is_set():
                self._end()
            return b""
        stamp, frame = record
        return frame if self._wait_for(stamp) else b""

    def _wait_for(self, stamp: int) -> bool:
        """Wait until the record of ``stamp`` (microseconds) is due; False when the link is being closed."""
        if not self._target.speed:
            return True
        if self._last_us is None:
            self._due = self._now()
        else:
            step = (stamp - self._last_us) / 1e6
            if 0 < step <= LONGEST_STEP_S:
                self._due += step / self._target.speed
        self._last_us = stamp
        delay = self._due - self._now()
        return delay <= 0 or not self._pause(delay)

    def _tell_damage(self) -> None:
        if self._reader is not None and self._reader.skipped > self._counters.skipped:
            self._counters.skipped = self._reader.skipped
            self._note(f"{self._target.path}: {self._reader.trouble}")

    def _end(self) -> None:
        empty = self._reader is None or not self._reader.records
        if empty:
            self._note(f"{self._target.path} holds no MAVLink records")
        raise LinkFinished(f"{self._target.path} holds no MAVLink records" if empty else "end of recording")

    def _write(self, data: bytes) -> int:
        return 0

    def _release(self) -> None:
        self._records, self._reader = iter(()), None
        if self._file is not None:
            self._file.close()
            self._file = None
