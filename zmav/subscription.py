"""Samples of a key expression as they come, for who reads them one by one."""

from __future__ import annotations

import asyncio
import collections
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any, Generic, TypeVar

import msgspec
import zenoh

from zmav import keys, wire
from zmav.direct import direct
from zmav.errors import BadInput, Forbidden
from zmav.waiting import on_loop

T = TypeVar("T")
W = TypeVar("W", bound=msgspec.Struct)


class Subscription(Generic[T]):
    """Samples of a key expression, newest wins: a reader that is slow loses the oldest, and nobody else waits for it.

    Of events none is lost on the way, nor is their order: what went out while a link was down comes when it is back.
    Recordings are heard by who names their fleet (:func:`zmav.keys.hears`).
    Use it with ``async with`` and iterate; it lasts until it is left, and goes on when a lost router is found again.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        convert: Callable[[zenoh.Sample], T],
        depth: int,
        token: str = "",
        history: int = 0,
    ) -> None:
        self._session, self._key, self._convert, self._token_key = session, key, convert, token
        self._history = history
        self._token: zenoh.LivelinessToken | None = None
        self._samples: collections.deque[zenoh.Sample] = collections.deque(maxlen=depth)
        self._arrived = asyncio.Event()
        self._lock = threading.Lock()
        self._wake: Callable[[], None] = lambda: None
        self._woken = False
        self._subscriber: Any = None
        self.dropped = 0
        """samples lost because the reader was slow"""
        self.bad = 0
        """samples left out because they were not what they should be"""

    async def __aenter__(self) -> Subscription[T]:
        self._wake = on_loop(asyncio.get_running_loop(), self._look)
        if zenoh.KeyExpr(keys.EVENT.key("*", "*")).includes(zenoh.KeyExpr(self._key)):
            # What was published while a link was down is fetched from the vehicle's cache when it is up again.
            recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
            past = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=self._history)
            self._subscriber = zenoh.ext.declare_advanced_subscriber(
                self._session, self._key, self._on_sample, recovery=recovery, history=past if self._history else None
            )
        else:
            self._subscriber = self._session.declare_subscriber(self._key, direct(self._on_sample))
        if self._token_key:
            self._token = self._session.liveliness().declare_token(self._token_key)
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._token is not None:
            self._token.undeclare()
            self._token = None
        if self._subscriber is not None:
            self._subscriber.undeclare()
            self._subscriber = None

    def _on_sample(self, sample: zenoh.Sample) -> None:
        """On a thread of Zenoh's: one wake-up of the loop for all that comes meanwhile."""
        if not keys.hears(self._key, str(sample.key_expr)):
            return
        with self._lock:
            if len(self._samples) == self._samples.maxlen:
                self.dropped += 1
            self._samples.append(sample)
            if self._woken:
                return
            self._woken = True
        self._wake()

    def _look(self) -> None:
        self._woken = False  # first: a sample that comes from now on wakes us again
        self._arrived.set()

    async def __aiter__(self) -> AsyncIterator[T]:
        while True:
            yield await self.get()

    async def get(self) -> T:
        """The next sample; what cannot be converted is counted and left out."""
        while True:
            while not self._samples:
                self._arrived.clear()
                await self._arrived.wait()
            try:
                return self._convert(self._samples.popleft())
            except (BadInput, Forbidden):
                self.bad += 1


def document(kind: type[W]) -> Callable[[zenoh.Sample], tuple[str, W]]:
    """For a subscription to keys, and what came on each as a ``kind``; what is none is counted and left out."""

    def convert(sample: zenoh.Sample) -> tuple[str, W]:
        key = str(sample.key_expr)
        return key, wire.decode(sample.payload.to_bytes(), kind, key)

    return convert
