"""The world as it is told at run time: obstacles, no-fly polygons, the geofence; and what a scene needs of it.

On the wire everything is NED about the fleet's origin, heights are metres above it; a scene is ENU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from agents.planner.live.checks import MOST_OBSTACLES
from agents.planner.live.frames import enu
from agents.planner.model import scene
from agents.planner.model.problem import MovingObstacle
from zmav import geo
from zmav.errors import BadInput
from zmav.wire import Vector, swarm

AROUND = 60.0
"""m that bounds reach beyond all that is to be planned for, where no geofence says otherwise"""
ABOVE = 60.0
SKIRT = 0.5
"""m by which vehicles may be below the lowest place they are asked to be at: they drift"""
AHEAD = 120.0
"""s for which what moves is taken to go on as it does"""
LATE = 60.0
"""s for which a message may have been on its way: so long what is gone does not come back by an older word. No longer:
a program whose clock was set back is believed again"""


@dataclass
class KnownObstacle:
    obstacle: swarm.Obstacle
    until: float | None
    """monotonic seconds at which it is forgotten"""


class Passing(NamedTuple):
    """An aircraft that is not of the fleet: a ball, and m by which that grows until the aircraft is heard again."""

    obstacle: swarm.Obstacle
    grows: float


@dataclass(frozen=True)
class Pieces:
    """What a scene is put together from; ENU metres."""

    obstacles: tuple[scene.Obstacle, ...] = ()
    geofence: scene.Fence | None = None
    movers: tuple[MovingObstacle, ...] = field(default_factory=tuple)
    """on the clock of the plan: from now"""

    def bounds(self, points: Sequence[Vector]) -> scene.Bounds:
        """Room around these places (ENU): as far as the fence, or a good way beyond all of them and the obstacles."""
        corners = np.array([*points, *self._corners(points)], dtype=np.float64).reshape(-1, 3)
        low, high = corners.min(axis=0) - AROUND, corners.max(axis=0) + AROUND
        floor = min(p[2] for p in points) - SKIRT if points else 0.0
        top = float(corners[:, 2].max()) + ABOVE
        if self.geofence is not None:
            ring = np.array(self.geofence.polygon, dtype=np.float64)
            low[:2], high[:2] = ring.min(axis=0), ring.max(axis=0)
            top = min(top, self.geofence.ceiling)
        x, y, _ = map(float, high)
        return scene.Bounds(min=(float(low[0]), float(low[1]), floor), max=(x, y, max(top, floor + 1.0)))

    def _corners(self, points: Sequence[Vector]) -> list[Vector]:
        """Of the obstacles that stand between the places or near them: a way around has to fit in, too."""
        if not points:
            return []
        near = np.array(points, dtype=np.float64)
        low, high = near.min(axis=0)[:2] - 2 * AROUND, near.max(axis=0)[:2] + 2 * AROUND
        found: list[Vector] = []
        for obstacle in self.obstacles:
            first, last = scene.extent_of(obstacle)
            if first[0] < high[0] and last[0] > low[0] and first[1] < high[1] and last[1] > low[1]:
                found += [
                    (max(first[0], low[0]), max(first[1], low[1]), near[0, 2]),
                    (min(last[0], high[0]), min(last[1], high[1]), min(last[2], float(near[:, 2].max()) + ABOVE)),
                ]
        return found


class World:
    """What the planner was told, by name. ``now`` is in monotonic seconds, ``t`` in UTC seconds."""

    def __init__(self) -> None:
        self._told: dict[str, KnownObstacle] = {}
        self._gone: dict[str, tuple[float, float]] = {}
        """by the name of what is gone: the ``t`` from which on a word of it holds, and until when no older one does"""
        self.fence: swarm.Obstacle | None = None
        """the fleet file's geofence: it holds again where another one is gone"""
        self.revision = 0
        """counts the changes"""
        self.traffic: list[Passing] = []
        """aircraft that are not of the fleet, as they are now: balls; no change in the world, for it is flown with what
        moves as it comes"""

    @property
    def obstacles(self) -> list[swarm.Obstacle]:
        return [told.obstacle for _, told in sorted(self._told.items())]

    def give(self, obstacle: swarm.Obstacle, now: float) -> bool:
        """Something is there, has moved or is gone; True where that is news.

        There is one fence: the newest one given. Raises :class:`BadInput` where there are too many.
        """
        name, what = obstacle.name, obstacle.what
        before = self._told.get(name)
        if before is not None and obstacle.t < before.obstacle.t:
            return False  # overtaken on the way
        if name in self._gone and obstacle.t < self._gone[name][0] and now < self._gone[name][1]:
            return False
        if what is None:
            return self._drop(name, obstacle.t, now, ordered=True)
        if before is None and len(self._told) >= MOST_OBSTACLES:
            text = f"{MOST_OBSTACLES} obstacles are known, and that is all there is room for; remove some"
            raise BadInput(text, field="obstacle", value=name, expected=f"at most {MOST_OBSTACLES}")
        if isinstance(what, swarm.Geofence):
            others = {n: told.obstacle.t for n, told in self._told.items() if n != name and _is_fence(told)}
            if any(obstacle.t < t < obstacle.t + LATE for t in others.values()):
                return False  # it was to be replaced by the one that has overtaken it
            for other in others:
                del self._told[other]
                self._forget(other, obstacle.t, now, over=True)
        elif before is not None and _is_fence(before):
            self._restore(before)
        self._told[name] = KnownObstacle(obstacle, None if obstacle.ttl is None else now + obstacle.ttl)
        if before is not None and before.obstacle.what == what:
            return False
        self.revision += 1
        return True

    def expire(self, now: float) -> None:
        """Forget what was not said again in time."""
        for name, told in list(self._told.items()):
            if told.until is not None and told.until <= now:
                self._drop(name, told.obstacle.t, now)
        self._gone = {name: (t, until) for name, (t, until) in self._gone.items() if now < until}

    def follow(self, obstacles: list[swarm.Obstacle], now: float, t: float) -> None:
        """Know what another planner knows: no more, and what is to be forgotten as late as it does."""
        for name in set(self._told) - {each.name for each in obstacles}:
            self._forget(name, self._told.pop(name).obstacle.t, now)
            self.revision += 1
        for obstacle in obstacles:
            left = None if obstacle.ttl is None else max(0.1, obstacle.t + obstacle.ttl - t)
            if self._told.get(obstacle.name) is None or self._told[obstacle.name].obstacle != obstacle:
                self._told[obstacle.name] = KnownObstacle(obstacle, None if left is None else now + left)
                self.revision += 1

    def _drop(self, name: str, t: float, now: float, ordered: bool = False) -> bool:
        """By a word of ``t``. ``ordered``: somebody took it away by its name, the fleet file's fence too."""
        gone = self._told.pop(name, None)
        self._forget(name, t, now, over=ordered)
        if gone is None:
            return False
        self.revision += 1
        if not (ordered and self.fence is not None and name == self.fence.name):
            self._restore(gone)
        return True

    def _forget(self, name: str, t: float, now: float, over: bool = False) -> None:
        """It is gone by a word of ``t``. ``over``: a word of that very ``t`` does not bring it back; else it does, for
        a program says what stands still again as it was.
        """
        self._gone.pop(name, None)
        self._gone[name] = math.nextafter(t, math.inf) if over else t, now + LATE
        if len(self._gone) > MOST_OBSTACLES:
            del self._gone[next(iter(self._gone))]

    def _restore(self, gone: KnownObstacle) -> None:
        """The fleet file's fence, where that one was a fence."""
        if self.fence is not None and _is_fence(gone):
            self._told[self.fence.name] = KnownObstacle(self.fence, None)

    def find(self, name: str) -> swarm.Obstacle | None:
        told = self._told.get(name)
        return told.obstacle if told else None

    def pieces(self, t: float, lasting: bool = False) -> Pieces:
        """The world at UTC ``t``, for a scene. ``lasting``: with aircraft as large as they grow until they are heard
        again, for what is to be flown among them: a plan just clear of one would be stopped before.
        """
        still: list[scene.Obstacle] = []
        movers: list[MovingObstacle] = []
        fence: scene.Fence | None = None
        for obstacle in self.obstacles:
            what = obstacle.what
            if isinstance(what, swarm.Geofence):
                fence = scene.Fence(polygon=[_corner(c) for c in what.polygon], floor=what.floor, ceiling=what.ceiling)
            elif isinstance(what, swarm.Ball) and any(what.velocity):
                movers.append(_mover(obstacle.name, what, t - obstacle.t))
            elif what is not None:
                still.append(_still(obstacle.name, what))
        for obstacle, grows in self.traffic:
            assert isinstance(obstacle.what, swarm.Ball)
            mover = _mover(obstacle.name, obstacle.what, t - obstacle.t)
            movers.append(replace(mover, radius=mover.radius + grows * lasting))
        return Pieces(tuple(still), fence, tuple(movers))

    def ball(self, name: str, t: float) -> tuple[Vector, Vector] | None:
        """Place (NED, at UTC ``t``) and velocity of what moves or stands under that name; None: no such."""
        obstacle = self.find(name)
        if obstacle is None or not isinstance(obstacle.what, swarm.Ball):
            return None
        what = obstacle.what
        return geo.plus(what.center, what.velocity, t - obstacle.t), what.velocity


