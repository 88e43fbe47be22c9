"""The first plan: straight lines at separate heights.

Each vehicle climbs to a height of its own, flies a straight line to its goal and lands from there; lines may cross, for
no two vehicles share a height while they move. The planner that finds its way among obstacles is a later one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

from zmav.errors import BadInput
from zmav.wire import Vector


@dataclass(frozen=True)
class Line:
    """A straight move from rest to rest, with a trapezoid of speed: m, m/s, m/s², NED."""

    start: Vector
    goal: Vector
    speed: float = 4.0
    acceleration: float = 1.5

    @property
    def length(self) -> float:
        return math.dist(self.start, self.goal)

    @property
    def duration(self) -> float:
        """Seconds from rest to rest."""
        ramp = self._ramp
        return 2.0 * ramp + (self.length - self.acceleration * ramp**2) / self.speed

    @property
    def _ramp(self) -> float:
        """Seconds of speeding up: until the speed is reached, or half-way on a short line."""
        return min(self.speed / self.acceleration, math.sqrt(self.length / self.acceleration))

    def at(self, t: float) -> Vector:
        """The point at ``t`` seconds: the start before, the goal after."""
        if t >= self.duration:
            return self.goal
        if t <= 0.0:
            return self.start
        ramp, a = self._ramp, self.acceleration
        rest = self.duration - t
        if t < ramp:
            gone = a * t**2 / 2.0
        elif rest < ramp:
            gone = self.length - a * rest**2 / 2.0
        else:
            gone = a * ramp**2 / 2.0 + a * ramp * (t - ramp)
        n, e, d = (p + (q - p) * gone / self.length for p, q in zip(self.start, self.goal, strict=True))
        return (n, e, d)


@dataclass(frozen=True)
class Route:
    """One vehicle's plan: ``height`` in metres above its home, and the line it flies there."""

    height: float
    line: Line


def rotate(
    starts: Mapping[str, Vector], lowest: float = 6.0, spacing: float = 3.0, apart: float = 2.0
) -> dict[str, Route]:
    """Everyone to the next one's place (two vehicles swap): NED starts on the ground in, routes out.

    Each line is level, ``spacing`` metres above the one before; the first is ``lowest`` metres above the highest start.
    Raises :class:`BadInput` for fewer than two vehicles, and for starts that are no places or less than ``apart``
    metres from each other, for there vehicles would meet while they climb.
    """
    names = list(starts)
    if len(names) < 2:
        raise BadInput("a swap needs two vehicles or more", field="vehicles", value=names, expected="two names")
    for name, start in starts.items():
        if not all(map(math.isfinite, start)):
            raise BadInput(f"{name} starts at {start}, which is no place", field=name, value=list(start))
    for one, other in itertools.combinations(names, 2):
        distance = math.dist(starts[one][:2], starts[other][:2])
        if distance < apart:
            text = f"{one} and {other} start {distance:.1f} m apart: they would meet while they climb"
            raise BadInput(text, field=one, value=distance, expected=f"{apart} m")
    highest = min(down for _, _, down in starts.values())
    routes = {}
    for i, name in enumerate(names):
        level = highest - lowest - i * spacing
        north, east, down = starts[name]
        goal = starts[names[(i + 1) % len(names)]]
        routes[name] = Route(down - level, Line((north, east, level), (goal[0], goal[1], level)))
    return routes
