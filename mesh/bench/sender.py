"""Datagrams at a steady rate, from a thread: the event loop's own timing would be what is measured.

    offset  size
    0       4     tag of the run
    4       4     number, from 0
    8       8     the sender's monotonic clock in ns
    16      ...   filling, random so that no compression flatters the link

Little-endian. All of it is payload: what Zenoh, IP and the radio add comes on top.
"""

from __future__ import annotations

import os
import struct
import threading
import time
import zlib
from collections.abc import Callable

import zenoh

from mesh.bench.statistics import SECOND, Samples
from zmav.session import reason

_HEAD = struct.Struct("<IIq")
LEAST, MOST = _HEAD.size, 65_000
BEHIND = SECOND // 10
"""ns behind its times after which the sender gives up datagrams instead of sending a burst"""

head = _HEAD.pack


def tag_of(run: str) -> int:
    return zlib.crc32(run.encode())


def read(data: bytes, tag: int) -> tuple[int, int] | None:
    """A datagram's number and when it was sent; None where it is none of this run's."""
    if len(data) < LEAST:
        return None
    its_tag, number, sent = _HEAD.unpack_from(data)
    return (number, sent) if its_tag == tag else None


class Sender:
    """Calls ``put`` with ``total`` datagrams, one every ``1/hz`` s. Its thread ends by itself, or by :meth:`stop`."""

    def __init__(self, put: Callable[[bytes], None], tag: int, *, hz: float, size: int, total: int) -> None:
        self._put, self._tag, self._period, self._total = put, tag, SECOND / hz, total
        self._filling = os.urandom(size - LEAST)
        self.lateness = Samples()
        self._stop = False
        self._began = self._ended = 0
        self.sent = 0
        self.skipped = 0
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="bench-sender", daemon=True)

    def start(self) -> None:
        self._began = time.monotonic_ns()
        self._thread.start()

    def stop(self) -> None:
        self._stop = True

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    @property
    def seconds(self) -> float:
        """From the first datagram's time to the end of the last one's, or to now."""
        if not self._began:
            return 0.0
        return ((self._ended or time.monotonic_ns()) - self._began) / SECOND

    def _run(self) -> None:
        try:
            self._send_all()
        except zenoh.ZError as e:
            self.error = reason(e)  # the session has closed
        finally:
            planned = 0 if self._stop or self.error else int((self.sent + self.skipped) * self._period)
            self._ended = max(time.monotonic_ns(), self._began + planned)

    def _send_all(self) -> None:
        now, put, late = time.monotonic_ns, self._put, self.lateness.add
        tag, filling, period, start = self._tag, self._filling, self._period, float(self._began)
        slot = 0  # the datagram's place in time; its number counts those that were sent
        while slot < self._total and not self._stop:
            due = start + slot * period
            t = now()
            if t < due:
                time.sleep((due - t) / SECOND)
                continue
            if t - due > BEHIND:
                missed = min(int((t - due) / period), self._total - slot)
                self.skipped += missed
                slot += missed
                continue
            late(int(t - due))
            put(head(tag, self.sent, t) + filling)
            self.sent += 1
            slot += 1
