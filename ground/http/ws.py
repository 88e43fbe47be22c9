"""``WS /ws``: key expressions over a WebSocket, each with a rate cap.

    > {"subscribe": "quad*/ATTITUDE", "hz": 5}    < {"subscribed": "zmav/demo/quad$*/mav/rx/*/*/ATTITUDE", "hz": 5}
    > {"unsubscribe": "quad*/ATTITUDE"}           < {"key": "zmav/demo/quad1/...", "t": 1790000000.1, "value": {...}}

A message named exactly and with ``hz`` is asked of the autopilot at that rate for as long as it is read. Of each key
the newest sample wins; events are never left out. A client that does not read for :data:`STALL` seconds is cut off.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import heapq
import logging
import time
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any, Generic, TypeVar

import msgspec
import zenoh
from starlette.routing import BaseRoute, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ground.http.arguments import number_of
from ground.http.changes import Changes, rounded
from ground.http.documents import document_of_sample, names_a_message, to_json
from ground.http.gateway import Gateway
from ground.http.reply import body_of, failure_of
from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput, ZmavError
from zmav.mavlink import Dialect
from zmav.vehicle.rates import MAX_HZ, want_key
from zmav.waiting import within

T = TypeVar("T")
Slot = tuple[int, str]
"""a subscription's number and a key"""
MOST_KEYS = 4096
"""keys told apart by one socket: invented ones must not fill the memory"""
MOST_QUEUED = 1000
"""samples that wait in order where none may be left out"""


class Outbox(Generic[T]):
    """Of each key only the newest sample waits, and goes when its subscription's next turn is. Lives on the event loop.

    What must all arrive (events) waits in a queue of its own, whose bound a reader that is too slow will feel.
    """

    def __init__(self, most_keys: int = MOST_KEYS) -> None:
        self._most_keys = most_keys
        self._newest: dict[Slot, T] = {}
        self._next: dict[Slot, float] = {}
        """when a key may be sent again (monotonic seconds)"""
        self._late: list[tuple[float, Slot]] = []
        """keys that wait for their turn: a heap"""
        self._ready: collections.deque[Slot] = collections.deque()
        self._queue: collections.deque[tuple[int, T]] = collections.deque()
        self._arrived = asyncio.Event()
        self.dropped = 0
        """samples lost because there was no room: those left out by a rate cap are none of them"""

    def put(self, number: int, key: str, sample: T) -> None:
        """Take a sample of the subscription ``number``; the one before it, if still here, is out of date."""
        slot = (number, key)
        if slot not in self._next:
            if len(self._next) >= self._most_keys and not self._make_room():
                self.dropped += 1
                return
            self._next[slot] = 0.0
        if slot not in self._newest:
            if (due := self._next[slot]) <= time.monotonic():
                self._ready.append(slot)
            else:
                heapq.heappush(self._late, (due, slot))
        self._newest[slot] = sample
        self._arrived.set()

    def _make_room(self) -> bool:
        """Forget keys of which nothing waits and that may be sent again at any time."""
        now = time.monotonic()
        self._next = {slot: due for slot, due in self._next.items() if slot in self._newest or due > now}
        return len(self._next) < self._most_keys

    def queue(self, number: int, sample: T) -> None:
        """Take a sample that goes in order and is not replaced."""
        if len(self._queue) >= MOST_QUEUED:
            self.dropped += 1
            return
        self._queue.append((number, sample))
        self._arrived.set()

    def forget(self, number: int) -> None:
        """Leave out what waits for a subscription that has ended."""
        for held in (self._newest, self._next):
            for slot in [slot for slot in held if slot[0] == number]:
                del held[slot]
        self._ready = collections.deque(slot for slot in self._ready if slot[0] != number)
        self._late = [late for late in self._late if late[1][0] != number]
        heapq.heapify(self._late)
        self._queue = collections.deque(item for item in self._queue if item[0] != number)

    async def get(self, period: dict[int, float]) -> T:
        """The next sample that may go; ``period`` are the seconds between two of a key, by subscription."""
        while True:
            self._arrived.clear()
            if self._queue:
                return self._queue.popleft()[1]
            now = time.monotonic()
            while self._late and self._late[0][0] <= now:
                self._ready.append(heapq.heappop(self._late)[1])
            if self._ready:
                slot = self._ready.popleft()
                self._next[slot] = now + period.get(slot[0], 0.0)
                return self._newest.pop(slot)
            await self._wait(self._late[0][0] - now if self._late else None)

    async def _wait(self, seconds: float | None) -> None:
        if seconds is None:
            await self._arrived.wait()
            return
        try:
            await within(seconds, self._arrived.wait())
        except asyncio.TimeoutError:
            return


