"""How far vehicles are with what they were asked, on standard error: one line on a terminal, else one now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import click

from zmav.cli.common import size
from zmav.process import say

EVERY = 2.0
"""s between two lines for one vehicle where there is no terminal; the first comes as late"""
WIDTH = 110
COUNTS = (("done", "of"), ("received", "count"), ("current", "total"))
WORDS: dict[str, Callable[[Any], str]] = {
    "stage": lambda stage: "autopilot -> vehicle" if stage == "autopilot" else "vehicle <-> here",
    "kind": str,
    "phase": str,
    "away": lambda metres: f"{metres:.0f} m to go",
    "alt_rel": lambda metres: f"at {metres:.1f} m",
    "waiting_for": lambda what: f"waits: {what if isinstance(what, str) else ', '.join(what)}",
    "refused": lambda why: f"refused: {why}; asked again",
    "checking": lambda checking: "the autopilot takes the checksum",
    "bytes": size,
    "rate": lambda rate: f"{size(rate)}/s",
}
"""what orders report, in words; anything else stands as it is"""


def words(news: dict[str, Any]) -> str:
    """What an order reports of itself (:mod:`zmav.services`)."""
    left = {name: value for name, value in news.items() if value is not None}
    found = []
    for done, of in COUNTS:
        if done in left:
            found.append(f"{left.pop(done)}/{left.pop(of, '?')}")
    whole = left.pop("size", None)
    if whole and "bytes" in left:
        found.append(f"{left['bytes'] / whole:.0%}")
    return ", ".join(
        [WORDS[name](value) if name in WORDS else f"{name} {value}" for name, value in left.items()] + found
    )


class Progress:
    """``with Progress("goto") as progress``: :meth:`tell` it what vehicles report. ``quiet``: nobody is to be told."""

    def __init__(self, what: str, quiet: bool = False) -> None:
        self._what, self._quiet = what, quiet
        self._began = time.monotonic()
        self._last: dict[str, float] = {}
        self._lines: dict[str, str] = {}

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def tell(self, vehicle: str, news: dict[str, Any]) -> None:
        if self._quiet or not news:
            return
        self._lines[vehicle] = f"{vehicle}: {words(news)}"
        if sys.stderr.isatty():
            self._rewrite(f"{self._what}: {'; '.join(self._lines.values())}"[:WIDTH])
            return
        now = time.monotonic()
        if now - self._last.get(vehicle, self._began) >= EVERY:
            self._last[vehicle] = now
            say(f"{vehicle}: {self._what}: {words(news)}")

    def clear(self) -> None:
        """End the line on the terminal, before something else is said."""
        if self._lines and sys.stderr.isatty():
            self._rewrite("")

    @staticmethod
    def _rewrite(text: str) -> None:
        click.echo(f"\r\x1b[K{text}", nl=False, err=True)
