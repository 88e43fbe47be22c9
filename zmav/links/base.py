"""What every link is: one reader thread that opens, reads and reopens for ever, a state, counters, a bounded send.

A transport adds four methods to :class:`Link` (``_open``, ``_read``, ``_write``, ``_release``) and, where a blocked
read can be woken, a fifth (``_wake``). Threads, backoff, states and counters are here and nowhere else.
"""

from __future__ import annotations

import contextlib
import enum
import logging
import random
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import msgspec

from zmav.errors import LinkError, ZmavError

logger = logging.getLogger(__name__)

OnData = Callable[[bytes], None]
MUCH = 4000  # bytes, from which on a nap was too long: the least receive buffers hold that much in the smallest frames,
# and a terminal gives 4095 at once at most, however many wait
FIRST_NAP_S, SHORTEST_NAP_S = 0.005, 0.001
FIRST_WAIT_S, MOST_WAIT_S = 0.2, 3.0  # between two tries to open it
JOIN_S = 1.0  # close() waits so long for the reader thread; only a name being looked up can outlast it


class LinkState(str, enum.Enum):
    CLOSED = "closed"  # not started, or closed for good
    CONNECTING = "connecting"  # open or being opened, but nobody at the other end yet
    UP = "up"
    DOWN = "down"  # it failed (or a recording ended); the detail says why, and it is tried again


OnState = Callable[[LinkState, str], None]


class LinkCounters(msgspec.Struct):
    """Sums since the link was made; bytes as the transport carried them, frames as given to ``send``."""

    rx_bytes: int = 0
    tx_bytes: int = 0  # sent, or queued to be sent
    tx_dropped: int = 0  # frames that send() refused
    opens: int = 0  # times the link came UP
    last_error: str | None = None
    rx_buffer: int = 0  # the kernel's receive buffer in bytes, as reported (Linux: twice what it granted)
    rx_dropped: int = 0  # datagrams the kernel threw away because the buffer was full (UDP on Linux)
    skipped: int = 0  # bytes of a recording that were no record (replay)


class LinkFinished(Exception):
    """Raised by a transport's ``_read`` when there is nothing more to come and nothing to retry: a normal end."""


class Backoff:
    """Seconds to wait before the next try: 0.2, 0.3, 0.45 ... 3, each up to a fifth shorter or longer, 3 at most."""

    def __init__(self, chance: Callable[[], float] = random.random) -> None:
        self._chance, self._base = chance, FIRST_WAIT_S

    def next(self) -> float:
        base = self._base
        self._base = min(MOST_WAIT_S, base * 1.5)
        return min(MOST_WAIT_S, base * (0.8 + 0.4 * self._chance()))

    def reset(self) -> None:
        self._base = FIRST_WAIT_S


