"""The run of a world: ticks when they are due, and between them clients, and calls from other threads."""

from __future__ import annotations

import math
import selectors
import socket
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import TypeVar

from zmav.errors import TimedOut
from zmav.sim.clock import Pacer
from zmav.sim.endpoints import Wiring
from zmav.sim.external import Externals
from zmav.sim.lockstep import Lockstep
from zmav.sim.status import WorldStatus

T = TypeVar("T")

STACK_WAIT_S = 0.01  # of wall time, that the world listens for a flight stack which is behind, at a time
LOOK_S = 0.05  # of wall time, between looks at who waits to be flushed, and at how long a client has kept the world
ALERT_S = 0.02  # simulated, whose ticks come on time after somebody spoke: in it autopilots think, and say what of it


class Calls:
    """Calls from other threads into the world's: done between two ticks, in the order they came. ``selector`` is woken
    when there is something to do. :meth:`do` is the world's thread's, the rest anybody's.
    """

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
            if not future.set_running_or_notify_cancel():
                return  # who asked has been told that nobody does it
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

        self._waiting.append(task)
        self.ring()
        try:
            return future.result(timeout)
        except FutureTimeout:
            if future.cancel():
                raise TimedOut("the simulated world does not run") from None
            return future.result()  # it is done just now; or that error was its own

    def do(self) -> None:
        """Run what waits."""
        while self._waiting:
            self._waiting.popleft()()

    def close(self) -> None:
        """Once the selector is closed."""
        self._bell.close()
        self._ear.close()


class Loop:
    """Calls ``tick`` when ``pacer`` says so, and not before ``lockstep`` (None: nobody) and ``externals`` follow.
    ``now``: simulated seconds; ``status``: what the end of :meth:`advance` gives.

    ``spare``: how many ticks may come late, because nobody outside would notice: one wake-up then makes several. Who
    speaks meanwhile wakes the loop, and is heard after the ticks that were due before.
    """

    def __init__(
        self,
        tick: Callable[[], None],
        now: Callable[[], float],
        status: Callable[[], WorldStatus],
        pacer: Pacer,
        externals: Externals,
        lockstep: Lockstep | None,
        spare: Callable[[], int],
    ) -> None:
        self._tick, self._now, self._status, self._spare = tick, now, status, spare
        self._alert = self._alert_ticks = round(ALERT_S / pacer.tick_s)
        self._pacer, self._externals, self._lockstep = pacer, externals, lockstep
        self.selector = selectors.DefaultSelector()
        self.wiring = Wiring(self.selector, set())
        self.ticked = threading.Condition()
        """notified after each tick, and when the run has failed"""
        self.failure: BaseException | None = None
        """what ended the thread of :meth:`start`"""
        self.calls = Calls(self.selector)
        self._thread: threading.Thread | None = None
        self._turn = threading.Lock()  # of the thread that runs it, for good: two would tick the same world
        self._entered = threading.Event()
        self._stopping = False
        self._runner: int | None = None  # the thread that runs it, where one does
        self._advancing: Future[WorldStatus] | None = None

    # ---- life

    @property
    def runs(self) -> bool:
        """Some thread runs it."""
        return self._runner is not None

    def start(self) -> None:
        """Run in a thread of its own, which has begun when this returns. Nothing where it runs already or has run: what
        was stopped or has failed, see :attr:`failure`, does not go on.
        """
        if self._turn.acquire(blocking=False):
            self._thread = threading.Thread(target=self._run_guarded, name="zmav-sim", daemon=True)
            self._thread.start()
        self._entered.wait()

    def stop(self) -> None:
        """Ask :meth:`run` to end; any thread, and signal handlers, may."""
        self._stopping = True
        self.calls.ring()

    def join(self) -> None:
        """Wait until the thread of :meth:`start` has ended."""
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """Once nothing runs and everybody is unregistered."""
        self.selector.close()
        self.calls.close()
        self._over(TimedOut("the simulator has ended"))

    def _run_guarded(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self.failure = error
            with self.ticked:
                self.ticked.notify_all()
            self._over(TimedOut(f"the simulated world has failed: {error!r}"))

    def run(self) -> None:
        """Run in this thread until :meth:`stop`; where that of :meth:`start` does, only wait for its end; where another
        one does, nothing.
        """
        if self._turn.acquire(blocking=False):
            self._run()
        else:
            self.join()

    def _run(self) -> None:
        self._runner = threading.get_ident()
        self._entered.set()
        self._pacer.restart()
        try:
            while not self._stopping:
                late = self._spare() if self._alert == 0 else 0
                self._serve(self._wait_s(late), late)
                if self._wait_s() == 0.0:
                    self._advance_one()
                self._flush()
        finally:
            self._runner = None

    def _wait_s(self, late: int = 0) -> float:
        """Wall seconds to listen before another look, ``late`` ticks after the next one is due; 0: it may come."""
        wait = self._pacer.wait_s(late)
        if wait > 0.0:
            # Someone who did not read, or a line that nobody has opened, does not wake us.
            return min(wait, LOOK_S) if self.wiring.waiting else wait
        if self._externals.behind():
            return STACK_WAIT_S
        if self._lockstep is not None and not self._lockstep.ready():
            return LOOK_S
        return 0.0

    def _advance_one(self) -> None:
        self._tick()
        self._alert = max(self._alert - 1, 0)
        if self._lockstep is not None:
            self._lockstep.ticked(self._now())
        with self.ticked:
            self.ticked.notify_all()
        self._pacer.ticked()
        if self._advancing is not None and not self._pacer.stepping:
            self._over()

    # ---- the clock

    def pause(self) -> None:
        """Stand still; in the world's thread."""
        self._pacer.pause()
        self._over()

    def advance(self, ticks: int) -> Future[WorldStatus]:
        """Go on for so many ticks, and pause then; in the world's thread. The future is set when they are over, or
        when somebody pauses or advances the world before.
        """
        before, mine = self._advancing, Future[WorldStatus]()
        self._advancing = mine
        self._pacer.allow(ticks)
        self._tell(before)  # last: who hears that may well advance the world again
        return mine

    def _over(self, error: Exception | None = None) -> None:
        """The one who waits for the end of :meth:`advance` need wait no longer."""
        waiting, self._advancing = self._advancing, None
        self._tell(waiting, error)

    def _tell(self, waiting: Future[WorldStatus] | None, error: Exception | None = None) -> None:
        if waiting is None:
            return
        if error is None:
            waiting.set_result(self._status())
        else:
            waiting.set_exception(error)

    # ---- links, and calls from other threads

    def serve(self) -> None:
        """Hear and answer clients of a world that nobody runs."""
        self._serve(0.0, 0)
        self._flush()

    def _serve(self, timeout: float, late: int) -> None:
        """Hear clients and calls for ``timeout`` seconds at most (infinite: until one comes); first make the ticks that
        came due meanwhile, ``late`` of them at most.
        """
        speaking = self.selector.select(timeout if math.isfinite(timeout) else None)
        for _ in range(late):
            if self._wait_s() > 0.0:
                break
            self._advance_one()
        for key, _ in speaking:
            self._alert = self._alert_ticks
            ready: Callable[[], None] = key.data
            ready()
        self.calls.do()

    def _flush(self) -> None:
        self._externals.flush()
        waiting = self.wiring.waiting
        for each in list(waiting):
            if each.flush():
                waiting.discard(each)

    def inside(self, function: Callable[[], T]) -> T:
        """Have the world's thread do it, where one runs and it is not this one."""
        return function() if self._runner in (None, threading.get_ident()) else self.calls.call(function)