class Came:
    """A sample and when it came (UTC seconds); its text is made when the first socket sends it."""

    __slots__ = ("_rounded", "_text", "key", "sample", "t")

    def __init__(self, sample: zenoh.Sample, t: float) -> None:
        self.key, self.sample, self.t = str(sample.key_expr), sample, t
        self._text: str | None = None
        self._rounded: dict[str, Any] | None = None

    def text(self, dialect: Dialect) -> str:
        if self._text is None:
            self._text = to_json(document_of_sample(self.sample, self.t, dialect)).decode()
        return self._text

    def rounded(self, dialect: Dialect) -> dict[str, Any]:
        """As a document; it is not to be changed."""
        if self._rounded is None:
            self._rounded = rounded(document_of_sample(self.sample, self.t, dialect))
        return self._rounded


Sink = Callable[[Came], None]


class Source:
    """One subscription and who reads it."""

    def __init__(self, key: str, stack: contextlib.AsyncExitStack, samples: AsyncIterator[zenoh.Sample]) -> None:
        self.key = key
        self.sinks: dict[object, Sink] = {}
        self._stack = stack
        self._task = asyncio.create_task(self._pump(samples))

    async def _pump(self, samples: AsyncIterator[zenoh.Sample]) -> None:
        async for sample in samples:
            came = Came(sample, time.time())
            for sink in list(self.sinks.values()):
                sink(came)

    async def end(self) -> None:
        self._task.cancel()
        try:
            await asyncio.gather(self._task, return_exceptions=True)
        finally:  # also where who unsubscribes goes away meanwhile
            await self._stack.aclose()


class Sources:
    """On the event loop."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._shared: dict[str, Source] = {}

    async def join(self, key: str, reader: object, sink: Sink, history: int = 0) -> Source:
        """Have ``sink`` called with every sample of ``key``; raises :class:`~zmav.errors.BadKey`.

        Who wants to hear what was (``history``: past events of each vehicle) has a subscription of his own.
        """
        source = None if history else self._shared.get(key)
        if source is None:
            stack = contextlib.AsyncExitStack()
            samples = await stack.enter_async_context(self._client.subscribe(key, history=history))
            source = Source(key, stack, aiter(samples))
            if not history:
                self._shared[key] = source
        source.sinks[reader] = sink
        return source

    async def leave(self, source: Source, reader: object) -> None:
        """No more of it for that reader; the last one ends the subscription."""
        source.sinks.pop(reader, None)
        if source.sinks:
            return
        if self._shared.get(source.key) is source:
            del self._shared[source.key]
        await source.end()


MOST_SUBSCRIPTIONS = 64
"""of one socket"""
MOST_SOCKETS = 200
STALL = 5.0
"""s a client may take to read what waits for it"""
IN_A_ROW = 16
"""messages sent to one client before others have their turn"""
TRY_AGAIN_LATER = 1013
"""RFC 6455's registry of close codes"""
EXPECTED = '{"subscribe": "quad1/ATTITUDE", "hz": 5} or {"unsubscribe": ...}'
logger = logging.getLogger(__name__)


class Ask(msgspec.Struct, forbid_unknown_fields=True):
    """What a client sends: one of the first four; ``ping`` comes back as ``pong``."""

    subscribe: str | None = None
    unsubscribe: str | None = None
    whole: str | None = None
    """a key of which all is to come again, where only changes were asked for"""
    ping: float | None = None
    hz: Annotated[float, msgspec.Meta(gt=0.0, le=MAX_HZ)] | None = None
    history: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 0
    """how many of each vehicle's past events come first"""
    changes: bool = False
    """of each key only what changed since its last message: see :mod:`ground.http.changes`"""


