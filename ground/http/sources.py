"""Key expressions that WebSockets read: each is subscribed to once, and each sample made into text once, for all."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable

import zenoh

from ground.http.documents import document_of_sample, to_json
from zmav.client import Client
from zmav.mavlink import Dialect


class Came:
    """A sample and when it came (UTC seconds); its text is made when the first socket sends it."""

    __slots__ = ("_text", "key", "sample", "t")

    def __init__(self, sample: zenoh.Sample, t: float) -> None:
        self.key, self.sample, self.t = str(sample.key_expr), sample, t
        self._text: str | None = None

    def text(self, dialect: Dialect) -> str:
        if self._text is None:
            self._text = to_json(document_of_sample(self.sample, self.t, dialect)).decode()
        return self._text


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
