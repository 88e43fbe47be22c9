"""The writer: takes what comes from any thread, and writes it in a thread of its own.

Between the two is a bounded queue, so that a slow disk holds up nobody: what does not fit is counted and left out.
Every second all is brought to the files, so a recorder that is killed loses at most that; every five seconds the
kernel is asked to bring the files to the disk itself, so that a power cut loses little more.
"""

from __future__ import annotations

import collections
import contextlib
import errno
import logging
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ground.record.decoder import Decoder, is_frame
from ground.record.folder import Folder
from ground.record.history import History
from ground.record.part import Part, Route
from zmav import keys
from zmav.cli.common import size
from zmav.errors import BadKey
from zmav.mavlink import Dialect

if TYPE_CHECKING:
    from ground.ros2.recorded import Recorded, RosMessage

logger = logging.getLogger(__name__)
AT_ONCE = 2000
ROOM_AGAIN = 1.05
"""so many times the floor must be free before writing goes on"""
ROOM_AFTER_FULL = 4 << 20
"""bytes that must be free at least, once the disk was full: or a few kB would be filled again and again"""


class RecordingSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How a session is recorded: sizes in bytes, times in seconds."""

    mcap: bool = True
    """one of everything, besides a .tlog of each vehicle"""
    ros2: bool = False
    """in it, what 'zmav ros2' would have published, besides"""
    split_size: int = 512 << 20
    split_time: float = 1800.0
    keep_free: int = 1 << 30
    queue: int = 100_000
    queue_bytes: int = 256 << 20
    """samples, and bytes of them, that may wait to be written"""
    poll: float = 0.05
    flush: float = 1.0
    sync: float = 5.0
    slow: float = 20.0
    """after which the disk is asked again to take what was written, and after which it is said that it has not"""
    retry: float = 5.0
    """between two tries of a disk that took nothing"""
    most_routes: int = 20_000
    """keys that are known: nobody's invented ones must fill the memory"""


class Counts(msgspec.Struct):
    """Samples since the start."""

    taken: int = 0
    written: int = 0
    """in the files, where they outlive this process"""
    dropped: int = 0
    """because the queue was full"""
    unwritten: int = 0
    """because there was no room on the disk"""
    refused: int = 0
    """no frames where frames should be, or on keys that are not recorded"""
    bytes: int = 0
    """of files, the finished ones included"""
    parts: int = 0


