"""mavlink2rest's WebSocket: every message whose name a regular expression is found in, as JSON, and sends."""

from __future__ import annotations

import asyncio
import collections
import contextlib

import msgspec
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from ground.http.arguments import object_of
from ground.http.batches import Batch, Batches
from ground.http.filters import matching
from ground.http.gateway import WANTED_HZ, Gateway
from ground.http.guard import deny
from ground.http.reply import Failure, failure_of, refusal
from ground.http.restjson import document, frame_of
from zmav.errors import BadInput, BadMessage, ZmavError
from zmav.mavlink import parse_frame
from zmav.waiting import together

MOST = 100
"""clients at once"""
QUEUE = 2000
"""messages that wait for a client; who leaves more unread is dropped"""
FEW = 8
"""messages that a filter may match to count as asking for them"""
ASK_EVERY = 10.0


class _Gone(Exception):
    """The client has left, or leaves too much unread."""


class Reader:
    """One client: the messages it wants, and those that wait for it."""

    def __init__(self, names: frozenset[str]) -> None:
        self.names = names
        self.full = asyncio.Event()
        self._waiting: collections.deque[str] = collections.deque()
        self._news = asyncio.Event()

    def put(self, text: str) -> None:
        if len(self._waiting) >= QUEUE:
            self.full.set()
            return
        self._waiting.append(text)
        self._news.set()

    async def get(self) -> str:
        while not self._waiting:
            self._news.clear()
            await self._news.wait()
        return self._waiting.popleft()


class RestSockets:
    """Messages as they come, those whose name fits ``?filter=``, as JSON; what is sent to it goes to the vehicles.

    A message is turned into JSON once for all clients, and not at all for none.
    """

    def __init__(self, gateway: Gateway, source: tuple[int, int]) -> None:
        self._gateway, self._source = gateway, source
        self._readers: set[Reader] = set()
        self.dropped = 0
        """clients cut off because they did not read"""
        self._batches: Batches | None = None
        self._encoder = msgspec.json.Encoder()

    def __len__(self) -> int:
        return len(self._readers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One client, as long as it stays and reads; a bad filter is refused with 400 before."""
        socket = WebSocket(scope, receive, send)
        try:
            if len(self._readers) >= MOST:
                raise Failure(503, "too_many", f"there are {MOST} clients already")
            names = matching(socket.query_params.get("filter", ".*"), self._gateway.dialect.by_name)
        except (BadInput, Failure) as e:
            failure = failure_of(e) if isinstance(e, BadInput) else e
            await deny(refusal(scope["path"], failure), scope, receive, send)
            return
        await socket.accept()
        reader = Reader(names)
        self._add(reader)
        try:
            await together(
                self._send(send, reader), self._receive(socket, reader), self._ask(reader), self._end(reader)
            )
        except (OSError, _Gone):
            return  # what it has not read is cut off with the connection: see ground.http.server
        finally:
            self._remove(reader)

    async def _end(self, reader: Reader) -> None:
        await reader.full.wait()
        self.dropped += 1
        raise _Gone

    async def _send(self, send: Send, reader: Reader) -> None:
        while True:  # straight to the server: what WebSocket adds costs more than all the rest of it
            await send({"type": "websocket.send", "text": await reader.get()})

    async def _receive(self, socket: WebSocket, reader: Reader) -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                raise _Gone
            text = message.get("text")
            if text is not None:
                reader.put(self._sent(text))

    def _sent(self, text: str) -> str:
        """Send what a client gave us; what to tell it, in mavlink2rest's words."""
        gateway = self._gateway
        if gateway.read_only:
            return "Could not send: this gateway only reads."
        try:
            frame = frame_of(object_of(text.encode("utf-8", "replace")), gateway.dialect, self._source, gateway)
        except BadInput as e:
            return f"Could not convert input message. {e}".encode("utf-8", "replace").decode()
        try:
            gateway.send(frame)
        except ZmavError as e:
            return f"Err({e})"
        return f"Ok({len(frame)})"

    async def _ask(self, reader: Reader) -> None:
        """Have the autopilots send the few messages that a filter names."""
        while len(reader.names) <= FEW:
            for name in reader.names:
                self._gateway.wants.want("*", name, WANTED_HZ)
            await asyncio.sleep(ASK_EVERY)
        await asyncio.Event().wait()

    def _add(self, reader: Reader) -> None:
        self._readers.add(reader)
        if self._batches is None:
            self._batches = Batches(self._gateway, self._on_batch)

    def _remove(self, reader: Reader) -> None:
        self._readers.discard(reader)
        if not self._readers and self._batches is not None:
            self._batches.close()
            self._batches = None

    def _on_batch(self, batch: Batch) -> None:
        for origin, frame in batch:
            readers = [reader for reader in self._readers if origin.message in reader.names]
            if not readers:
                continue
            with contextlib.suppress(BadMessage):
                dialect = self._gateway.dialect
                text = self._encoder.encode(document(parse_frame(frame, dialect), dialect)).decode()
                for reader in readers:
                    reader.put(text)
