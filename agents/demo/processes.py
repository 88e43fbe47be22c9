"""Child processes of a demo: started, their logs kept, all ended whatever happens."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import zmav
from zmav.errors import ZmavError
from zmav.session import CONNECT
from zmav.trust.credentials import VARIABLE

OURS = (VARIABLE, CONNECT, "ZMAV_FLEET")
"""environment variables that would make them part of another fleet"""


class Processes:
    """``zmav`` verbs as processes of their own, each with a log file; on exit all get SIGTERM, then SIGKILL.

    They are a fleet for themselves, without credentials whatever $ZMAV_CREDENTIALS says.

    Use it with ``with``, in the main thread: while it lasts a SIGTERM to us is an exit like any other.
    """

    def __init__(self) -> None:
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._mortal: set[str] = set()
        self._folder = tempfile.TemporaryDirectory(prefix="zmav-demo-")
        self._starting = False
        self._asked: int | None = None

    def __enter__(self) -> Processes:
        self._before = {number: signal.signal(number, self._on_signal) for number in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)  # we are about to end
        for process in self._running.values():
            process.terminate()
        deadline = time.monotonic() + 5.0
        for process in self._running.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, deadline - time.monotonic()))
            if process.poll() is None:
                process.kill()
                process.wait()
        self._folder.cleanup()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: object) -> None:
        """Leave, but not between the birth of a process and our knowing of it."""
        if self._starting:
            self._asked = number
        else:
            _leave(number)

    def start(
        self, name: str, *arguments: str, may_end: bool = False, environment: Mapping[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        """Start ``zmav ARGUMENTS`` under a name."""
        self._starting = True
        with self._log(name).open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "zmav", *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env={**{key: value for key, value in os.environ.items() if key not in OURS}, **(environment or {})},
            )  # fmt: skip
        self._running[name] = process
        if may_end:
            self._mortal.add(name)
        self._starting = False
        if self._asked is not None:
            _leave(self._asked)
        return process

    def kill(self, name: str) -> None:
        """As power that fails."""
        self._mortal.add(name)
        self._running[name].kill()
        self._running[name].wait()

    def end(self, name: str, patience: float = 20.0) -> None:
        """SIGTERM, and wait: what it has to write is written then."""
        self._mortal.add(name)
        self._running[name].terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._running[name].wait(patience)

    def check(self) -> None:
        """Raise where a process has ended that should run, with the last it said."""
        for name, process in self._running.items():
            code = process.poll()
            if code is not None and name not in self._mortal:
                raise ZmavError(
                    f"{name} ended with {code}, but should run to the end; it said last:\n{self.said(name)}"
                )

    def ended(self, name: str) -> int | None:
        """With which code; None: it runs."""
        return self._running[name].poll()

    def pids(self) -> dict[str, int]:
        """Of those that run."""
        return {name: process.pid for name, process in self._running.items() if process.poll() is None}

    def said(self, name: str, lines: int = 15) -> str:
        """The end of its log."""
        return "\n".join(self._log(name).read_text("utf-8", "replace").splitlines()[-lines:])

    def lines(self, name: str) -> list[str]:
        """All the whole lines of its log."""
        return self._log(name).read_text("utf-8", "replace").split("\n")[:-1]

    def _log(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name.replace('/', '_')}.log"


async def connect(
    stack: contextlib.AsyncExitStack, fleet: str, endpoint: str, processes: Processes
) -> zmav.Client:  # fmt: skip
    """A client of a router that they hold, once that router is up."""
    return await zmav.client.connect_once_up(stack, fleet, endpoint, processes.check)


def _leave(number: int) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)
