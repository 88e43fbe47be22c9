"""``zmav`` verbs as processes beside us: each with its log, all of them gone when we are, however we end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from zmav import guard
from zmav.client import Client, connect
from zmav.errors import LinkDown, SessionError, ZmavError
from zmav.session import CONNECT, SessionSettings
from zmav.sim import Remote
from zmav.trust import VARIABLE

OURS = (VARIABLE, CONNECT, "ZMAV_FLEET")
"""environment variables that would make them part of another fleet"""
GRACE_S = 5.0
"""s to end in good order"""
WATCH_S = 0.2


class Children:
    """``with Children() as children``: they end with it, by SIGTERM and then SIGKILL.

    One after another, the last one started first, so that an agent hands its vehicle back before what it flies ends;
    or all ``at_once``. They are a fleet for themselves, without credentials whatever $ZMAV_CREDENTIALS says, out of the
    terminal's reach (a Ctrl-C is ours to act on while they still work), and the kernel ends them where we are killed.
    ``folder`` is for their files; it goes with them. In the main thread: they end with the thread that started them.
    ``by_signals``: SIGTERM and SIGINT to us end the block as any exit does, and are ignored while it cleans up.
    """

    def __init__(self, *, at_once: bool = False, by_signals: bool = False) -> None:
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._may_end: set[str] = set()
        self._at_once = at_once
        self._signals = (signal.SIGTERM, signal.SIGINT) if by_signals else ()
        self._starting = False
        self._asked: int | None = None
        self._scratch = tempfile.TemporaryDirectory(prefix="zmav-children-")
        self.folder = Path(self._scratch.name)

    def __enter__(self) -> Children:
        self._before = {number: signal.signal(number, self._on_signal) for number in self._signals}
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)
        running = list(reversed(self._running.values()))
        if self._at_once:
            for process in running:
                process.terminate()
        deadline = time.monotonic() + GRACE_S
        for process in running:
            if self._at_once:
                _await(process, max(0.0, deadline - time.monotonic()))
            else:
                end(process)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        self._scratch.cleanup()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: object) -> None:
        """Leave, but not between the birth of a process and our knowing of it."""
        if self._starting:
            self._asked = number
        else:
            _leave(number)

    def start(
        self,
        name: str,
        *arguments: str,
        module: str = "zmav",
        may_end: bool = False,
        environment: Mapping[str, str] | None = None,
        pipes: bool = False,
    ) -> subprocess.Popen[bytes]:
        """Start ``zmav ARGUMENTS``, or another module, under a name. ``pipes``: to its input and from its output,
        unbuffered; its log has its errors only.
        """
        keep = [sys.executable, "-I", "-S", guard.__file__, str(os.getpid())]
        self._starting = True
        with self._log(name).open("wb") as log:
            self._running[name] = subprocess.Popen(
                [*keep, sys.executable, "-m", module, *arguments],
                bufsize=0 if pipes else -1,
                stdin=subprocess.PIPE if pipes else subprocess.DEVNULL,
                stdout=subprocess.PIPE if pipes else log,
                stderr=log,
                env={key: value for key, value in os.environ.items() if key not in OURS} | dict(environment or {}),
                start_new_session=True,
            )
        if may_end:
            self._may_end.add(name)
        self._starting = False
        if self._asked is not None:
            _leave(self._asked)
        return self._running[name]

    def kill(self, name: str) -> None:
        """As power that fails: without a chance to say anything."""
        self._may_end.add(name)
        self._running[name].kill()
        self._running[name].wait()

    def end(self, name: str, patience: float = GRACE_S) -> None:
        """End one of them now, in good order: what it has to write is written then."""
        self._may_end.add(name)
        end(self._running[name], patience)

    def check(self) -> None:
        """Raise :class:`~zmav.errors.ZmavError` where one has ended that should run, with the last it said."""
        for name, process in self._running.items():
            code = process.poll()
            if code is not None and name not in self._may_end:
                text = f"{name} ended with {code}, but should run to the end; it said last:"
                raise ZmavError(f"{text}\n{self.said(name)}")

    async def watch(self) -> None:
        """Until one of them has ended: raises."""
        while True:
            self.check()
            await asyncio.sleep(WATCH_S)

    def ended(self, name: str) -> int | None:
        """With which code; None: it runs."""
        return self._running[name].poll()

    def names(self) -> list[str]:
        """Of all that were started."""
        return list(self._running)

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
        return self.folder / f"{name.replace('/', '_')}.log"


def end(process: subprocess.Popen[bytes], patience: float = GRACE_S) -> None:
    """SIGTERM, and SIGKILL where it runs on after ``patience`` seconds; waits for its end."""
    process.terminate()
    _await(process, patience)


def _await(process: subprocess.Popen[bytes], patience: float) -> None:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience)
    if process.poll() is None:
        process.kill()
        process.wait()


def _leave(number: int) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)


async def connect_once_up(
    stack: contextlib.AsyncExitStack, fleet: str, endpoint: str, check: Callable[[], None], patience: float = 40.0
) -> Client:
    """A client of a router that is just starting, perhaps among many on a busy machine; it closes with ``stack``.

    ``check`` raises where that router's process has ended; :class:`~zmav.errors.SessionError` after ``patience`` s.
    """
    deadline = time.monotonic() + patience
    while True:
        check()
        try:
            return await stack.enter_async_context(connect(fleet=fleet, settings=SessionSettings(connect=[endpoint])))
        except SessionError:
            if time.monotonic() > deadline:
                raise


async def simulator_once_up(control: Path, check: Callable[[], None], patience: float = 60.0) -> Remote:
    """Likewise the simulator whose control socket is at ``control``; raises :class:`~zmav.errors.LinkDown`."""
    deadline = time.monotonic() + patience
    while True:
        check()
        try:
            return Remote(control)
        except LinkDown:
            if time.monotonic() > deadline:
                raise
            await asyncio.sleep(0.1)
