"""One controller's process, as its supervisor has it: started, spoken to, and ended whatever it does."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from agents.controllers import packets
from agents.controllers.packets import Answer
from zmav.errors import BadConfig, TimedOut
from zmav.tunable import Tunable
from zmav.waiting import on_loop

logger = logging.getLogger(__name__)
LOAD_TIMEOUT = 20.0
"""s for a file to be loaded: what it imports may be large"""
BUFFER = 1 << 18
"""bytes"""


class Loaded(msgspec.Struct, forbid_unknown_fields=True):
    """What a controller says of itself."""

    loaded: str
    level: str
    gives: str
    doc: str
    tunables: dict[str, Tunable]


class WorkerEvents(NamedTuple):
    """What a worker calls, from its thread."""

    answered: Callable[[Worker, Answer], None]
    failed: Callable[[Worker, str], None]
    """too when it is gone and nobody closed it"""
    because: Callable[[Worker, str], None]
    """where in the user's file that was"""


class Worker:
    """A process of :mod:`agents.controllers.host`."""

    def __init__(self, events: WorkerEvents) -> None:
        self._events = events
        self._loop = asyncio.get_running_loop()
        self.names: tuple[str, ...] = ()
        """of the signals"""
        self._waiting: asyncio.Future[dict[str, Any]] | None = None
        self._closed = self._killed = False
        self._line, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (self._line, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        command = [sys.executable, "-m", "agents.controllers.host", str(theirs.fileno())]
        # A session of its own: Ctrl-C at the terminal is for the supervisor, which hands back first.
        self.process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        self._thread = threading.Thread(target=self._read, name="controller", daemon=True)
        self._thread.start()

    # Any thread.

    @property
    def alive(self) -> bool:
        """Neither ended by itself nor killed here: one that was killed may take a moment to be gone."""
        return not self._killed and self.process.poll() is None

    def send(self, data: bytes) -> bool:
        """False: it does not take any more, or is gone."""
        try:
            self._line.send(data, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError:
            return False
        return True

    def tune(self, name: str, value: float) -> None:
        self.send(packets.pack_message(tune={"name": name, "value": value}))

    def kill(self) -> None:
        """End it, and the processes that the user's class has started."""
        if self.alive:
            self._killed = True
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)

    def close(self) -> None:
        """End it, however stuck it is."""
        self._closed = True
        self.kill()
        with contextlib.suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        self.process.wait()
        if threading.current_thread() is not self._thread:
            self._thread.join(2.0)
            self._line.close()

    # The event loop.

    async def load(self, what: str, tuned: dict[str, float]) -> Loaded:
        """Have it load a controller and try it out. Raises :class:`BadConfig` with file and line where it is broken,
        :class:`TimedOut`.
        """
        waiting: asyncio.Future[dict[str, Any]] = self._loop.create_future()
        self._waiting = waiting
        if not self.send(packets.pack_message(load={"what": what, "tuned": tuned})):
            raise TimedOut("the controller's process takes nothing any more")
        try:
            await asyncio.wait({waiting}, timeout=LOAD_TIMEOUT)
            if not waiting.done():
                raise TimedOut(f"the controller was not loaded within {LOAD_TIMEOUT:.0f} s")
            said = waiting.result()
        finally:
            self._waiting = None
        if "broken" in said:
            raise BadConfig(str(said["broken"]), field="controller", value="", expected="a controller that runs")
        return msgspec.convert(said, Loaded)

    def _answered(self, said: dict[str, Any]) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(said)

    # Its thread.

    def _read(self) -> None:
        answered = on_loop(self._loop, self._answered)
        while True:
            try:
                data = self._line.recv(packets.MOST)
            except OSError:
                data = b""
            if not data:
                break
            try:
                self._take(data, answered)
            except Exception as e:  # this thread must not end before the process does
                logger.exception("what a controller's process said was not taken")
                self._events.failed(self, f"what its process said was not taken: {e!r}")
        if not self._closed:
            code = self.process.wait()
            answered({"broken": f"its process ended by itself ({_reason(code)})"})
            self._events.failed(self, f"its process is gone ({_reason(code)})")

    def _take(self, data: bytes, answered: Callable[[dict[str, Any]], None]) -> None:
        if data[:1] == packets.OUTPUT:
            self._events.answered(self, packets.unpack_output(data))
            return
        said = packets.unpack_message(data)
        if "names" in said:
            self.names = tuple(said["names"])
        elif "failed" in said:
            self._events.failed(self, str(said["failed"]))
        elif "because" in said:
            self._events.because(self, str(said["because"]))
        else:
            answered(said)


def _reason(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit status {code}"
