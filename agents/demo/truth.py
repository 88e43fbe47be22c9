"""Where everybody truly is in a demo, by its simulator: for distances, and for the picture of the tracks."""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from zmav.errors import ZmavError
from zmav.sim import Remote

EVERY = 0.2
"""s between two looks"""


class Row(NamedTuple):
    """A moment (s since the beginning) and everybody's place: north, east and up, m in the world."""

    t: float
    places: tuple[tuple[float, float, float], ...]


class Truth:
    """What the simulator says of its vehicles, from ``with truth.watching(control)`` on."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        self.rows: list[Row] = []
        self.begun = time.monotonic()
        self.closest, self.pair, self.closest_at = math.inf, ("", ""), 0.0
        self._stop = threading.Event()

    @contextlib.contextmanager
    def watching(self, control: Path) -> Iterator[None]:
        thread = threading.Thread(target=self._watch, args=(control,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _watch(self, control: Path) -> None:
        with contextlib.suppress(ZmavError), Remote(control) as sim:  # it may end before us
            while not self._stop.wait(EVERY):
                by_name = {vehicle.name: vehicle.ned_m for vehicle in sim.status().vehicles}
                self.take(tuple((n, e, -d) for n, e, d in (by_name[name] for name in self.names)))

    def take(self, places: tuple[tuple[float, float, float], ...]) -> None:
        now = time.monotonic() - self.begun
        self.rows.append(Row(now, places))
        for (a, one), (b, other) in itertools.combinations(zip(self.names, places, strict=True), 2):
            if (apart := math.dist(one, other)) < self.closest:
                self.closest, self.pair, self.closest_at = apart, (a, b), now

    def flown(self, name: str) -> float:
        """m along its track."""
        i = self.names.index(name)
        return sum(math.dist(a.places[i], b.places[i]) for a, b in itertools.pairwise(self.rows))

    def highest(self, name: str) -> float:
        """m above the world's origin."""
        i = self.names.index(name)
        return max((row.places[i][2] for row in self.rows), default=0.0)
