"""A bad link on purpose, ``lossy:URL?loss=0.2&delay=0.2&jitter=0.05&seed=7``: URL's frames are lost and late.

Whole frames are lost, in both directions, as a radio loses them: a stream is cut into frames by their own length bytes,
and what is no frame passes as it is. Delays keep the order. The same seed loses the same frames of the same traffic.
"""

from __future__ import annotations

import collections
import logging
import random
import threading
import time
from collections.abc import Callable, Iterator

from zmav.links import Link, LinkState, open_link
from zmav.links.base import LinkCounters, OnData, OnState

logger = logging.getLogger(__name__)

MOST_LATE = 10_000
"""frames under way in one direction; beyond it they are lost, as in a radio's queue"""
_V2, _V1, _SIGNED = 0xFD, 0xFE, 1


class Cutter:
    """Cuts a byte stream into frames, by the lengths in their headers; checks nothing."""

    def __init__(self) -> None:
        self._rest = b""

    def cut(self, data: bytes) -> Iterator[bytes]:
        """Whole frames, and what lies between them; a torn frame waits for its rest."""
        data = self._rest + data
        start = 0
        while start < len(data):
            end = start + _length(data, start)
            if end > len(data):
                break
            yield data[start:end]
            start = end
        self._rest = data[start:]

    def reset(self) -> None:
        self._rest = b""


def _length(data: bytes, start: int) -> int:
    """Bytes from ``start`` to the end of the frame (or of the garbage) that begins there."""
    if data[start] == _V1:
        return 8 + data[start + 1] if start + 1 < len(data) else 2
    if data[start] == _V2:
        if start + 2 >= len(data):
            return 3
        return 12 + data[start + 1] + (13 if data[start + 2] & _SIGNED else 0)
    ends = [at for at in (data.find(_V2, start), data.find(_V1, start)) if at >= 0]
    return (min(ends) if ends else len(data)) - start


class Channel:
    """One direction: loses, delays, keeps the order."""

    def __init__(self, loss: float, delay: float, jitter: float, seed: int, direction: str) -> None:
        self._loss, self._delay, self._jitter = loss, delay, jitter
        # Each direction has its own numbers: what one sends does not change what the other loses.
        self._chance = random.Random(f"{seed} {direction}")
        self._last_due = 0.0
        self.lost = 0

    def due(self, waiting: int) -> float | None:
        """When the next frame arrives (monotonic seconds); None: never."""
        chance = self._chance
        lost, late = chance.random() < self._loss, self._delay + chance.random() * self._jitter
        if lost or waiting >= MOST_LATE:
            self.lost += 1
            return None
        self._last_due = max(self._last_due, time.monotonic() + late)
        return self._last_due


class LossyLink(Link):
    """``inner``, made worse: share of frames lost, and seconds late, each way; ``jitter`` seconds more at random."""

    def __init__(
        self, inner: Link, *, loss: float = 0.0, delay: float = 0.0, jitter: float = 0.0, seed: int = 0
    ) -> None:
        super().__init__(f"lossy:{inner.url}")
        self.inner, self.recorded = inner, inner.recorded
        self._over = False
        self.incoming = Channel(loss, delay, jitter, seed, "in")
        self.outgoing = Channel(loss, delay, jitter, seed, "out")
        self._cutter = Cutter()
        self._late: dict[str, collections.deque[tuple[float, Callable[[], object]]]] = {
            "in": collections.deque(),
            "out": collections.deque(),
        }
        self._news = threading.Condition()

    @property
    def state(self) -> LinkState:
        return self.inner.state

    @property
    def detail(self) -> str:
        return self.inner.detail

    @property
    def counters(self) -> LinkCounters:
        """The inner link's: what was really read and written."""
        return self.inner.counters

    @property
    def capacity(self) -> float | None:
        return self.inner.capacity

    def start(self, on_data: OnData, on_state: OnState) -> None:
        self._on_data, self._on_state = on_data, on_state
        self._thread = threading.Thread(target=self._deliver, name=f"link {self.url}", daemon=True)
        self._thread.start()
        self.inner.start(self._on_inner_data, self._on_inner_state)

    def send(self, data: bytes) -> bool:
        """True where the inner link is up; the frame may yet be lost, and nobody is told."""
        if self.inner.state is not LinkState.UP:
            return self.inner.send(data)  # which counts it, and knows why
        with self._news:
            due = self.outgoing.due(len(self._late["out"]))
            if due is not None:
                self._late["out"].append((due, lambda: self.inner.send(data)))
                self._news.notify()
        return True

    def close(self) -> None:
        """What is late is handed over at once, and then the inner link's last words."""
        with self._news:
            self._over = True
            self._news.notify()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self.inner.close()
        with self._news:
            ready = self._take()
        self._hand_over(ready)

    def wait(self, state: LinkState, timeout: float | None) -> bool:
        return self.inner.wait(state, timeout)

    def _on_inner_data(self, data: bytes) -> None:
        with self._news:
            for piece in self._cutter.cut(data):
                due = self.incoming.due(len(self._late["in"]))
                if due is not None:
                    self._late["in"].append((due, lambda piece=piece: self._on_data(piece)))  # type: ignore[misc]
            self._news.notify()

    def _on_inner_state(self, state: LinkState, detail: str) -> None:
        """Told by the thread that hands over data, for the listener expects one thread; never lost nor late."""
        with self._news:
            if state is not LinkState.UP:
                self._cutter.reset()
            due = self._late["in"][-1][0] if self._late["in"] else 0.0
            self._late["in"].append((due, lambda: self._on_state(state, detail)))
            self._news.notify()

    def _deliver(self) -> None:
        """The thread in which everything arrives, both ways."""
        while True:
            with self._news:
                ready = self._take()
                if not ready:
                    if self._over:
                        return
                    self._news.wait(self._until_next())
                    continue
            self._hand_over(ready)

    def _hand_over(self, ready: list[Callable[[], object]]) -> None:
        for arrive in ready:
            try:
                arrive()
            except Exception:
                logger.exception("%s: a listener failed; the link goes on", self.url)

    def _take(self) -> list[Callable[[], object]]:
        now, ready = time.monotonic(), []
        for late in self._late.values():
            while late and (late[0][0] <= now or self._over):
                ready.append(late.popleft()[1])
        return ready

    def _until_next(self) -> float | None:
        dues = [late[0][0] for late in self._late.values() if late]
        return max(min(dues) - time.monotonic(), 0.0) if dues else None

    def _open(self) -> str:
        raise NotImplementedError  # the inner link's thread does all that

    _read = _write = _release = _open  # type: ignore[assignment]


def open_lossy(url: str) -> Link:
    """The link of a URL, made worse where it begins with ``lossy:``."""
    if not url.startswith("lossy:"):
        return open_link(url)
    body, _, options = url.removeprefix("lossy:").partition("?")
    values = dict(part.split("=") for part in options.split("&") if part)
    seed = int(values.pop("seed", "0"))
    return LossyLink(open_link(body), seed=seed, **{name: float(value) for name, value in values.items()})
