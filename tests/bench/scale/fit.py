"""From runs to a cost per vehicle, and from that to the size at which something is full."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tests.bench.scale.study import Run


class Line(NamedTuple):
    """``fixed + each * vehicles``."""

    fixed: float
    each: float
    worst: float
    """the largest miss of a measured point, as a share of that point"""

    def at(self, vehicles: float) -> float:
        return self.fixed + self.each * vehicles

    def reaches(self, limit: float) -> float:
        """Vehicles at which it reaches ``limit``; infinite where it does not grow."""
        return (limit - self.fixed) / self.each if self.each > 0.0 else float("inf")


class Curve(NamedTuple):
    """``at (vehicles / where) ** power``: through the two largest runs, for what is no line."""

    where: float
    there: float
    power: float

    def reaches(self, limit: float) -> float:
        """Vehicles at which it reaches ``limit``; infinite where it does not grow."""
        return self.where * (limit / self.there) ** (1.0 / self.power) if self.power > 0.0 else math.inf


class Cost(NamedTuple):
    """Something that a run measures, in words."""

    name: str
    unit: str
    scale: float
    """from the run's unit to ``unit``"""
    of: Callable[[Run], float | None]


COSTS = (
    Cost("re-sync of a link", "kB", 1e-3, lambda run: run.sync_bytes),
    Cost("CPU of a router that learns of all", "s", 1.0, lambda run: run.sync_cpu),
    Cost("idle link", "kB/s", 1e-3, lambda run: run.idle_rate),
    Cost("link to a ground station", "kB/s", 1e-3, lambda run: run.trunk_rate),
    Cost("memory of a router without vehicles", "MB", 1e-6, lambda run: run.rss_ground),
    Cost("CPU of the ground's router", "%", 100.0, lambda run: run.relay_cpu),
    Cost("CPU of the ground station", "%", 100.0, lambda run: run.station_cpu),
    Cost("query of every state", "ms", 1e3, lambda run: run.ask),
    Cost("query of every token", "ms", 1e3, lambda run: run.history),
    Cost("order and answer", "ms", 1e3, lambda run: run.ping),
)


class Limit(NamedTuple):
    """A resource that fills up."""

    what: str
    cost: str
    full: float
    """in the cost's unit"""


LIMITS = (
    Limit("radio of 60 kB/s carries all states to a ground station", "link to a ground station", 60.0),
    Limit("radio of 1 Mbit/s carries them", "link to a ground station", 125.0),
    Limit("radio of 60 kB/s re-syncs within 10 s, with nothing else on it", "re-sync of a link", 600.0),
    Limit("radio of 10 Mbit/s carries all states", "link to a ground station", 1250.0),
    Limit("ground station's one core", "CPU of the ground station", 100.0),
    Limit("ground's router's one core", "CPU of the ground's router", 100.0),
    Limit("router in 256 MB", "memory of a router without vehicles", 256.0),
)
STRAIGHT = 0.25
"""a line that misses a measured point by more is none"""
SYSTEM_IDS = 255
"""MAVLink's: two vehicles of one fleet with the same one are a clash, and refuse orders"""


def fit(runs: Sequence[Run], cost: Cost) -> Line | None:
    """The straight line with the least relative misses (a few vehicles weigh as much as many); None: too few runs."""
    points = _points(runs, cost)
    if len({vehicles for vehicles, _ in points}) < 2:
        return None
    n, y = np.array([p[0] for p in points], float), np.array([p[1] for p in points], float)
    weight = 1.0 / np.maximum(np.abs(y), 1e-9)
    columns = np.stack([np.ones_like(n), n], axis=1)
    (fixed, each), *_ = np.linalg.lstsq(columns * weight[:, None], y * weight, rcond=None)
    missed = np.abs(columns @ np.array([fixed, each]) - y) * weight
    return Line(float(fixed), float(each), float(missed.max()))


def bend(runs: Sequence[Run], cost: Cost) -> Curve | None:
    """The curve through the two largest fleets; None: too few runs."""
    points = sorted({n: y for n, y in _points(runs, cost) if y > 0.0}.items())[-2:]
    if len(points) < 2:
        return None
    (n, y), (where, there) = points
    return Curve(where, there, math.log(there / y) / math.log(where / n))


def _points(runs: Sequence[Run], cost: Cost) -> list[tuple[int, float]]:
    return [(run.shape.vehicles, value * cost.scale) for run in runs if (value := cost.of(run)) is not None]