class Reader:
    """One subscription of one socket."""

    def __init__(self, number: int, owner: object, source: Source, token: zenoh.LivelinessToken | None) -> None:
        self.number = number
        self._owner, self._source, self._token = owner, source, token

    async def end(self, sources: Sources) -> None:
        if self._token is not None:
            self._token.undeclare()
        await sources.leave(self._source, self._owner)


class Socket:
    """One WebSocket and what it subscribed to. Lives on the event loop."""

    def __init__(self, gateway: Gateway, sources: Sources, ws: WebSocket) -> None:
        self._gateway, self._sources, self._ws = gateway, sources, ws
        self._outbox: Outbox[tuple[int, Came] | dict[str, Any]] = Outbox()
        self._readers: dict[str, Reader] = {}
        self._periods: dict[int, float] = {}
        self._changes: dict[int, Changes] = {}
        """by the subscription's number, of those that want no more"""
        self._numbers = 0
        self._since: float | None = None
        """since when a message is being sent (monotonic seconds); None: nothing is"""

    @property
    def subscriptions(self) -> int:
        return len(self._readers)

    @property
    def dropped(self) -> int:
        return self._outbox.dropped

    async def run(self) -> bool:
        """Serve it until either side ends it; True where it was cut off because it did not read."""
        jobs = [asyncio.create_task(job) for job in (self._read(), self._write(), self._watch())]
        try:
            done, _ = await asyncio.wait(jobs, return_when=asyncio.FIRST_COMPLETED)
            return jobs[2] in done
        finally:
            for job in jobs:
                job.cancel()
            for ended in await asyncio.gather(*jobs, return_exceptions=True):
                if isinstance(ended, Exception) and not isinstance(ended, (WebSocketDisconnect, OSError)):
                    logger.error("a WebSocket ended by a fault of ours", exc_info=ended)
            for reader in list(self._readers.values()):
                await reader.end(self._sources)

    async def _read(self) -> None:
        await self._first()
        while True:
            message = await self._ws.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("text") or message.get("bytes") or b""
            try:
                await self._obey(_ask_of(data))
            except ZmavError as e:
                self._say(body_of(failure_of(e)))

    async def _first(self) -> None:
        """What the address itself asks for: ``/ws?key=quad1&key=quad2&hz=5``."""
        given = self._ws.query_params
        for key in given.getlist("key"):
            try:
                await self._obey(Ask(subscribe=key, hz=number_of(given, "hz", None, MAX_HZ, "Hz")))
            except ZmavError as e:
                self._say(body_of(failure_of(e)))

    async def _obey(self, ask: Ask) -> None:
        client = self._gateway.client
        if ask.ping is not None:
            self._say({"pong": ask.ping})
        elif ask.whole is not None:
            for changes in self._changes.values():
                changes.forget(ask.whole)
        elif ask.unsubscribe is not None:
            key = keys.expression(ask.unsubscribe, client.fleet_name)
            if key not in self._readers:
                there = ", ".join(self._readers) or "nothing"
                raise BadInput(f"{key} was not subscribed to", field="unsubscribe", value=key, expected=there)
            await self._drop(key)
            self._say({"unsubscribed": key})
        elif ask.subscribe is not None:
            key = keys.expression(ask.subscribe, client.fleet_name)
            await self._drop(key)
            if len(self._readers) >= MOST_SUBSCRIPTIONS:
                text = f"no more than {MOST_SUBSCRIPTIONS} subscriptions a socket: unsubscribe, or use a wildcard"
                raise BadInput(text, field="subscribe", value=key, expected=f"at most {MOST_SUBSCRIPTIONS}")
            await self._take(key, ask.hz, ask.history, ask.changes)
            self._say({"subscribed": key, "hz": ask.hz})

    async def _take(self, key: str, hz: float | None, history: int, changes: bool) -> None:
        wanted = want_key(key, hz, "http") if hz is not None and names_a_message(key) else ""
        self._numbers += 1
        number, owner = self._numbers, object()
        if changes:
            self._changes[number] = Changes()
        source = await self._sources.join(key, owner, lambda came: self._arrived(number, came), history)
        token = self._gateway.client.session.liveliness().declare_token(wanted) if wanted else None
        self._readers[key] = Reader(number, owner, source, token)
        self._periods[number] = 1.0 / hz if hz else 0.0

    def _arrived(self, number: int, came: Came) -> None:
        if _is_event(came.key):
            self._outbox.queue(number, (number, came))
        else:
            self._outbox.put(number, came.key, (number, came))

    async def _drop(self, key: str) -> None:
        reader = self._readers.pop(key, None)
        if reader is not None:
            await reader.end(self._sources)
            del self._periods[reader.number]
            self._changes.pop(reader.number, None)
            self._outbox.forget(reader.number)

    def _say(self, words: dict[str, Any]) -> None:
        self._outbox.queue(0, words)

    async def _write(self) -> None:
        sent = 0
        while True:
            item = await self._outbox.get(self._periods)
            self._since = time.monotonic()
            await self._ws.send_text(self._text_of(item))
            self._since = None
            sent += 1
            if sent % IN_A_ROW == 0:
                await asyncio.sleep(0)  # sending need not wait, and others have work to do

    def _text_of(self, item: tuple[int, Came] | dict[str, Any]) -> str:
        if isinstance(item, dict):
            return to_json(item).decode()
        number, came = item
        if (changes := self._changes.get(number)) is None:
            return came.text(self._gateway.dialect)
        return to_json(changes.message(came.rounded(self._gateway.dialect))).decode()

    async def _watch(self) -> None:
        """Return when the client has not taken a message for :data:`STALL` seconds."""
        while self._since is None or time.monotonic() - self._since < STALL:
            await asyncio.sleep(STALL / 5.0)


