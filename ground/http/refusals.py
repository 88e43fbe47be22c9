"""What vehicles say about frames that they did not take: a put has no answer, so that a refusal comes as an event."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Sequence

from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadInput, Forbidden, Refused, ZmavError
from zmav.waiting import within

PATIENCE = 0.3
"""s for a refusal to come, as 'zmav send' waits"""
REMEMBERED = 256


class Refusals:
    """Hears the fleet's events of refused frames."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._task: asyncio.Task[None] | None = None
        self._heard: deque[tuple[float, str, str]] = deque(maxlen=REMEMBERED)
        self._news = asyncio.Event()
        self.count = 0

    async def start(self) -> None:
        ready = asyncio.Event()
        self._task = asyncio.create_task(self._listen(ready))
        await ready.wait()

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _listen(self, ready: asyncio.Event) -> None:
        async with self._client.subscribe(keys.EVENT.key(self._client.fleet_name, "*")) as events:
            ready.set()
            async for sample in events:
                with contextlib.suppress(BadInput):
                    event = wire.decode(sample.payload.to_bytes(), wire.Event, "event")
                    if event.kind == "refused":
                        self.count += 1
                        self._heard.append((time.monotonic(), str(sample.key_expr), event.text))
                        self._news.set()
                        self._news = asyncio.Event()

    async def check(self, sent: Sequence[str], since: float, patience: float = PATIENCE) -> None:
        """Wait a short while, and raise what a vehicle says of a frame on the keys ``sent`` since then (monotonic).

        Raises :class:`Refused` or :class:`Forbidden`. Silence is no promise: a vehicle says at most one refusal a
        second, and the autopilot's own answer is a message like any other.
        """
        deadline = time.monotonic() + patience
        while True:
            for at, key, text in self._heard:
                if at >= since and (error := _about(key, text, sent)) is not None:
                    raise error
            left = deadline - time.monotonic()
            if left <= 0:
                return
            with contextlib.suppress(asyncio.TimeoutError):
                await within(left, self._news.wait())


def _about(event_key: str, text: str, sent: Sequence[str]) -> ZmavError | None:
    """The error that an event is for anyone who put on these keys; None where it is about something else."""
    for key in sent:
        vehicle = key.partition("/mav/tx/")[0]
        if event_key != f"{vehicle}/event":
            continue
        if text.startswith("refused: "):  # no proof of origin, or not with that role: see zmav.onboard
            return Forbidden(f"{vehicle.rpartition('/')[2]}: {text}")
        if f"frame on {key} " in text:
            return Refused(f"{vehicle.rpartition('/')[2]}: {text}")
    return None