class Link(ABC):
    """A way to an autopilot, opened and reopened by itself. Made by :func:`zmav.links.open_link`, then started once.

    ``send`` and ``close`` may be called from any thread, also from the callbacks. Nothing is raised out of the thread
    that reads: errors go to ``counters.last_error`` and to the state.
    """

    recorded: bool = False
    """what it brings is no vehicle's present word, and nothing can be sent"""
    backoff: type[Backoff] = Backoff
    # Whether an open transport is UP at once, or only when the first bytes came (udpin: nobody is known before).
    _up_when_open = True

    def __init__(self, url: str) -> None:
        self.url = url
        self._counters = LinkCounters()
        self._state = LinkState.CLOSED
        self._detail = "not started"
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._tx_lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ended = False
        self._complained: set[str] = set()  # callbacks whose failing was logged
        self._on_data: OnData = lambda data: None
        self._on_state: OnState = lambda state, detail: None
        self.patience: Callable[[], float] = float
        """s that what comes may lie until more has come: one wake-up for many frames. Asked after each read, and heeded
        where frames come faster than that and :meth:`hurry` does not end it
        """
        self.joins_s = 0.0
        """datagrams that wait already, because they come faster than they are taken, are given together: with one whose
        read took less than that. 0: none are
        """
        self.nap = FIRST_NAP_S
        """s of the next wait for more; it shortens where much comes"""
        self._hurry = threading.Lock()  # held but for a moment after hurry()
        self._hurry.acquire()

    # -- what users call ---------------------------------------------------------------------------------------------

    @property
    def state(self) -> LinkState:
        return self._state

    @property
    def detail(self) -> str:
        """The state in words: what is being tried, who is connected, why it is down and what to do."""
        return self._detail

    @property
    def counters(self) -> LinkCounters:
        return self._counters

    @property
    def capacity(self) -> float | None:
        """Bytes a second it can carry each way; None: not limited by its kind, or not known."""
        return None

    def start(self, on_data: OnData, on_state: OnState) -> None:
        """Start the one thread that calls both callbacks inline, so they must be quick.

        ``on_data(data)``: bytes as they were read, never empty; a piece of a stream, one recorded frame, or a datagram,
        with those that came while it was waited for more.
        ``on_state(state, detail)``: on each change. An exception out of either is logged and otherwise ignored.
        Raises LinkError when the link was started or closed before.
        """
        if self._thread is not None or self._closing.is_set():
            raise LinkError(f"{self.url} was started or closed before; open another link", url=self.url)
        self._on_data, self._on_state = on_data, on_state
        self._state, self._detail = LinkState.CONNECTING, "starting"
        self._thread = threading.Thread(target=self._run, name=f"link {self.url}", daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> bool:
        """Send one whole frame; never blocks long. False, and ``tx_dropped`` is one more, when it is down or full."""
        with self._tx_lock:
            try:
                sent = self._write(data)
            except (OSError, LinkError) as error:
                self._note(error)
                sent = 0
            self._counters.tx_bytes += sent
            if not sent:
                self._counters.tx_dropped += 1
        return sent > 0

    def hurry(self) -> None:
        """Take at once what has come, and ask ``patience`` again. Any thread."""
        with contextlib.suppress(RuntimeError):  # asked for already
            self._hurry.release()

    def close(self) -> None:
        """End the link for good and join its thread, within about a second; twice is harmless."""
        self._closing.set()
        self.hurry()
        self._wake()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(JOIN_S)

    def wait(self, state: LinkState, timeout: float | None) -> bool:
        """Wait until the link is in ``state``; False after ``timeout`` seconds, or once it is closed and cannot be."""
        with self._changed:
            self._changed.wait_for(lambda: self._state is state or self._ended, timeout)
            return self._state is state

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url} {self.state.value}: {self.detail}>"

    # -- what a transport provides -----------------------------------------------------------------------------------

    @abstractmethod
    def _open(self) -> str:
        """Open the transport and say in words what is open; raises OSError or LinkError. Runs in the reader thread."""

    @abstractmethod
    def _read(self) -> bytes:
        """Block for at most about 0.25 s; b"" when nothing came. Raises OSError or LinkError when it broke."""

    def _more(self) -> bytes:
        """What came since, put together; b"" where nothing did, or where one read takes all there is."""
        return b""

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Bytes sent or queued, 0 when dropped; must not block. Called with ``_tx_lock`` held, by any thread."""

    @abstractmethod
    def _release(self) -> None:
        """Give back what ``_open`` took, also when it failed half way. Runs in the reader thread."""

    def _wake(self) -> None:  # noqa: B027  # not every transport can
        """Make a blocked ``_open`` or ``_read`` return soon. Called by ``close()``, by any thread."""

    # -- the reader thread -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        backoff = self.backoff()
        self._set_state(LinkState.CONNECTING, f"opening {self.url}")
        while not self._closing.is_set():
            heard = self._counters.rx_bytes
            try:
                detail = self._open()
                self._set_state(LinkState.UP if self._up_when_open else LinkState.CONNECTING, detail)
                self._pump()
            except LinkFinished as end:
                self._set_state(LinkState.DOWN, str(end))
                self._closing.wait()
            except Exception as error:
                self._failed(error)
            finally:
                with contextlib.suppress(OSError):
                    self._release()
            if self._counters.rx_bytes > heard:
                backoff.reset()
            if not self._closing.is_set():
                self._closing.wait(backoff.next())
        self._ended = True
        self._set_state(LinkState.CLOSED, "closed")

    def _pump(self) -> None:
        read, monotonic = self._read, time.monotonic
        while not self._closing.is_set():
            begun = monotonic()
            data = read()
            if not data:
                continue
            waited = monotonic() - begun
            if waited < self.joins_s:
                data += self._more()
            self._give(data)
            if len(data) >= MUCH:
                # A stream's nap brings nothing by itself, and doubles: a quarter, so that it shortens.
                self.nap = max(self.nap / 4.0, SHORTEST_NAP_S)
            while 2.0 * waited < (patience := self.patience()) and self._rest(patience):
                pass

    def _rest(self, patience: float) -> bool:
        """Let frames lie, and take them together; whether any had come. The nap grows for as long as little comes."""
        self.nap = min(self.nap, patience)
        self._hurry.acquire(timeout=self.nap)
        if self._closing.is_set():
            return False
        came, before = False, self._counters.rx_bytes
        while not self._closing.is_set() and (data := self._more()):
            self._give(data)
            came = True
        self._judge_nap(self._counters.rx_bytes - before, patience)
        return came

    def _judge_nap(self, brought: int, patience: float) -> None:
        if brought >= MUCH:
            self.nap = max(self.nap / 2.0, SHORTEST_NAP_S)
        elif brought < MUCH / 2:
            self.nap = min(2.0 * self.nap, patience)

    def _give(self, data: bytes) -> None:
        self._counters.rx_bytes += len(data)
        if self._state is not LinkState.UP:
            self._set_state(LinkState.UP, self._heard())
        try:
            self._on_data(data)
        except Exception as error:
            self._callback_failed("on_data", error)

    def _heard(self) -> str:
        """The detail of UP for a transport that is up only once it heard somebody."""
        return self._detail

    def _failed(self, error: Exception) -> None:
        if self._closing.is_set():
            return  # close() pulled the transport from under the reader
        if not isinstance(error, (OSError, ZmavError)):
            logger.exception("%s: unexpected error; the link tries again", self.url)
        self._note(error)
        self._set_state(LinkState.DOWN, self._counters.last_error or "failed")

    def _note(self, error: Exception | str) -> None:
        strerror = getattr(error, "strerror", None)
        self._counters.last_error = strerror or str(error) or type(error).__name__

    def _set_state(self, state: LinkState, detail: str) -> None:
        """Only the reader thread calls this, so that on_state sees the changes in order."""
        with self._changed:
            if (state, detail) == (self._state, self._detail):
                return
            if state is LinkState.UP and self._state is not LinkState.UP:
                self._counters.opens += 1
            self._state, self._detail = state, detail
            self._changed.notify_all()
        try:
            self._on_state(state, detail)
        except Exception as error:
            self._callback_failed("on_state", error)

    def _callback_failed(self, name: str, error: Exception) -> None:
        self._note(f"{name} failed: {type(error).__name__}: {error}")
        if name not in self._complained:  # once with its traceback; hundreds of frames a second may fail alike
            self._complained.add(name)
            logger.exception("%s: %s failed; the link goes on, and says so only once", self.url, name)
