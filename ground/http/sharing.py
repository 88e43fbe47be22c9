"""A camera that is read once for all who look at it here, pictures and video alike."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from zmav.client import Client
from zmav.vision.reader import Reader

R = TypeVar("R", bound=Reader)
S = TypeVar("S", bound="Shared")  # type: ignore[type-arg]  # of any reader
logger = logging.getLogger(__name__)


class Shared(Generic[R]):
    """One camera's reader, open until it is closed or fails. Lives on the event loop."""

    kind: type[R]

    def __init__(self, client: Client, vehicle: str, camera: str) -> None:
        self.reader = self.kind(client, vehicle, camera, name="http")
        self.looking = 0
        self.ended = False
        """nothing more will come"""
        self._task = asyncio.create_task(self._read())

    async def _read(self) -> None:
        try:
            async with self.reader:
                await self._take()
        except Exception:
            logger.exception("error while reading a camera")
        finally:
            self._end()

    async def _take(self) -> None:
        """What is to be done while it is open; for ever."""
        await asyncio.Event().wait()

    def _end(self) -> None:
        self.ended = True

    def close(self) -> None:
        self._task.cancel()
        self._end()  # a task that was not begun has no end of its own


class Pool(Generic[S]):
    """Every camera that somebody looks at."""

    def __init__(self, make: Callable[[str, str], S]) -> None:
        self._make = make
        self.being_read: dict[tuple[str, str], S] = {}

    @contextlib.contextmanager
    def shared(self, vehicle: str, camera: str) -> Iterator[S]:
        """The camera, which is read for as long as somebody looks."""
        place = vehicle, camera
        if place not in self.being_read or self.being_read[place].ended:
            self.being_read[place] = self._make(vehicle, camera)
        shared = self.being_read[place]
        shared.looking += 1
        try:
            yield shared
        finally:
            shared.looking -= 1
            if not shared.looking:
                if self.being_read.get(place) is shared:
                    del self.being_read[place]
                shared.close()
