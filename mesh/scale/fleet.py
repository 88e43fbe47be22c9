"""Starts the processes of a study, speaks with them and ends them all."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

from zmav.errors import ZmavError

PATIENCE = 180.0
"""s for a process to answer on a busy machine"""
LINK = "?rel=1;mixed_rel=1"


class Child:
    """One process that answers lines of JSON. :meth:`tell` and :meth:`hear` apart let many work side by side."""

    def __init__(self, name: str, module: str, how: dict[str, Any]) -> None:
        self.name = name
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  # closed in close()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, json.dumps(how)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            text=True,
        )

    def tell(self, verb: str, **more: Any) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # hear() says what became of it
            self._process.stdin.write(json.dumps({"do": verb, **more}) + "\n")
            self._process.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """The next answer; raises :class:`ZmavError` with its last words where it has died."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            self._said.seek(0)
            words = self._said.read().decode("utf-8", "replace")[-2000:]
            raise ZmavError(f"{self.name} ended with {code}; it said last:\n{words}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def ask(self, verb: str, **more: Any) -> dict[str, Any]:
        self.tell(verb, **more)
        return self.hear()

    def end(self) -> None:
        """It ends with its input."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()

    def close(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(20.0)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._said.close()


class Children:
    """``with Children() as children``: whatever happens, none of them is left."""

    def __init__(self) -> None:
        self._all: list[Child] = []

    def __enter__(self) -> Children:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        for child in reversed(self._all):
            child.end()
        for child in self._all:
            child.close()

    def start(self, name: str, module: str, how: dict[str, Any]) -> Child:
        self._all.append(Child(name, module, how))
        return self._all[-1]


def ask_all(children: Sequence[Child], verb: str, **more: Any) -> list[dict[str, Any]]:
    """The answers of many that work side by side."""
    for child in children:
        child.tell(verb, **more)
    return [child.hear() for child in children]


def until(true: Callable[[], bool], what: str, every: float = 0.1) -> float:
    """Seconds until ``true()``; raises :class:`ZmavError` after :data:`PATIENCE`."""
    start = time.monotonic()
    while not true():
        if time.monotonic() - start > PATIENCE:
            raise ZmavError(f"after {PATIENCE:.0f} s still not: {what}")
        time.sleep(every)
    return time.monotonic() - start