class Sockets:
    """Every WebSocket of the gateway's own kind, and what became of those before."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway, self._sources = gateway, Sources(gateway.client)
        self._open: set[Socket] = set()
        self._dropped = 0
        self.cut = 0
        """sockets cut off because they did not read"""

    @property
    def open(self) -> int:
        return len(self._open)

    @property
    def subscriptions(self) -> int:
        return sum(socket.subscriptions for socket in self._open)

    @property
    def dropped(self) -> int:
        """Samples lost for want of room."""
        return self._dropped + sum(socket.dropped for socket in self._open)

    async def serve(self, ws: WebSocket) -> None:
        """Key expressions as they are published: send ``{"subscribe": "quad1", "hz": 5}``."""
        await ws.accept()
        if len(self._open) >= MOST_SOCKETS:
            await ws.close(TRY_AGAIN_LATER, f"no more than {MOST_SOCKETS} WebSockets")
            return
        socket = Socket(self._gateway, self._sources, ws)
        self._open.add(socket)
        try:
            if await socket.run():
                self.cut += 1
        finally:
            self._open.discard(socket)
            self._dropped += socket.dropped


def routes(gateway: Gateway) -> list[BaseRoute]:
    sockets = Sockets(gateway)
    gateway.figures.update(
        websockets=lambda: sockets.open,
        subscriptions=lambda: sockets.subscriptions,
        dropped=lambda: sockets.dropped,
        cut=lambda: sockets.cut,
    )
    return [WebSocketRoute("/ws", sockets.serve)]


def _ask_of(data: str | bytes) -> Ask:
    """Raises :class:`BadInput` for what is no request."""
    try:
        ask = msgspec.json.decode(data, type=Ask)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as e:
        said = str(data[:80])
        raise BadInput(f"not understood: {e}", field="message", value=said, expected=EXPECTED) from e
    if [ask.subscribe, ask.unsubscribe, ask.whole, ask.ping].count(None) != 3:
        text = "one of subscribe, unsubscribe, whole and ping is needed"
        raise BadInput(text, field="message", value=str(data[:80]), expected=EXPECTED)
    return ask


def _is_event(key: str) -> bool:
    return key.endswith("/event") and key.count("/") == keys.EVENT.template.count("/") + 1
