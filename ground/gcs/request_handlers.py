"""One client as those who answer in the vehicles' place serve it: what it asked, in turn; what it is owed, at its pace.

Whatever a client asks for, and however often, what waits for it here is bounded; what is too much is left out, and a
client that still wants it asks again, as MAVLink has it.
"""

from __future__ import annotations

import asyncio
import collections
import logging
import time
from collections.abc import Callable, Hashable, Iterable
from typing import NamedTuple

from ground.gcs.answerer import Ground
from ground.gcs.client import Client
from zmav import wire
from zmav.errors import ZmavError
from zmav.mavlink import Frame
from zmav.waiting import on_loop

logger = logging.getLogger(__name__)
MOST_ASKED = 4096
"""frames of one client that wait to be looked at"""
MOST_ANSWERS = 1024
"""single answers that wait for it to take them"""
BURST, PAUSE = 16, 0.01
"""frames that are sent at once, and the seconds until the next: 1,600 a second. A socket's buffer holds about 270
datagrams, and a station that works through PARAM_VALUEs in Python takes a quarter of a millisecond for each."""
AGAIN = 0.02
"""s until a client that took no more is tried again"""
STUCK = 30.0
"""s without its taking anything after which it is owed nothing any more: it may ask again"""

Handler = Callable[["RequestHandlers", Frame], None]


class Owed(NamedTuple):
    """A list that is being sent: what is left of it, by name, and how a frame of it is made (None: not any more)."""

    names: dict[str, None]
    frame: Callable[[str], bytes | None]


class RequestHandlers:
    """:meth:`ask` may be called from any thread, the rest on the event loop."""

    def __init__(self, client: Client, ground: Ground) -> None:
        self.client, self._ground = client, ground
        self._asked: collections.deque[tuple[Handler, Frame]] = collections.deque()
        self._answers: collections.deque[bytes] = collections.deque()
        self._lists: dict[Hashable, Owed] = {}
        self._sending: asyncio.Task[None] | None = None
        self._next_asked = on_loop(ground.loop, self._handle)

    # What it asks.

    def ask(self, handler: Handler, frame: Frame) -> None:
        """Have ``handler`` look at a frame of the client's, on the event loop and in turn. Any thread."""
        if len(self._asked) >= MOST_ASKED:
            return
        self._asked.append((handler, frame))
        self._next_asked()

    def _handle(self) -> None:
        handler, frame = self._asked.popleft()
        if self.client.gone:
            return
        try:
            handler(self, frame)
        except ZmavError as e:  # it came from the network: the next one may be in order
            logger.debug("%s: a frame of message %d is not answered: %s", self.client.name, frame.msgid, e)

    # What it gets.

    def answer(self, *frames: bytes) -> bool:
        """Frames that go before every list; False: there is no room for them."""
        if len(self._answers) + len(frames) > MOST_ANSWERS:
            return False
        self._answers.extend(frames)
        self._send()
        return True

    def owe(self, key: Hashable, names: Iterable[str], frame: Callable[[str], bytes | None]) -> None:
        """A list, in turns with others, made frame by frame as it goes; another of the same key takes its place."""
        self._lists[key] = Owed(dict.fromkeys(names), frame)
        self._send()

    def owes(self, key: Hashable, name: str = "") -> bool:
        """That list is not through, or not that far."""
        owed = self._lists.get(key)
        return owed is not None and (not name or name in owed.names)

    def tell(self, sysid: int, severity: wire.Severity, text: str) -> None:
        """Words about a vehicle."""
        self.answer(*self._ground.words(sysid, severity, text))

    def close(self) -> None:
        if self._sending is not None:
            self._sending.cancel()

    def _send(self) -> None:
        if self._sending is None:
            self._sending = self._ground.loop.create_task(self._send_all())

    async def _send_all(self) -> None:
        try:
            in_burst = 0
            while not self.client.gone and (frame := self._next()) is not None:
                if not await self._push(frame):
                    self._answers.clear()
                    self._lists.clear()
                    return
                in_burst += 1
                if in_burst >= BURST:
                    in_burst = 0
                    await asyncio.sleep(PAUSE)
        finally:
            self._sending = None

    async def _push(self, frame: bytes) -> bool:
        """False: it has taken nothing for a long time."""
        since = time.monotonic()
        while not self.client.send(frame):
            if self.client.gone or time.monotonic() - since > STUCK:
                return False
            await asyncio.sleep(AGAIN)
        return True

    def _next(self) -> bytes | None:
        """The next frame to send: an answer, or one of each list in turn."""
        if self._answers:
            return self._answers.popleft()
        while self._lists:
            key, owed = next(iter(self._lists.items()))
            del self._lists[key]
            name = next(iter(owed.names), None)
            if name is None:
                continue
            del owed.names[name]
            if owed.names:
                self._lists[key] = owed  # behind the others
            frame = owed.frame(name)
            if frame is not None:
                return frame
        return None


class HandlersByClient:
    """The handlers of all clients. Thread-safe but for :meth:`close`."""

    def __init__(self, ground: Ground) -> None:
        self._ground = ground
        self._by_client: dict[Client, RequestHandlers] = {}
        self.forget: list[Callable[[RequestHandlers], None]] = []
        """called on the event loop with the handlers of a client that has left"""

    def of(self, client: Client) -> RequestHandlers:
        handlers = self._by_client.get(client)
        if handlers is None:
            handlers = RequestHandlers(client, self._ground)
            if not client.gone:  # or it would be kept for ever
                handlers = self._by_client.setdefault(client, handlers)
        return handlers

    def left(self, client: Client) -> None:
        handlers = self._by_client.pop(client, None)
        if handlers is not None:
            on_loop(self._ground.loop, self._close)(handlers)

    def _close(self, handlers: RequestHandlers) -> None:
        for forget in self.forget:
            forget(handlers)
        handlers.close()

    def close(self) -> None:
        for handlers in self._by_client.values():
            handlers.close()
        self._by_client.clear()