def _is_fence(told: KnownObstacle) -> bool:
    return isinstance(told.obstacle.what, swarm.Geofence)


def _corner(corner: swarm.Corner) -> scene.Corner:
    north, east = corner
    return (east, north)


def _still(name: str, what: swarm.Box | swarm.Cylinder | swarm.NoFly | swarm.Ball | object) -> scene.Obstacle:
    if isinstance(what, swarm.Box):
        one, other = enu(what.low), enu(what.high)
        low = (min(one[0], other[0]), min(one[1], other[1]), min(one[2], other[2]))
        high = (max(one[0], other[0]), max(one[1], other[1]), max(one[2], other[2]))
        return scene.Box(min=low, max=high, name=name)
    if isinstance(what, swarm.Cylinder):
        center = _corner(what.center)
        return scene.Cylinder(center=center, radius=what.radius, floor=what.floor, ceiling=what.ceiling, name=name)
    if isinstance(what, swarm.NoFly):
        corners = [_corner(c) for c in what.polygon]
        return scene.NoFly(polygon=corners, floor=what.floor, ceiling=what.ceiling, name=name)
    assert isinstance(what, swarm.Ball)
    (x, y, z), r = enu(what.center), what.radius
    return scene.Cylinder(center=(x, y), radius=r, floor=z - r, ceiling=z + r, name=name)


def _mover(name: str, what: swarm.Ball, age: float) -> MovingObstacle:
    x, y, z = enu(what.center)
    u, v, w = enu(what.velocity)
    rows = [(s, x + u * (age + s), y + v * (age + s), z + w * (age + s)) for s in (0.0, AHEAD)]
    return MovingObstacle(f"@{name}", np.array(rows, dtype=np.float64), what.radius)
