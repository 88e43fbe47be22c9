"""Where controllers come from: the process that flies, and the file that is watched.

A saved file is loaded and tried out in a process of its own; only when that has worked does it take the other's place,
between two cycles. A broken file changes nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from agents.controllers import loading
from agents.controllers.worker import Loaded, Worker, WorkerEvents
from zmav.errors import Refused

SAVED = 0.1
"""s between two looks at whether the file was saved"""


class ControllerReloader:
    """Of one supervisor, on its event loop. ``what``: a file or a name.

    ``fly_by(worker)`` is told whose outputs count; ``agree(loaded)`` may raise to refuse what was loaded.
    """

    def __init__(
        self,
        what: str,
        fly_by: Callable[[Worker | None], None],
        agree: Callable[[Loaded], None],
        events: WorkerEvents,
    ) -> None:
        self._what, self._fly_by, self._agree, self._events = what, fly_by, agree, events
        self.worker: Worker | None = None
        self.loaded: Loaded | None = None
        self.broken = ""
        """what is wrong with the file as it was saved last"""
        self._fresh: Worker | None = None
        """what is being loaded"""
        self._closed = False
        self._stamp = self._look()
        self._lock = asyncio.Lock()

    def close(self) -> None:
        """End all processes; there are no others from now on."""
        self._closed = True
        for worker in (self.worker, self._fresh):
            if worker is not None:
                worker.close()
        self.worker = self._fresh = None

    async def load(self, values: Mapping[str, float], *, where_gone: bool = False) -> float:
        """Load it, again where it is loaded already, and fly by it from the next cycle on; gives the ms that it took.

        ``values``: of its parameters. ``where_gone``: only where no process flies by then. Raises what is wrong with
        it; what flew before goes on then.
        """
        async with self._lock:
            begun = time.monotonic()
            if self._closed:
                raise Refused("the supervisor ends")
            old = self.worker
            if where_gone and old is not None and old.alive:
                return 0.0
            self._fresh = fresh = Worker(self._events)
            try:
                loaded = await fresh.load(self._what, dict(values))
                self._agree(loaded)
            except BaseException as e:
                fresh.close()
                if isinstance(e, Exception):
                    self.broken = str(e)
                raise
            finally:
                self._fresh = None
            self.broken, self.loaded, self.worker = "", loaded, fresh
            self._fly_by(fresh)
            took = (time.monotonic() - begun) * 1e3
            if old is not None:
                old.close()
            return took

    async def saved(self) -> None:
        """Wait until the file is saved; for ever where it is none."""
        while not loading.is_file(self._what) or self._look() == self._stamp:
            await asyncio.sleep(SAVED)
        self._stamp = self._look()

    def gone(self, worker: Worker) -> bool:
        """The process that flew is no more: nobody's outputs count."""
        if worker is not self.worker or worker.alive:
            return False
        self._fly_by(None)
        return True

    def _look(self) -> tuple[float, int] | None:
        """None while there is no such file: an editor may put a new one in the old one's place."""
        with contextlib.suppress(OSError):
            found = Path(self._what).stat()
            return found.st_mtime, found.st_size
        return None
