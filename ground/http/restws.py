"""mavlink2rest's WebSocket: every message whose name a regular expression is found in, as JSON, and sends."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import msgspec
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from ground.feed import Origin
from ground.http.arguments import object_of
from ground.http.gateway import WANTED_HZ, Gateway
from ground.http.guard import deny
from ground.http.reply import Failure, failure_of, refusal
from ground.http.restjson import document, frame_of
from ground.http.server import Write, text_frame, write_of
from zmav.errors import BadInput, BadMessage, ZmavError
from zmav.mavlink import parse_frame
from zmav.waiting import on_loop, together

MOST = 100
"""clients at once"""
QUEUE = 2000
"""messages that wait for a client; who leaves more unread is dropped"""
FEW = 8
"""messages that a filter may match to count as asking for them"""
ASK_EVERY = 10.0
AT_ONCE = 64
"""messages written to a client before it is looked whether it takes more"""
FRAMES = 10_000
"""that wait for a loop that is busy; then the oldest go"""
LONGEST, MOST_STARS, MOST_GROUPS = 500, 2, 2
"""characters of an expression; ``.*`` in each of its alternatives; groups in it"""
FORM = "names, '.', '.*', [A-Z], (A|B), ^, $ and |"
_ALTERNATIVE = r"\^?(?:\.\*|[\w.]|\[[\w-]+\]|\((?:\w+\|)*\w+\))*\$?"
_PATTERN = re.compile(rf"{_ALTERNATIVE}(?:\|{_ALTERNATIVE})*", re.ASCII)
_OUTSIDE_GROUPS = re.compile(r"\|(?![\w|]*\))")


class _Gone(Exception):
    """The client has left, or leaves too much unread."""


class Text(NamedTuple):
    """A message's JSON, alone and as a WebSocket's frame."""

    data: bytes
    frame: bytes


class RestClient:
    """One client: the messages it wants, and those that wait for it while it does not take them at once."""

    def __init__(self, names: frozenset[str], write: Write) -> None:
        self.names, self._write = names, write
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue(QUEUE)
        self._sending = False
        self.full = asyncio.Event()

    def take(self, texts: Sequence[Text]) -> None:
        """Messages for it, behind those that wait."""
        for at in range(0, len(texts), AT_ONCE):
            some = texts[at : at + AT_ONCE]
            if self._sending or not self._waiting.empty() or not self._write([text.frame for text in some]):
                for text in some:
                    self.put(text.data)

    def put(self, data: bytes) -> None:
        try:
            self._waiting.put_nowait(data)
        except asyncio.QueueFull:
            self.full.set()

    async def send(self, send: Send) -> None:
        """Send what waits, as it is taken."""
        while True:  # straight to the server: what WebSocket adds costs more than all the rest of it
            data = await self._waiting.get()
            self._sending = True
            await send({"type": "websocket.send", "text": data.decode()})
            self._sending = False


class RestSockets:
    """Messages as they come, those whose name fits ``?filter=``, as JSON; what is sent to it goes to the vehicles.

    A message is turned into JSON once for all clients, and not at all for none.
    """

    def __init__(self, gateway: Gateway, source: tuple[int, int]) -> None:
        self._gateway, self._source = gateway, source
        self._readers: set[RestClient] = set()
        self.dropped = 0
        """clients cut off because they did not read"""
        self._encoder = msgspec.json.Encoder()
        self._frames: collections.deque[tuple[Origin, bytes]] = collections.deque(maxlen=FRAMES)
        self._called = False
        self._remove: Callable[[], None] = lambda: None

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
        reader = RestClient(names, write_of(scope))
        self._add(reader)
        try:
            await together(reader.send(send), self._receive(socket, reader), self._ask(reader), self._end(reader))
        except (OSError, _Gone):
            return  # what it has not read is cut off with the connection: see ground.http.server
        finally:
            self._leave(reader)

    async def _end(self, reader: RestClient) -> None:
        await reader.full.wait()
        self.dropped += 1
        raise _Gone

    async def _receive(self, socket: WebSocket, reader: RestClient) -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                raise _Gone
            text = message.get("text")
            if text is not None:
                reader.put(self._sent(text).encode())

    def _sent(self, text: str) -> str:
        """Send what a client gave us; what to tell it, in mavlink2rest's words."""
        gateway = self._gateway
        if gateway.read_only:
            return "Could not send: this gateway only reads."
        try:
            frame = frame_of(
                object_of(text.encode("utf-8", "replace")), gateway.dialect, self._source, gateway.next_seq
            )
        except BadInput as e:
            return f"Could not convert input message. {e}".encode("utf-8", "replace").decode()
        try:
            gateway.send(frame)
        except ZmavError as e:
            return f"Err({e})"
        return f"Ok({len(frame)})"

    async def _ask(self, reader: RestClient) -> None:
        """Have the autopilots send the few messages that a filter names."""
        while len(reader.names) <= FEW:
            for name in reader.names:
                self._gateway.wants.want("*", name, WANTED_HZ)
            await asyncio.sleep(ASK_EVERY)
        await asyncio.Event().wait()

    def _add(self, reader: RestClient) -> None:
        if not self._readers:
            self._wake = on_loop(asyncio.get_running_loop(), self._deliver)
            self._remove = self._gateway.add_listener(self._on_frame)
        self._readers.add(reader)

    def _leave(self, reader: RestClient) -> None:
        self._readers.discard(reader)
        if not self._readers:
            self._remove()
            self._frames.clear()

    def _on_frame(self, origin: Origin, frame: bytes) -> None:
        """On a thread of Zenoh's: one wake-up of the loop for all that comes meanwhile."""
        self._frames.append((origin, frame))
        if not self._called:
            self._called = True
            self._wake()

    def _deliver(self) -> None:
        self._called = False  # first: a frame that comes from now on wakes us again
        bursts: dict[RestClient, list[Text]] = {}
        for _ in range(len(self._frames)):
            origin, frame = self._frames.popleft()
            readers = [reader for reader in self._readers if origin.message in reader.names]
            if not readers:
                continue
            with contextlib.suppress(BadMessage):
                dialect = self._gateway.dialect
                data = self._encoder.encode(document(parse_frame(frame, dialect), dialect))
                text = Text(data, text_frame(data))
                for reader in readers:
                    bursts.setdefault(reader, []).append(text)
        for reader, texts in bursts.items():
            reader.take(texts)


def matching(pattern: str, names: Iterable[str]) -> frozenset[str]:
    """The names in which ``pattern`` is found, at a bounded cost: Python's expressions can take time exponential in the
    text; names, ``.``, ``.*``, sets of characters and alternatives cannot. Raises :class:`BadInput` for any other.
    """
    stars = max(part.count(".*") for part in _OUTSIDE_GROUPS.split(pattern[:LONGEST]))
    if len(pattern) > LONGEST or stars > MOST_STARS or pattern.count("(") > MOST_GROUPS:
        most = f"{LONGEST} characters, {MOST_STARS} times '.*' in each alternative and {MOST_GROUPS} groups"
        raise BadInput(f"the filter has more than {most}", field="filter", value=pattern[:80], expected=most)
    try:
        if not _PATTERN.fullmatch(pattern):
            raise ValueError(pattern)
        compiled = re.compile(pattern)
    except (ValueError, re.error):
        text = f"the filter {pattern[:80]!r} is not understood: it may be made of {FORM}"
        raise BadInput(text, field="filter", value=pattern[:80], expected=FORM) from None
    return frozenset(name for name in names if compiled.search(name))
