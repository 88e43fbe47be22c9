"""A patrol: a closed route flown by all in one direction at one speed, spread evenly along it.

The corners are rounded so that the speed can be held in them; everybody keeps its phase, so two vehicles are as far
from each other on every lap as on the first.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents.planner.goals.curves import dense, lengths_of, rounded, without_repeats
from agents.planner.goals.timing import CORNERING, SAMPLE, SHARE, Limits, fly
from agents.planner.model.geometry import World, segment_clear
from agents.planner.model.problem import Floats, Motion, Path
from zmav.errors import BadInput

STEP = 0.25
CUT = (2.0, 0.5, 0.1)
"""m by which a corner may be passed, if there is room"""
SHORTEST = 1.0
"""m: less around is no route"""
SPEEDING_UP = 0.5
"""of the acceleration limit, along the route; the corners need the rest"""

SPARE = 0.1
"""m more than the radii ask for, which hold what a vehicle may be off its way already"""
ROOM = 0.6
"""m more that ways around obstacles keep from them, so that their corners can be rounded"""
SHARP = 0.6
"""rad between two steps: nobody flies that without a stop"""

Finder = Callable[[Floats, Floats], Path | None]
"""a clear way between two points, or None"""


@dataclass(frozen=True)
class Circuit:
    """A closed route made fit to fly: M points, evenly spread; the last one's neighbour is the first."""

    points: Path
    length: float
    speed: float
    """m/s, held all the way around"""
    accel: float
    """m/s², along the route"""
    sharp: bool
    """it turns so sharply somewhere that one must stop there"""

    def at(self, gone: Floats) -> Path:
        """(K, 3): the points so many metres along, lap after lap."""
        closed = np.vstack((self.points, self.points[:1]))
        where = np.mod(gone, self.length) / self.length * len(self.points)
        index = np.arange(len(closed))
        return np.column_stack([np.interp(where, index, closed[:, axis]) for axis in range(3)])


def circuit(route: Path, count: int, limits: Limits, radius: float, world: World, find: Finder) -> Circuit:
    """The route (K, 3) ENU for ``count`` vehicles, the widest of which has ``radius``.

    Raises :class:`BadInput` for a route that is none, a leg that nobody can fly, and corners without room.
    """
    corners = without_repeats(route, closed=True)
    if len(corners) < 2:
        raise BadInput("a patrol's route needs two points or more", field="route", value=len(route), expected="two")
    ways = []
    for k, (here, there) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        way = np.vstack((here, there)) if segment_clear(world, here, there, radius) else find(here, there)
        if way is None:
            text = f"patrol: there is no way from point {k} of the route to the next one"
            raise BadInput(text, field=f"route.{k}", value=str(here.tolist()), expected="a point that can be reached")
        ways.append(way[:-1])
    around = np.vstack(ways)
    for cut in CUT:
        curve = rounded(around, math.inf, STEP, closed=True, cut=cut)
        loop = np.vstack((curve, curve[:1]))
        if all(segment_clear(world, a, b, radius) for a, b in itertools.pairwise(loop)):
            return _paced(loop, count, limits)
    raise BadInput("patrol: the route's corners have no room to turn in", field="route", expected="wider corners")


def _paced(loop: Path, count: int, limits: Limits) -> Circuit:
    """Even points, as many for each vehicle, and the speed that all of them allow."""
    length = float(lengths_of(loop)[-1])
    if length < SHORTEST:
        text = "patrol: all points of the route are at one place"
        raise BadInput(text, field="route", value=round(length, 3), expected=f"{SHORTEST:.0f} m around or more")
    each = max(4, math.ceil(length / (STEP * count)))
    points = dense(loop, length / (each * count) * (1.0 + 1e-9))[:-1]
    step = length / len(points)
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    bend = float(np.linalg.norm(after - before, axis=1).max()) / step**2
    accel = SHARE * float(limits.accel.min())
    speed = float(limits.speed.min())
    if bend > 0.0:
        speed = min(speed, math.sqrt(CORNERING * accel / bend))
    rise = float(after[:, 2].max()) / step
    fall = float(-after[:, 2].min()) / step
    if rise > 0.0:
        speed = min(speed, float(limits.climb.min()) / rise)
    if fall > 0.0:
        speed = min(speed, float(limits.descend.min()) / fall)
    sharp = bend * step > SHARP
    if sharp and count > 1:
        text = "patrol: the route turns back on itself, where vehicles on their way to and fro would meet"
        raise BadInput(text, field="route", value=len(points), expected="corners of less than 180 degrees")
    return Circuit(points, length, speed, SPEEDING_UP * accel, sharp)


def least_apart(way: Circuit, count: int, downwash: float) -> float:
    """m in the downwash metric that two of ``count`` vehicles ever come to, spread evenly; inf for one."""
    scale = np.array([1.0, 1.0, 1.0 / downwash])
    points, least = way.points * scale, math.inf
    for k in range(1, count // 2 + 1):
        shift = k * len(points) / count
        ahead = way.at((np.arange(len(points)) + shift) * way.length / len(points)) * scale
        least = min(least, float(np.linalg.norm(points - ahead, axis=1).min()))
    return least


def check_room(way: Circuit, count: int, need: float, downwash: float) -> None:
    """Raise :class:`BadInput` where so many do not fit on the route, saying how many do."""
    if count < 2:
        return
    need += SPARE
    apart = least_apart(way, count, downwash)
    if apart >= need:
        return
    fit = next((n for n in range(count - 1, 1, -1) if least_apart(way, n, downwash) >= need), 1)
    text = (
        f"patrol: {count} vehicles spread over {way.length:.0f} m of route come within {apart:.2f} m of each other, "
        f"and they need {need:.2f} m; {fit} would fit"
    )
    raise BadInput(text, field="vehicles", value=count, expected=f"{fit} vehicles, or a longer route without crossings")


def lap(way: Circuit, phases: Floats) -> tuple[list[Motion], tuple[float, float]]:
    """One lap by each vehicle, from rest to rest; ``phases`` (N,) are metres along the route at the start.

    The second value is when the lap begins and ends, at full speed.
    """
    assert not way.sharp
    ramp = way.speed / way.accel
    reach = way.speed * ramp / 2.0
    around = way.length / way.speed
    up = np.linspace(0.0, ramp, max(3, math.ceil(ramp / SAMPLE) + 1))
    on = np.linspace(0.0, around, max(3, math.ceil(around / SAMPLE) + 1))[1:]
    down = up[1:]
    times = np.concatenate((up, ramp + on, ramp + around + down))
    gone = np.concatenate(
        (
            way.accel * up**2 / 2.0,
            reach + way.speed * on,
            reach + way.length + way.speed * down - way.accel * down**2 / 2.0,
        )
    )
    begin, end = np.round((ramp, ramp + around), 6)
    stamps = np.round(times, 6)
    motions = [np.column_stack((stamps, np.round(way.at(phase + gone), 6))) for phase in phases]
    return motions, (float(begin), float(end))


def lap_alone(way: Circuit, limits: Limits) -> tuple[list[Motion], tuple[float, float]]:
    """One lap by one vehicle from the route's beginning, as fast as each corner allows; at rest at both its ends."""
    points = np.vstack((way.points, way.points[:1]))[:, None, :]
    motion = np.ascontiguousarray(fly(points, limits)[:, 0])
    return [motion], (0.0, float(motion[-1, 0]))
