"""How far an order is, on standard error, while it is waited for."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from zmav.process import say

EVERY = 2.0
"""s between two lines for one order; the first comes as late"""
WORDS: dict[str, Callable[[Any], str]] = {
    "away": lambda metres: f"{metres:.0f} m to go",
    "alt_rel": lambda metres: f"at {metres:.1f} m",
    "waiting_for": lambda reasons: f"waits: {', '.join(reasons)}",
    "refused": lambda why: f"refused: {why}; asked again",
}
"""what orders report, in words (:mod:`zmav.services.orders.flight`); anything else stands as it is"""


class Progress:
    """Is told what an order reports of itself."""

    def __init__(self, vehicle: str, verb: str) -> None:
        self._who, self._last = f"{vehicle}: {verb}", time.monotonic()

    def __call__(self, news: dict[str, Any]) -> None:
        now = time.monotonic()
        if news and now - self._last >= EVERY:
            self._last = now
            words = (WORDS[name](value) if name in WORDS else f"{name} {value}" for name, value in news.items())
            say(f"{self._who}: {', '.join(words)}")
