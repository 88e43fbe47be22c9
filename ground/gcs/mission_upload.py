"""One upload from a client: its items are asked for one by one, as an autopilot would, and given to the vehicle whole.

https://mavlink.io/en/services/mission.html#uploading_mission. The vehicle's agent then has the autopilot take them,
which lasts. No message of the protocol says "wait", but a request for an item that was sent before does: stations send
it once more, and begin to wait again. QGroundControl gives up 1.5 s after the last request, MAVSDK after the fifth
repetition of one request or 0.5 s of silence each; the last two items in turn satisfy both.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Protocol

from zmav.services.missions.items import Raw
from zmav.waiting import within

ASK_AGAIN = 1.0
"""s without the item after which it is asked for once more"""
TRIES = 8
WAITING = 0.4
"""s between two requests that keep a client waiting"""
WAITING_FOR_ONE = 1.0
"""the same where there is one item only, and each request counts as a repetition"""


class Talk(Protocol):
    """How an upload speaks to its client."""

    def __call__(self, name: str, **fields: int) -> None: ...


class Silent(Exception):
    """The client no longer sends what it is asked for."""


class Upload:
    """The ``count`` items of a plan. Lives on the event loop."""

    def __init__(self, say: Talk, count: int, as_float: bool) -> None:
        self._say, self.count = say, count
        self._as_float = as_float
        """the client is of old: it knows neither MISSION_REQUEST_INT nor MISSION_ITEM_INT"""
        self.items: list[Raw] = []
        self.task: asyncio.Task[None] | None = None
        self._came = asyncio.Event()

    @property
    def complete(self) -> bool:
        return len(self.items) >= self.count

    def take(self, seq: int, item: Raw, as_float: bool) -> None:
        """An item came; one that came before is let pass."""
        if seq == len(self.items) and not self.complete:
            self._as_float = as_float
            self.items.append(item)
            self._came.set()

    def ask(self) -> None:
        """For the next item."""
        self._request(len(self.items))

    async def collect(self) -> list[Raw]:
        """All items; raises :class:`Silent`."""
        while not self.complete:
            await self._one()
        return self.items

    async def _one(self) -> None:
        for attempt in range(TRIES):
            if attempt > 1 and not self.items:
                self._as_float = not self._as_float  # it may know the other request only
            self._came.clear()
            self.ask()
            try:
                await within(ASK_AGAIN, self._came.wait())
                return
            except asyncio.TimeoutError:
                continue
        raise Silent

    async def keep_waiting(self, work: Awaitable[object]) -> None:
        """See ``work`` through, and keep the client patient meanwhile. Raises what it raises."""
        task = asyncio.ensure_future(work)
        pause = WAITING if self.count > 1 else WAITING_FOR_ONE
        back = True
        try:
            while not (await asyncio.wait({task}, timeout=pause))[0]:
                self._request(self.count - 1 - int(back and self.count > 1))
                back = not back
            task.result()
        finally:
            task.cancel()

    def _request(self, seq: int) -> None:
        self._say("MISSION_REQUEST" if self._as_float else "MISSION_REQUEST_INT", seq=seq)
