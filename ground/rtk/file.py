"""Corrections from a file of RTCM 3, one moment a second: for the bench, where no receiver believes them for long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from zmav.formats.rtcm3 import Cutter, Message

PIECE = 16_384
"""bytes that are read at a time"""


class FileSource:
    """``take`` gets the messages on the event loop, ``told`` a state and words about it."""

    def __init__(
        self,
        path: Path,
        take: Callable[[list[Message]], object],
        told: Callable[[str, str], None],
        every: float = 1.0,
    ) -> None:
        self._path, self._take, self._told, self._every = path, take, told, every

    async def run(self) -> None:
        """Play it once."""
        moment: list[Message] = []
        seen: set[int] = set()
        count, cutter = 0, Cutter()
        with self._path.open("rb") as file:
            while data := await asyncio.to_thread(file.read, PIECE):
                for message in cutter.feed(data):
                    if message.observes and message.number in seen:
                        self._give(moment)
                        moment, seen = [], set()
                        await asyncio.sleep(self._every)
                    moment.append(message)
                    seen.add(message.number)
                    count += 1
        self._give(moment)
        self._told("ended", f"{count} messages were in {self._path}" if count else f"no RTCM 3 in {self._path}")

    def _give(self, moment: list[Message]) -> None:
        if moment:
            self._told("streaming", f"from {self._path}")
            self._take(moment)
