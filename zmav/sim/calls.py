"""Calls from other threads into the world's: done between two ticks, in the order they came."""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import TypeVar

from zmav.errors import TimedOut

T = TypeVar("T")


class Calls:
    """Wakes ``selector`` when there is something to do. :meth:`do` is the world's thread's, the rest anybody's."""

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector = selector
        self._waiting: deque[Callable[[], None]] = deque()
        self._bell, self._ear = socket.socketpair()
        self._bell.setblocking(False)
        self._ear.setblocking(False)
        selector.register(self._ear, selectors.EVENT_READ, self._hear)

    def ring(self) -> None:
        """Have the world look up."""
        # A full buffer means that it rings already; a closed one, that nobody is left to hear.
        try:
            self._bell.send(b"\0")
        except OSError:
            return

    def _hear(self) -> None:
        try:
            self._ear.recv(4096)
        except BlockingIOError:
            return

    def call(self, function: Callable[[], T], timeout: float = 10.0) -> T:
        """Have ``function`` run; gives its result, or raises what it raised. :class:`TimedOut` where nobody does."""
        future: Future[T] = Future()

        def task() -> None:
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

        self._waiting.append(task)
        self.ring()
        try:
            return future.result(timeout)
        except FutureTimeout:
            if future.done():
                raise  # the function's own
            raise TimedOut("the simulated world does not run") from None

    def do(self) -> None:
        """Run what waits."""
        while self._waiting:
            self._waiting.popleft()()

    def close(self) -> None:
        """Once the selector is closed."""
        self._bell.close()
        self._ear.close()
