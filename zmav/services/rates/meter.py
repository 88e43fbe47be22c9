"""What flows on the link, measured from counters once a second: nothing is decoded for it."""

from __future__ import annotations

import collections
import time
from typing import NamedTuple

from zmav.services.link.port import Flow, Port

WINDOW = 5
"""samples a rate is measured over, a second apart"""
Kind = tuple[str, int, int]
"""A message's name, and the system and component it comes from"""


class Measured(NamedTuple):
    """A kind of message: its rates over the window, its sums, and its age in seconds."""

    hz: float
    bytes_rate: float
    total: int
    size: float
    """mean bytes a frame"""
    age: float
    span: float
    """s that the rates were measured over; 0: only just heard of"""


class Meter:
    """Samples a port's counters. Lives on the event loop."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._samples: collections.deque[tuple[float, dict[Kind, Flow]]] = collections.deque(maxlen=WINDOW + 1)

    def tick(self) -> None:
        """Once a second."""
        flows = {(f.name, f.sysid, f.compid): f for f in self._port.flows()}
        self._samples.append((time.monotonic(), flows))

    def measured(self) -> dict[Kind, Measured]:
        """Every kind heard so far."""
        if not self._samples:
            return {}
        then, flows = self._samples[-1]
        return {kind: self._rate(kind, flow, then) for kind, flow in flows.items()}

    def measure(self, kind: Kind) -> Measured | None:
        """One kind; None: not heard so far."""
        then, flows = self._samples[-1] if self._samples else (0.0, {})
        return self._rate(kind, flows[kind], then) if kind in flows else None

    def _rate(self, kind: Kind, flow: Flow, then: float) -> Measured:
        """Over the samples since it was first seen."""
        start, first = then, flow
        for at, flows in tuple(self._samples):  # it grows meanwhile, where this is not the event loop
            if kind in flows:
                start, first = at, flows[kind]
                break
        span = then - start
        count, size = flow.total - first.total, flow.size - first.size
        hz, rate = (count / span, size / span) if span > 0 else (0.0, 0.0)
        mean = size / count if count else flow.size / max(flow.total, 1)  # a stream just begun has none yet
        return Measured(hz, rate, flow.total, mean, time.monotonic() - flow.heard, span)

    @property
    def used(self) -> float:
        """Bytes a second in whole frames, of every source."""
        return sum(m.bytes_rate for m in self.measured().values())
