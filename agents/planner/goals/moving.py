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
class Moved:
    """A shape's flight from rest to rest."""

    motions: list[Motion]
    """one a vehicle: (T, 4) on common times"""
    centre: Motion
    """(T, 4)"""

    @property
    def makespan(self) -> float:
        return float(self.centre[-1, 0])


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


def move(
    path: Path, courses: tuple[float | None, float | None], members: FormationMembers, world: World | None
) -> Moved | None:
    """Fly the shape's centre along ``path`` (K, 3) ENU, from rest to rest.

    ``courses``: what the shape looks to at the beginning and at the end, rad counter-clockwise from east; None: along
    the path. Without a ``world`` there is nothing to avoid. None where the shape does not get through.
    """
    path = without_repeats(path)
    if len(path) < 2 and None in courses:
        return None
    track = _Track.of(path, courses, members, world)
    points = _points(track, members)
    if world is not None and not roomy(world, points, members.radii + 0.5 * SPARE):
        return None
    return _timed(track, points, members.limits)


@dataclass(frozen=True)
class _Track:
    """The centre's way at M evenly spread places."""

    path: Path
    """rounded, for anyone who flies on it ahead or behind"""
    where: Floats
    """(M,) m along it"""
    course: Floats
    """(M,) that the shape looks to, smooth"""
    step: float
    """m, of the parameter: also where the shape only turns"""

    @classmethod
    def of(
        cls, path: Path, courses: tuple[float | None, float | None], members: FormationMembers, world: World | None
    ) -> _Track:
        """Corners are rounded as the speed wants it where there is room for that; the course turns with them."""
        radius = float(members.limits.speed.min()) ** 2 / float(members.limits.accel.min())
        reach = np.array([float(members.radii.max()) + 0.5 * SPARE])
        for cut in CUTS:
            curve = rounded(path, radius if cut == math.inf else math.inf, STEP, cut=cut)
            if world is None or roomy(world, curve[:, None], reach):
                break
        whole = float(lengths_of(curve)[-1])
        ends = _ends(curve, courses)
        turning = abs(math.remainder(ends[1] - ends[0], math.tau)) * members.extent
        span = max(whole, turning, 4.0 * STEP)
        count = math.ceil(span / STEP) + 1
        where = np.linspace(0.0, whole, count)
        return cls(curve, where, _courses(curve, where, ends, members.extent / STEP), span / (count - 1))

    @property
    def centre(self) -> Path:
        return at_length(self.path, self.where)


def _ends(curve: Path, courses: tuple[float | None, float | None]) -> tuple[float, float]:
    """The first and the last course, the path's own where none is asked for."""
    along = _headings(curve)
    first, last = courses
    return (float(along[0]) if first is None else first, float(along[-1]) if last is None else last)


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


def _points(track: _Track, members: FormationMembers) -> Floats:
    """(M, N, 3) everybody's places."""
    ahead, right, down = members.offsets.T
    cos, sin = np.cos(track.course)[:, None], np.sin(track.course)[:, None]
    shape = np.stack(
        (ahead * cos + right * sin, ahead * sin - right * cos, np.broadcast_to(-down, (len(cos), len(down)))), axis=2
    )
    return np.ascontiguousarray(track.centre[:, None] + shape)


def _timed(track: _Track, points: Floats, limits: timing.Limits) -> Moved:
    pace = timing.schedule(points, limits)
    samples = timing.sample(points, pace)
    index, places = timing.place_at(pace, samples[:, 0, 0]), np.arange(len(points))
    centre = np.column_stack([samples[:, 0, 0], *(np.interp(index, places, axis) for axis in track.centre.T)])
    return Moved([np.ascontiguousarray(samples[:, i]) for i in range(samples.shape[1])], centre)
