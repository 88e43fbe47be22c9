"""How far a transfer is, said a few times a second."""

from __future__ import annotations

import time
from typing import Any

from zmav.services.orders.orders import Report

EVERY = 0.2
"""s between two reports"""


class Meter:
    """Counts bytes into a report of ``bytes``, ``size`` (None: not known) and ``rate`` in bytes/s.

    ``have``: what was there already, and is no merit of this transfer's rate.
    """

    def __init__(self, report: Report, size: int | None, have: int = 0) -> None:
        self._report, self.size = report, size
        self._bytes, self._have = have, have
        self._began = time.monotonic()
        self._said = 0.0

    def add(self, count: int) -> None:
        self._bytes += count
        now = time.monotonic()
        if now - self._said >= EVERY:
            self._said = now
            self._report(self.result())

    @property
    def rate(self) -> float:
        """Bytes a second since the start."""
        return (self._bytes - self._have) / max(time.monotonic() - self._began, 1e-6)

    def result(self) -> dict[str, Any]:
        return {"bytes": self._bytes, "size": self.size, "rate": round(self.rate)}
