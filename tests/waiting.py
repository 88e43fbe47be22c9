"""Waiting for what no event tells of."""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

PATIENCE_S = 30.0  # how long an event may take on a busy machine before the test fails


async def until(
    true: Callable[[], object], what: object = "it did not come true", seconds: float = PATIENCE_S, every: float = 0.02
) -> None:
    """Look until it holds; fails with ``what``, or with what that returns then."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what() if callable(what) else what}"
        await asyncio.sleep(every)


def wait_until(
    true: Callable[[], object], what: object = "it did not come true", seconds: float = PATIENCE_S, every: float = 0.01
) -> None:
    """As :func:`until`, for what another thread or process does."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what() if callable(what) else what}"
        time.sleep(every)


class Watcher(ABC):
    """Looks on, as :meth:`_look` does, as long as the ``async with`` lasts."""

    async def __aenter__(self) -> Self:
        self._task = asyncio.create_task(self._look())
        return self

    async def __aexit__(self, *exc: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    @abstractmethod
    async def _look(self) -> None:
        """For ever."""
