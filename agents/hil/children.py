"""``zmav`` verbs as processes beside us: each with its log, all of them gone when we are, however we end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType

import zmav
from zmav.errors import ZmavError
from zmav.hil import guard
from zmav.trust.credentials import VARIABLE

GRACE_S = 5.0
"""s to end in good order"""
WATCH_S = 0.2


class Children:
    """``async with Children() as children``: they end with it, the last one started first.

    They are out of the terminal's reach (a Ctrl-C is ours to act on while they still work), without credentials, and
    the kernel ends them where we are killed. ``folder`` is for their files; it goes with them.
    """

    def __init__(self) -> None:
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._scratch = tempfile.TemporaryDirectory(prefix="zmav-hil-")
        self.folder = Path(self._scratch.name)

    async def __aenter__(self) -> Children:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        for name in reversed(list(self._running)):
            self._end(name)
        self._scratch.cleanup()

    def start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start ``zmav ARGUMENTS`` under a name."""
        keep = [sys.executable, "-I", "-S", guard.__file__, str(os.getpid())]
        with self._log(name).open("wb") as log:
            self._running[name] = subprocess.Popen(
                [*keep, sys.executable, "-m", "zmav", *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env={each: value for each, value in os.environ.items() if each != VARIABLE}, start_new_session=True,
            )  # fmt: skip
        return self._running[name]

    async def stop(self, name: str) -> None:
        """End one of them now."""
        await asyncio.to_thread(self._end, name)

    def kill(self, name: str) -> None:
        """Without a chance to say anything, as a crash does."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def _end(self, name: str) -> None:
        process = self._running.pop(name)
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(GRACE_S)
        if process.poll() is None:
            process.kill()
            process.wait()

    def check(self) -> None:
        """Raise where one has ended, with the last it said."""
        for name, process in self._running.items():
            if process.poll() is not None:
                raise ZmavError(f"{name} has ended ({process.returncode}); it said last:\n{self.said(name)}")

    async def watch(self) -> None:
        """Until one of them has ended: raises."""
        while True:
            self.check()
            await asyncio.sleep(WATCH_S)

    def said(self, name: str, lines: int = 8) -> str:
        """The end of its log."""
        return "\n".join(self._log(name).read_text("utf-8", "replace").splitlines()[-lines:])

    def _log(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    async def connect(self, stack: contextlib.AsyncExitStack, fleet: str, endpoint: str) -> zmav.Client:
        """A client of a router that one of them runs, once it is up."""
        return await zmav.client.connect_once_up(stack, fleet, endpoint, self.check)
