"""Speaks with the processes of a study in lines of JSON."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

from zmav.children import Children
from zmav.errors import ZmavError

PATIENCE = 180.0
"""s for a process to answer on a busy machine"""
LINK = "?rel=1;mixed_rel=1"


class Child:
    """One process that answers lines of JSON. :meth:`tell` and :meth:`hear` apart let many work side by side."""

    def __init__(self, children: Children, name: str, module: str, how: dict[str, Any]) -> None:
        self._children = children
        self._process = children.start(name, json.dumps(how), module=module, pipes=True)

    def tell(self, verb: str, **more: Any) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # hear() says what became of it
            self._process.stdin.write(json.dumps({"do": verb, **more}).encode() + b"\n")

    def hear(self) -> dict[str, Any]:
        """The next answer; raises :class:`ZmavError` with its last words where it has died."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            self._children.check()
        answer: dict[str, Any] = json.loads(line)
        return answer

    def ask(self, verb: str, **more: Any) -> dict[str, Any]:
        self.tell(verb, **more)
        return self.hear()


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
