"""What lives on an event loop in a thread of its own, for tests that wait for other people's programs meanwhile."""

from __future__ import annotations

import asyncio
import threading
from abc import ABC, abstractmethod
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any, TypeVar

from zmav.waiting import within

T = TypeVar("T")
Own = TypeVar("Own", bound="OwnThread")


class OwnThread(ABC):
    """``with`` it: :meth:`live` begins, and ends when it is left. ``patience``: s for each thing asked of it."""

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.stop = asyncio.Event()

    @abstractmethod
    async def live(self, ready: Future[None]) -> None:
        """Set ``ready``, and return once :attr:`stop` is set."""

    def __enter__(self: Own) -> Own:
        self._thread.start()
        ready: Future[None] = Future()
        self._life = asyncio.run_coroutine_threadsafe(self.live(ready), self.loop)

        def ended(life: Future[None]) -> None:
            if not ready.done():
                ready.set_exception(life.exception() or RuntimeError("it ended"))

        self._life.add_done_callback(ended)
        ready.result(2 * self._patience)
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.call_soon_threadsafe(self.stop.set)
        self._life.result(self._patience)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(self._patience)
        self.loop.close()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """On its loop."""
        return asyncio.run_coroutine_threadsafe(within(self._patience, coroutine), self.loop).result()
