"""The local MAVLink link as services see it, and how a coroutine waits for what comes in on it."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import msgspec

from zmav.bus import Bus
from zmav.links import Link
from zmav.mavlink import Dialect, Frame, Splitter, decode
from zmav.mavlink.signing import Signing
from zmav.waiting import on_loop, within

Listener = Callable[[Frame], None]
BUSY_S = 1.0
"""s for which an intake waits for an event loop that has no time: the newest wait in its ring meanwhile"""


class LastFrame(NamedTuple):
    """A message's last frame, the seconds since, and how many of it came."""

    frame: Frame
    age: float
    total: int


class Flow(NamedTuple):
    """One kind of message from one source: how many frames, how many bytes of them, and when the last came."""

    name: str
    sysid: int
    compid: int
    total: int
    size: int
    heard: float
    """monotonic seconds"""


class TxCounters(msgspec.Struct):
    """Frames sent to the vehicle, dropped for want of a link, and refused as unfit."""

    frames: int = 0
    dropped: int = 0
    refused: int = 0


class FrameForwarded(NamedTuple):
    """A frame of another station was handed to the link. Told from the thread that takes them."""

    frame: Frame


class FrameRefused(NamedTuple):
    """A frame of another station did not go to the vehicle; its reason, in words. Told from the same thread."""

    text: str


class Port(Protocol):
    """What :class:`zmav.adapter.Adapter` offers to services; see there."""

    fleet: str
    name: str
    dialect: Dialect
    link: Link
    splitter: Splitter
    tx: TxCounters
    heard: float
    signing: Signing | None
    bus: Bus
    read: bool
    spoke: float
    awaited: int

    @property
    def address(self) -> tuple[int, int]: ...

    def send(self, name: str, **fields: Any) -> bool: ...

    def latest(self, name: str, source: tuple[int, int]) -> LastFrame | None: ...

    def newest(self, name: str) -> LastFrame | None: ...

    def msgid(self, name: str) -> int: ...

    def names(self) -> list[str]: ...

    def flows(self) -> list[Flow]: ...

    def listen(self, name: str, listener: Listener) -> Callable[[], None]: ...


def is_ours(ack: Mapping[str, Any], port: Port) -> bool:
    """An acknowledgement is for us: a ground station behind ``mav/tx`` may have asked the same; zero is everybody."""
    system, component = port.address
    return ack["target_system"] in (0, system) and ack["target_component"] in (0, component)


def one_waits(loop: asyncio.AbstractEventLoop, call: Callable[[Any], object]) -> Callable[[Any], None]:
    """As :func:`on_loop`, for an intake: one call at a time waits for the loop. Where that is busy for longer than
    :data:`BUSY_S`, the next one takes its place, whatever that was: the newest is what is called with, however late.
    """
    room, newest = threading.Semaphore(), collections.deque[Any](maxlen=1)

    def look(holds: bool) -> None:
        try:
            if newest:
                call(newest.popleft())
        finally:
            if holds:
                room.release()

    hand = on_loop(loop, look)

    def put(what: Any) -> None:
        holds = room.acquire(timeout=BUSY_S)
        newest.append(what)
        hand(holds)

    return put


class RoundTrip:
    """How many seconds to wait for an answer before it counts as lost, as in RFC 6298."""

    def __init__(self, first: float = 1.0, least: float = 0.25, most: float = 8.0) -> None:
        self._least, self._most = least, most
        self._mean: float | None = None
        self._deviation = 0.0
        self.timeout = first
        """seconds"""

    def sample(self, took: float) -> None:
        """An answer came after so long, to a question that was put once."""
        if self._mean is None:
            self._mean, self._deviation = took, took / 2
        else:
            self._deviation += (abs(took - self._mean) - self._deviation) / 4
            self._mean += (took - self._mean) / 8
        self.timeout = min(max(self._mean + 4 * self._deviation, 2 * self._mean, self._least), self._most)

    def late(self) -> None:
        """Nothing at all came within the timeout: it is the link that is slow."""
        self.timeout = min(2 * self.timeout, self._most)


@contextlib.contextmanager
def listening(
    port: Port, source: tuple[int, int], names: Iterable[str], take: Callable[[Frame], object]
) -> Iterator[None]:
    """``take(frame)`` is called in the link's thread for each message of these names from one system."""

    def on_frame(frame: Frame) -> None:
        if (frame.sysid, frame.compid) == source:
            take(frame)

    stops = [port.listen(name, on_frame) for name in names]
    port.awaited += 1
    try:
        yield
    finally:
        port.awaited -= 1
        for stop in stops:
            stop()


BREATH = 64
"""frames taken before others on the event loop have their turn"""


class Inbox:
    """Messages of the given names from one system, in order, while the ``with`` lasts. Read it on the event loop.

    Frames are many at times (a file's), so the link's reader thread wakes the loop once for many of them.
    """

    def __init__(self, port: Port, source: tuple[int, int], *names: str) -> None:
        self._port, self._source, self._names = port, source, names
        self._frames: collections.deque[Frame] = collections.deque()
        self._news, self._woken = asyncio.Event(), False
        self._taken = 0
        self._listening = contextlib.ExitStack()

    def __enter__(self) -> Inbox:
        wake = on_loop(asyncio.get_running_loop(), self._wake)

        def take(frame: Frame) -> None:
            self._frames.append(frame)
            if not self._woken:
                self._woken = True
                wake()

        self._listening.enter_context(listening(self._port, self._source, self._names, take))
        return self

    def __exit__(self, *_: object) -> None:
        self._listening.close()

    def _wake(self) -> None:
        self._woken = False
        self._news.set()

    async def frame(self, timeout: float) -> Frame | None:
        """The next frame as it came; None when none came within ``timeout`` seconds."""
        self._taken += 1
        if self._taken % BREATH == 0:
            await asyncio.sleep(0)
        while not self._frames:
            self._news.clear()
            if self._frames:
                break
            try:
                await within(timeout, self._news.wait())
            except asyncio.TimeoutError:
                return None
        return self._frames.popleft()

    async def get(self, timeout: float) -> tuple[str, Mapping[str, Any]] | None:
        """The next message's name and fields; None when none came within ``timeout`` seconds."""
        frame = await self.frame(timeout)
        return None if frame is None else (self._port.dialect.name_of(frame.msgid), decode(frame, self._port.dialect))
