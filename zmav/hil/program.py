"""A flight stack's program: started in a directory of its own, watched, and ended with the simulator."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path

from zmav import guard
from zmav.errors import BadConfig

LOG = "output.log"
LAST_LINES, LAST_BYTES = 10, 4096


class Program:
    """``command`` run in ``directory``, with ``extra`` in its environment; what it says goes to ``output.log`` there.

    It is a process group of its own, so that a Ctrl-C at the terminal reaches the simulator alone, and it is killed by
    the kernel when the thread that started it ends: one that does nothing else than wait for it. Raises
    :class:`BadConfig` where it cannot be started.
    """

    def __init__(self, command: Sequence[str], directory: Path, extra: Mapping[str, str]) -> None:
        self.command = list(command)
        self.log = directory / LOG
        started: Future[subprocess.Popen[bytes]] = Future()
        keeper = threading.Thread(
            target=self._keep, args=(directory, extra, started), name="zmav-sim-program", daemon=True
        )
        keeper.start()
        try:
            self._process = started.result()
        except OSError as error:
            text = f"{command[0]} cannot be started in {directory}: {error.strerror}"
            raise BadConfig(text, field="program", value=command[0], expected="a program that runs") from error

    def _keep(self, directory: Path, extra: Mapping[str, str], started: Future[subprocess.Popen[bytes]]) -> None:
        """Start it, and stay until it has ended."""
        keep = [sys.executable, "-I", "-S", guard.__file__, str(os.getpid())]
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with self.log.open("wb") as log:
                process = subprocess.Popen(
                    [*keep, *self.command],
                    cwd=directory,
                    env={**os.environ, **extra},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
        except Exception as error:
            started.set_exception(error)
            return
        started.set_result(process)
        process.wait()

    @property
    def pid(self) -> int:
        return self._process.pid

    def ended(self) -> str | None:
        """How it ended; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"

    def last_lines(self) -> str:
        """The end of what it said."""
        try:
            with self.log.open("rb") as log:
                log.seek(max(self.log.stat().st_size - LAST_BYTES, 0))
                text = log.read().decode("utf-8", "replace")
        except OSError:
            return ""
        return "\n".join(text.splitlines()[-LAST_LINES:])

    def ask(self) -> None:
        """Ask it, and what it started, to end."""
        self._signal(signal.SIGTERM)

    def stop(self, grace_s: float) -> None:
        """Kill it unless it ends within that time; returns when it has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(grace_s)
        self._signal(signal.SIGKILL)  # whatever of its group is left
        self._process.wait()

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)
