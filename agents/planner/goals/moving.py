"""A formation on its way as a rigid shape, that turns with the way.

All vehicles' places are functions of one parameter, how far the centre has come: its place on a rounded path, and the
course that the shape looks to. A common pace along that parameter then keeps every vehicle within its limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.planner.goals import timing
from agents.planner.goals.curves import at_length, lengths_of, rounded, without_repeats
from agents.planner.model.geometry import World, away
from agents.planner.model.problem import Floats, Motion, Path
from agents.planner.solve.jit import jit

STEP = 0.25
"""m of the centre's way between the places that are looked at"""
SPARE = 0.1
"""m more than their radius that ways for the shape keep from obstacles; half of it is left for the flight itself"""
CUTS = (math.inf, 2.0, 0.4, 0.1)
"""m by which the centre passes a corner of its way at most: the first for which there is room"""
ROOM = 0.4
"""m more that the centre's way keeps from obstacles, so that its corners can be rounded"""


@dataclass(frozen=True)
class FormationMembers:
    """Those who fly in shape, in the order of its slots."""

    offsets: Floats
    """(N, 3) forward, right, down"""
    radii: Floats
    limits: timing.Limits

    @property
    def extent(self) -> float:
        """m from the centre to the furthest of them."""
        return float(np.linalg.norm(self.offsets, axis=1).max())


@jit
def roomy(world: World, points: Floats, radii: Floats) -> bool:
    """Whether all N points are clear at each of S places (S, N, 3)."""
    way = np.empty(3)
    for s in range(points.shape[0]):
        for i in range(points.shape[1]):
            if away(world, points[s, i, 0], points[s, i, 1], points[s, i, 2], radii[i], way) > 0.0:
                return False
    return True


def move(path: Path, courses: tuple[float, float], members: FormationMembers, world: World) -> list[Motion] | None:
    """Fly the shape's centre along ``path`` (K, 3) ENU, from rest to rest: (T, 4) a vehicle, on common times.

    ``courses``: what the shape looks to at the beginning and at the end, rad counter-clockwise from east. None where
    the shape does not get through.
    """
    centre, course = _track(without_repeats(path), courses, members, world)
    ahead, right, down = members.offsets.T
    cos, sin = np.cos(course)[:, None], np.sin(course)[:, None]
    shape = np.stack(
        (ahead * cos + right * sin, ahead * sin - right * cos, np.broadcast_to(-down, (len(cos), len(down)))), axis=2
    )
    points = np.ascontiguousarray(centre[:, None] + shape)
    if not roomy(world, points, members.radii + 0.5 * SPARE):
        return None
    samples = timing.sample(points, timing.schedule(points, members.limits))
    return [np.ascontiguousarray(samples[:, i]) for i in range(samples.shape[1])]


def _track(path: Path, courses: tuple[float, float], members: FormationMembers, world: World) -> tuple[Path, Floats]:
    """The centre's way at M evenly spread places (M, 3), and (M,) what the shape looks to, smooth.

    Corners are rounded as the speed wants it where there is room for that; the course turns with them.
    """
    radius = float(members.limits.speed.min()) ** 2 / float(members.limits.accel.min())
    reach = np.array([float(members.radii.max()) + 0.5 * SPARE])
    for cut in CUTS:
        curve = rounded(path, radius if cut == math.inf else math.inf, STEP, cut=cut)
        if roomy(world, curve[:, None], reach):
            break
    whole = float(lengths_of(curve)[-1])
    turning = abs(math.remainder(courses[1] - courses[0], math.tau)) * members.extent
    where = np.linspace(0.0, whole, math.ceil(max(whole, turning, 4.0 * STEP) / STEP) + 1)
    return at_length(curve, where), _courses(curve, where, courses, members.extent / STEP)


def _headings(points: Path) -> Floats:
    """(M - 1,) courses of the pieces, continuous; where it goes straight up or down, as before."""
    pieces = np.diff(points, axis=0)
    level = np.linalg.norm(pieces[:, :2], axis=1)
    known = level > 1e-6
    if not known.any():
        return np.zeros(max(1, len(pieces)))
    angles = np.unwrap(np.arctan2(pieces[known, 1], pieces[known, 0]))
    index = np.flatnonzero(known)
    before = np.clip(np.searchsorted(index, np.arange(len(pieces)), side="right") - 1, 0, len(index) - 1)
    headings: Floats = angles[before]
    return headings


def _courses(curve: Path, where: Floats, ends: tuple[float, float], window: float) -> Floats:
    """(M,) the shape's course: the path's, smoothed over about the shape's extent, from one end's to the other's."""
    count = len(where)
    raw = np.full(count, ends[0])
    if where[-1] > 0.0 and len(curve) > 1:
        along = _headings(curve)
        gone = lengths_of(curve)
        piece = np.clip(np.searchsorted(gone, where, side="right") - 1, 0, len(along) - 1)
        raw = along[piece]
    half = int(np.clip(window, 2, max(2, count // 5)))
    raw[: half + 1] = raw[half] + math.remainder(ends[0] - raw[half], math.tau)
    last = raw[-half - 1]
    raw[-half - 1 :] = last + math.remainder(ends[1] - last, math.tau)
    return _smooth(raw, half)


def _smooth(values: Floats, half: int) -> Floats:
    """The values weighted over ``half`` places to each side by a raised cosine; the ends are held beyond."""
    weights = 1.0 + np.cos(np.linspace(-math.pi, math.pi, 2 * half + 1))
    padded = np.concatenate((np.full(half, values[0]), values, np.full(half, values[-1])))
    smooth: Floats = np.convolve(padded, weights / weights.sum(), mode="valid")
    return smooth
