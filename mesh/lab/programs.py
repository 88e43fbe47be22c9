"""The programs of a lab: each in its host's namespace, with a log, watched, and able to die on purpose."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mesh.lab.network import LabError, Network, exit_of

PATIENCE_S = 10.0
_TAIL = 2000


class Program:
    """One program that is to run as long as the lab does; raises :class:`LabError` where it cannot be started."""

    def __init__(
        self, network: Network, name: str, host: str | None, command: Sequence[str], log: Path, env: Mapping[str, str]
    ) -> None:
        self.name, self.host, self.log, self._command = name, host, log, list(command)
        self._network, self._env = network, {**os.environ, **env}
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: Callable[[Program, int], None] | None = None
        self._watch: asyncio.Task[None] | None = None

    def start(self, ended: Callable[[Program, int], None]) -> None:
        """Start it; ``ended`` is called with its code when it ends without having been told to. On the event loop."""
        if self.running:
            raise LabError(f"{self.name} runs already")
        with self.log.open("ab") as log:
            try:
                self._process = self._network.popen(self.host, self._command, stdout=log, stderr=log, env=self._env)
            except OSError as e:
                raise LabError(f"cannot start {self.name}: {e}") from e
        self._ended = ended
        self._watch = asyncio.ensure_future(self._wait(self._process))

    async def _wait(self, process: subprocess.Popen[bytes]) -> None:
        code = await exit_of(process)
        if self._ended is not None:
            self._ended(self, code)

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process is not None and self.running else None

    async def stop(self, signal_number: int = signal.SIGTERM) -> int | None:
        """Have it end; killed when it does not within :data:`PATIENCE_S`. Gives its code, None if it never ran."""
        self._ended = None
        process = self._process
        if process is None:
            return None
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal_number)
        try:
            await asyncio.wait_for(asyncio.shield(exit_of(process)), PATIENCE_S)
        except asyncio.TimeoutError:
            process.kill()
            await exit_of(process)
        if self._watch is not None:
            await self._watch
        return process.returncode

    def said(self) -> str:
        """The end of its log."""
        try:
            data = self.log.read_bytes()
        except OSError:
            return ""
        return data[-_TAIL:].decode(errors="replace")