class Storage:
    """Writes a session. ``tell`` is called, in the writer's thread, with a line for anyone who watches."""

    def __init__(
        self, folder: Folder, settings: RecordingSettings, dialect: Dialect, tell: Callable[[str], None]
    ) -> None:
        self._folder, self._settings, self._dialect, self._tell = folder, settings, dialect, tell
        self.session: Path = folder.session()
        self.counts = Counts()
        self.history = History(Decoder(dialect))
        self.paused: str | None = None
        """why nothing is written at present"""
        self.part: Part | None = None
        self._ros: Recorded | None = None
        if settings.ros2:
            from ground.ros2.recorded import Recorded

            self._ros = Recorded(dialect)
        self._decoder = Decoder(dialect)
        self._routes: dict[str, Route | None] = {}
        self._queue: collections.deque[tuple[int, str, bytes]] = collections.deque()
        self._came = self._went = 0
        """bytes of samples that were put into the queue, and taken out of it"""
        self._lock = threading.Lock()
        """of what several threads put"""
        self._pending = 0
        """samples that are in the part and not in its files yet"""
        self._opened = self._flushed = self._synced = 0.0
        self._syncing: threading.Thread | None = None
        self._slow_said = False
        self._sync_failed: OSError | None = None
        self._retry = 0.0
        self._was_full = False
        self._finished_bytes = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, key: str, data: bytes, at: int | None = None) -> None:
        """Record a sample that came now, or at ``at`` (ns UTC). From any thread; never waits, never raises."""
        with self._lock:
            if len(self._queue) >= self._settings.queue or self._came - self._went > self._settings.queue_bytes:
                self.counts.dropped += 1
                return
            self._came += len(data)
            self._queue.append((at or time.time_ns(), key, data))

    def close(self) -> None:
        """Write what has come, and complete the files."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        with contextlib.suppress(OSError):
            self.session.rmdir()  # where nothing came

    # The writer's thread.

    def _run(self) -> None:
        stopping = False
        while not stopping:
            stopping = self._stop.wait(0.0 if self._queue else self._settings.poll) and len(self._queue) <= AT_ONCE
            try:
                self._write_some()
                now = time.monotonic()
                if now - self._flushed >= self._settings.flush or stopping:
                    self._flushed = now
                    self._house(now)
                if stopping:
                    self._close_part()
            except OSError as e:
                self._fail(e)
            except Exception:
                logger.exception("recording goes on after an error that nobody foresaw")

    def _write_some(self) -> None:
        """So many that, however fast they come, the files are flushed in time."""
        queue, batch = self._queue, list[tuple[Route, int, bytes]]()
        for _ in range(min(len(queue), AT_ONCE)):
            at, key, data = queue.popleft()
            self.counts.taken += 1
            self._went += len(data)
            route = self._route(key)
            if route is None or (route.frames and not is_frame(data)):
                self.counts.refused += 1
                continue
            batch.append((route, at, data))
        if batch:
            self._write(batch)

    def _route(self, key: str) -> Route | None:
        try:
            return self._routes[key]
        except KeyError:
            pass
        try:
            route = Route(key, self._dialect)
        except BadKey:
            return None
        if len(self._routes) >= self._settings.most_routes:
            return None
        self._routes[key] = route
        return route

    def _write(self, batch: list[tuple[Route, int, bytes]]) -> None:
        self.history.add_all(batch)
        rest = len(batch)
        try:
            part, json = self.part or self._begin(), self._decoder.json
            if part is None:
                return
            decode = self._settings.mcap
            for route, at, data in batch:
                if route.frames:
                    part.frame(route, at, data, json(data) if decode else None)
                else:
                    part.document(route, at, data)
                if self._ros is not None:
                    part.ros(_made(self._ros, route, at, data), at)
                self._pending += 1
                rest -= 1
        finally:
            self.counts.unwritten += rest

    def _begin(self) -> Part | None:
        """Open the next part; None while there is no room for one."""
        now = time.monotonic()
        if self.paused and now < self._retry:
            return None
        self._retry = now + self._settings.flush
        self.session.mkdir(parents=True, exist_ok=True)  # somebody may have taken it away
        if self._short_of_room(self._room_to_begin()):
            return None
        about = {"session": self.session.name, "part": str(self.counts.parts + 1), "dialect": self._dialect.name}
        self.part = Part(self.session, self.counts.parts + 1, self._settings.mcap, self._dialect, about)
        self.counts.parts += 1
        self._opened = self._synced = now
        if self.paused:
            self.paused, self._was_full = None, False
            self._tell("there is room again: recording goes on")
        return self.part

    def _room_to_begin(self) -> float:
        floor = self._settings.keep_free * (ROOM_AGAIN if self.paused else 1.0)
        return max(floor, ROOM_AFTER_FULL) if self._was_full else floor

    def _short_of_room(self, floor: float) -> bool:
        free = self._folder.free()
        if free >= floor:
            return False
        kept = size(self._settings.keep_free)
        self._pause(f"{size(free)} free on the disk, and {kept} are to be kept: nothing is recorded")
        return True

    def _pause(self, why: str) -> None:
        if self.paused is None:
            self._tell(why)
        self.paused = why

    def _house(self, now: float) -> None:
        """Once a second: flush, and see whether the files are large or old enough, or the disk is full."""
        part, failed = self.part, self._sync_failed
        if part is None:
            return
        if failed is not None:
            self._sync_failed = None
            raise failed
        part.flush()
        if part.gone:
            self._tell(f"somebody took files of {self.session} away: new ones are begun")
            self._lose_pending()
            self._close_part()
            return
        self._note_written(part)
        how = self._settings
        large, old = part.size >= how.split_size, now - self._opened >= how.split_time
        if self._short_of_room(how.keep_free) or large or old:
            self._close_part()
        elif self._syncing and self._syncing.is_alive():
            if now - self._synced >= how.slow and not self._slow_said:
                self._slow_said = True
                words = f"the disk has taken nothing for {how.slow:.0f} s"
                self._tell(f"{words}: a power cut now would cost more than that")
        elif now - self._synced >= how.sync:
            self._synced, self._slow_said = now, False
            self._syncing = threading.Thread(target=self._sync, args=(part.descriptors(),), name="sync", daemon=True)
            self._syncing.start()

    def _sync(self, descriptors: list[int]) -> None:
        """Have the kernel bring what was flushed to the disk. In a thread of its own: the writer waits for no disk."""
        for descriptor in descriptors:
            try:
                os.fdatasync(descriptor)
            except OSError as e:
                self._sync_failed = e
            finally:
                os.close(descriptor)

    def _note_written(self, part: Part) -> None:
        self.counts.written += self._pending
        self._pending = 0
        self.counts.bytes = self._finished_bytes + part.total

    def _lose_pending(self) -> None:
        self.counts.unwritten += self._pending
        self._pending = 0

    def _close_part(self) -> None:
        part, self.part = self.part, None
        if part is None:
            return
        part.finish()
        self._note_written(part)
        self._finished_bytes += part.total

    def _fail(self, error: OSError) -> None:
        """A disk that takes nothing more: what it has stays readable, and later it is tried again."""
        part, self.part = self.part, None
        if part is not None:
            part.abandon()
            for each in part.files:
                with contextlib.suppress(OSError):  # it is not there yet, or somebody takes it away just now
                    self._finished_bytes += each.path.stat().st_size
        self._lose_pending()
        self._retry = time.monotonic() + self._settings.retry
        self._was_full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        words = "the disk is full" if self._was_full else f"cannot write to {self.session}: {error.strerror}"
        self._pause(f"{words}: nothing is recorded until there is room")


def _made(ros: Recorded, route: Route, at: int, data: bytes) -> list[RosMessage]:
    """What ROS would have been told of a sample."""
    t = at / 1e9
    try:
        if route.channel is keys.RX and route.message is not None:
            return list(ros.frame(route.fleet, route.vehicle, route.message.name, data, t))
        if route.channel is keys.STATE:
            return list(ros.state(route.fleet, route.vehicle, data, t))
    except Exception:  # what was recorded as it came stays recorded
        logger.exception("%s was not told to ROS", route.key)
    return []
