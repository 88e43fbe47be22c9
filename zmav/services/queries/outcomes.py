"""Orders' outcomes on their way to who asked.

Zenoh has who answers wait for an asker that does not read: 0.2 s, or 5 s where a radio has a budget, and closes the
link then. So outcomes leave neither from the event loop nor behind another member's: each member that asks has a thread
while something is to be told it.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import threading
import time

import zenoh

from zmav import wire
from zmav.errors import ZmavError
from zmav.services.queries.proven import Answers

logger = logging.getLogger(__name__)
MOST = 64
"""outcomes that wait for one asker; the oldest gives way, and is asked for again by its id"""
ENDING = 1.0
"""s in which what waits is told when the program ends"""


class Outcomes:
    """Thread-safe."""

    def __init__(self, answers: Answers) -> None:
        self._answering = answers
        self._waiting: dict[str, collections.deque[tuple[zenoh.Query, str, wire.Outcome | ZmavError]]] = {}
        """by asker; of each that is here a thread is at work"""
        self._news = threading.Condition()

    def tell(self, asker: str, query: zenoh.Query, key: str, outcome: wire.Outcome | ZmavError) -> None:
        """Answer ``query`` on ``key``. ``asker``: the member that asked, as far as that is known."""
        with self._news:
            waiting = self._waiting.get(asker)
            if waiting is None:
                waiting = self._waiting[asker] = collections.deque()
                threading.Thread(target=self._run, args=(asker,), name=f"outcomes {asker}", daemon=True).start()
            waiting.append((query, key, outcome))
            oldest = waiting.popleft() if len(waiting) > MOST else None
        if oldest is not None:
            oldest[0].drop()

    def close(self) -> None:
        """Wait until all is told, for a while."""
        until = time.monotonic() + ENDING
        with self._news:
            self._news.wait_for(lambda: not self._waiting, until - time.monotonic())

    def _run(self, asker: str) -> None:
        while True:
            with self._news:
                if not self._waiting[asker]:
                    del self._waiting[asker]
                    self._news.notify_all()
                    return
                query, key, outcome = self._waiting[asker].popleft()
            try:
                with contextlib.suppress(zenoh.ZError), query:  # who asked may be gone
                    if isinstance(outcome, ZmavError):
                        self._answering.refuse(query, outcome)
                    else:
                        self._answering.give(query, key, wire.encode(outcome))
            except Exception:
                logger.exception("not told")  # what comes next is
