"""Beats in wall time for a selector loop, finer and steadier than the loop's own ticks."""

from __future__ import annotations

import os
import selectors
import threading
import time
from collections.abc import Callable

MOST_LATE = 5  # beats that are made up for after a delay


class Metronome:
    """Calls ``beat`` in the selector's thread, ``hz`` times a second, while it is open; late beats come together, but
    never more than :data:`MOST_LATE`.
    """

    def __init__(self, hz: float, selector: selectors.BaseSelector, beat: Callable[[], None]) -> None:
        self._period = 1.0 / hz
        self._selector = selector
        self._beat = beat
        self._over = threading.Event()
        self._ear, self._bell = os.pipe()
        os.set_blocking(self._ear, False)
        os.set_blocking(self._bell, False)
        selector.register(self._ear, selectors.EVENT_READ, self._hear)
        self._thread = threading.Thread(target=self._run, name="zmav-sim-beat", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            due += self._period
            late = time.monotonic() - due
            if late > MOST_LATE * self._period:
                due += late
            if self._over.wait(max(due - time.monotonic(), 0.0)):
                return
            try:
                os.write(self._bell, b"\0")
            except BlockingIOError:
                continue  # nobody has listened for thousands of beats

    def _hear(self) -> None:
        try:
            beats = len(os.read(self._ear, 4096))
        except BlockingIOError:
            return
        for _ in range(min(beats, MOST_LATE)):
            self._beat()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._selector.unregister(self._ear)
        os.close(self._ear)
        os.close(self._bell)
