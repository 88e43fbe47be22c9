"""Room that is spoken for: where the vehicles of each running goal may be at any time until it ends.

Two goals fly at the same time only where their ways stay clear of each other whatever the clocks do: what is planned
again keeps out of everything that is spoken for, as if it were walls. So a goal may be slowed, paused or planned again
without a look at the others. ENU metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from agents.planner.model import scene
from agents.planner.model.problem import Floats

PIECE = 2.5
"""m of a way that one box holds at most"""


@dataclass(frozen=True)
class Tube:
    """Boxes that hold a vehicle's centre: (K, 6) least and greatest x, y, z; and the room it needs around it."""

    boxes: Floats
    radius: float


def tube(path: npt.ArrayLike, radius: float) -> Tube:
    """Around (K, 3) points joined by straight lines."""
    dense = _dense(np.atleast_2d(np.asarray(path, dtype=np.float64)))
    pieces = [dense[i : i + 3] for i in range(0, max(1, len(dense) - 1), 2)]
    return Tube(np.array([[*each.min(axis=0), *each.max(axis=0)] for each in pieces]), radius)


def _dense(points: Floats) -> Floats:
    """With more points in between, so that no piece is longer than a box may be."""
    rows = [points[:1]]
    for one, other in itertools.pairwise(points):
        count = max(1, int(np.ceil(np.linalg.norm(other - one) / (PIECE / 2.0))))
        rows.append(one + (other - one) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(rows)


class ReservedAirspace:
    """What each goal has spoken for, by vehicle."""

    def __init__(self) -> None:
        self._held: dict[str, dict[str, list[Tube]]] = {}

    def hold(self, goal: str, volumes: Mapping[str, Iterable[Tube]]) -> None:
        """From now on, in place of what the goal held for these vehicles before."""
        held = self._held.setdefault(goal, {})
        for vehicle, each in volumes.items():
            held[vehicle] = list(each)

    def drop(self, goal: str) -> dict[str, list[Tube]]:
        """It needs no room any more; what it held."""
        return self._held.pop(goal, {})

    def others(self, but: Collection[str]) -> list[tuple[str, str, Tube]]:
        """(goal, vehicle, tube) of all goals but these."""
        return [
            (name, vehicle, each)
            for name, held in self._held.items()
            if name not in but
            for vehicle, volumes in held.items()
            for each in volumes
        ]

    def vehicles(self, but: Collection[str] = ()) -> set[str]:
        """Anyone who holds any, in other goals than ``but``."""
        return {vehicle for name, held in self._held.items() if name not in but for vehicle in held}

    def walls(self, but: Collection[str], downwash: float) -> list[scene.Obstacle]:
        """The volumes of the other goals as boxes to keep out of: a centre stays its own radius away from each."""
        found: list[scene.Obstacle] = []
        for goal, vehicle, each in self.others(but):
            r, up = each.radius, each.radius * downwash
            for x0, y0, z0, x1, y1, z1 in each.boxes.tolist():
                name = f"the way of {vehicle} in {goal}"
                found.append(scene.Box(min=(x0 - r, y0 - r, z0 - up), max=(x1 + r, y1 + r, z1 + up), name=name))
        return found

    def blocker(self, but: Collection[str], wanted: Mapping[str, Iterable[Tube]], downwash: float) -> str:
        """Which other goal's volumes are not clear of these; empty: none."""
        for name, _, other in self.others(but):
            for volumes in wanted.values():
                if any(meet(each, other, downwash) for each in volumes):
                    return name
        return ""


def meet(one: Tube, other: Tube, downwash: float) -> bool:
    """Two vehicles somewhere in these may come nearer to each other than their radii allow."""
    room = (one.radius + other.radius) * np.array([1.0, 1.0, downwash])
    low, high = one.boxes[:, None, :3] - room, one.boxes[:, None, 3:] + room
    return bool(np.any(np.all((low < other.boxes[None, :, 3:]) & (high > other.boxes[None, :, :3]), axis=2)))
