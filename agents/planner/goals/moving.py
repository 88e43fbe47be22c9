"""A formation on its way: rigid where there is room, drawn out into a column where there is not, and restored.

All vehicles' places are functions of one parameter, how far the centre has come: its place on a rounded path, the
course that the shape looks to, and how far it is drawn out (0: the shape; 1: the column, each vehicle on the centre's
own path). A common pace along that parameter then keeps every vehicle within its limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.planner.goals import timing
from agents.planner.goals.curves import at_length, lengths_of, rounded, without_repeats
from agents.planner.goals.formation import scaled_distances
from agents.planner.model.geometry import World, clearance, outside
from agents.planner.model.problem import Floats, Ints, Motion, Path
from agents.planner.solve.jit import jit

STEP = 0.25
"""m of the centre's way between the places that are looked at"""
LOOK = 4
"""every so many of them is tried for room"""
SHARES = np.linspace(0.0, 1.0, 11)
"""how far drawn out a shape is tried"""
SPARE = 0.1
"""m more than their radius that vehicles in shape keep from obstacles"""
MORE = 0.1
"""by how much more a shape is drawn out where it touches something on the way into its column"""
ROUNDS = 40
CUTS = (math.inf, 2.0, 0.4, 0.1)
"""m by which the centre passes a corner of its way at most: the first for which there is room"""
ROOM = 0.4
"""m more that the centre's way keeps from obstacles, so that its corners can be rounded"""
COLUMN_GAP = 1.5
"""neighbours in a column, in times the widest two's radii: so much that nobody meets while it forms"""
HURRY = (1.5, 0.7, 0.35)
"""metres of the centre's way in which the shape is drawn out, in times the furthest that a vehicle has to go for it"""


@dataclass(frozen=True)
class Moved:
    """A shape's flight from rest to rest."""

    motions: list[Motion]
    """one a vehicle: (T, 4) on common times"""
    squeezed: Floats
    """(T,) how far drawn out: 0 the shape, 1 a column"""
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
    downwash: float

    @property
    def apart(self) -> float:
        """m: the most that any two of them need."""
        return float(np.sort(self.radii)[-2:].sum()) if len(self.radii) > 1 else 0.0

    @property
    def extent(self) -> float:
        """m from the centre to the furthest of them."""
        return float(np.linalg.norm(self.offsets, axis=1).max())


@jit
def roomy(world: World, points: Floats, radii: Floats) -> Ints:
    """For each of S places the first of W tries (S, W, N, 3) in which all N points are clear; W where none is."""
    places, tries, vehicles = points.shape[0], points.shape[1], points.shape[2]
    found = np.full(places, tries, dtype=np.int64)
    for s in range(places):
        for w in range(tries):
            clear = True
            for i in range(vehicles):
                x, y, z = points[s, w, i, 0], points[s, w, i, 1], points[s, w, i, 2]
                if outside(world, x, y, z) > 0.0 or clearance(world, x, y, z) < radii[i]:
                    clear = False
                    break
            if clear:
                found[s] = w
                break
    return found


def move(
    path: Path, courses: tuple[float | None, float | None], members: FormationMembers, world: World | None
) -> Moved | None:
    """Fly the shape's centre along ``path`` (K, 3) ENU, from rest to rest.

    ``courses``: what the shape looks to at the beginning and at the end, rad counter-clockwise from east; None: along
    the path. Without a ``world`` there is nothing to avoid. None where the shape does not get through, or cannot be
    drawn out and restored in the room there is before, between and after.
    """
    path = without_repeats(path)
    if len(path) < 2 and None in courses:
        return None
    track = _Track.of(path, courses, members, world)
    column = _column(members)
    needed = _needed(track, members, column, world)
    if needed is None:
        return None
    for hurry in HURRY:
        drawn = _drawn_out(track, members, column, world, needed, _ramp(track, members, column, hurry))
        if drawn is not None:
            squeeze, points = drawn
            return _timed(track, points, squeeze, members.limits)
    return None


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
            if world is None or not roomy(world, curve[:, None, None], reach).any():
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


def _column(members: FormationMembers) -> Floats:
    """(N,) metres ahead of the centre that each vehicle has in a column: who goes where so that nobody meets.

    The assignment with the least sum of squares, on straight lines at one pace, keeps everybody apart where both
    shapes are wide enough (Turpin, Michael, Kumar 2014, CAPT).
    """
    count = len(members.offsets)
    if count == 1:
        return np.zeros(1)
    from scipy.optimize import linear_sum_assignment

    gap = max(COLUMN_GAP * members.apart, 1e-3)
    ahead = members.offsets[:, 0].mean() + gap * ((count - 1) / 2.0 - np.arange(count))
    slots = np.column_stack((ahead, np.zeros((count, 2))))
    _, order = linear_sum_assignment(scaled_distances(members.offsets, slots, members.downwash) ** 2)
    taken: Floats = ahead[order]
    return taken


def _points(track: _Track, members: FormationMembers, column: Floats, squeeze: Floats, every: int = 1) -> Floats:
    """(M, N, 3) everybody's places; ``squeeze`` (M,) is how far the shape is drawn out at each place.

    Drawn out, what is left of the shape stands across the course at a point of the centre's own path.
    """
    offsets = members.offsets
    where, course = track.where[::every], track.course[::every]
    count, vehicles = len(where), len(offsets)
    drawn = squeeze[:, None] * column
    along = where[:, None] + drawn
    on_path = at_length(track.path, along.ravel()).reshape(count, vehicles, 3)
    left = (1.0 - squeeze)[:, None]
    ahead, right, down = left * offsets[:, 0], left * offsets[:, 1], left * offsets[:, 2]
    cos, sin = np.cos(course)[:, None], np.sin(course)[:, None]
    shape = np.stack((ahead * cos + right * sin, ahead * sin - right * cos, -down), axis=2)
    return np.ascontiguousarray(on_path + shape)


def _needed(track: _Track, members: FormationMembers, column: Floats, world: World | None) -> Floats | None:
    """(M,) the least that the shape must be drawn out at each place; None where even a column does not pass."""
    count = len(track.where)
    needed = np.zeros(count)
    if world is None:
        return needed
    looked = np.arange(0, count, LOOK)
    tries = [_points(track, members, column, np.full(len(looked), share), LOOK) for share in SHARES]
    found = roomy(world, np.ascontiguousarray(np.stack(tries, axis=1)), members.radii + SPARE)
    if (found == len(SHARES)).any():
        return None
    for at, rung in zip(looked, found, strict=True):
        around = slice(max(0, at - LOOK), at + LOOK + 1)
        needed[around] = np.maximum(needed[around], SHARES[rung])
    return needed


def _ramp(track: _Track, members: FormationMembers, column: Floats, hurry: float) -> int:
    """In how many places the shape becomes a column."""
    ends = np.column_stack((column, np.zeros((len(column), 2))))
    furthest = float(np.linalg.norm(members.offsets - ends, axis=1).max())
    return max(8, math.ceil(hurry * furthest / track.step))


def _drawn_out(
    track: _Track, members: FormationMembers, column: Floats, world: World | None, needed: Floats, ramp: int
) -> tuple[Floats, Floats] | None:
    """How far the shape is drawn out at each place (M,), and everybody's places (M, N, 3), clear of all.

    On its way into a column a shape may touch what it passed by as a whole: then it is drawn out more there, again
    and again. None where it cannot stand in shape at both ends, or two meet.
    """
    needed = needed.copy()
    for _ in range(ROUNDS):
        squeeze = _eased(needed, ramp)
        if squeeze[0] > 1e-9 or squeeze[-1] > 1e-9:
            return None
        points = _points(track, members, column, squeeze)
        bad = np.zeros(len(needed), dtype=bool)
        if world is not None:
            bad = roomy(world, points[:, None], members.radii + 0.5 * SPARE) > 0
        if not bad.any():
            return None if _meet(points[squeeze > 0.0], members) else (squeeze, points)
        if squeeze[bad].min() > 1.0 - 1e-9:
            return None
        needed[bad] = np.minimum(1.0, np.maximum(needed, squeeze)[bad] + MORE)
    return None


def _eased(needed: Floats, ramp: int) -> Floats:
    """(M,) at least what is needed everywhere, rising and falling smoothly over ``ramp`` places."""
    half = max(2, ramp // 2)
    padded = np.concatenate((np.zeros(half), needed, np.zeros(half)))
    wide = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).max(axis=1)
    slope = 1.0 / max(1, ramp - half)
    index = np.arange(len(wide)) * slope
    rising = np.maximum.accumulate(wide + index) - index
    falling = np.maximum.accumulate((rising - index)[::-1])[::-1] + index
    return np.clip(_smooth(falling, half), 0.0, 1.0)


def _meet(points: Floats, members: FormationMembers) -> bool:
    """True where two come nearer than they may at one of the places."""
    if points.shape[1] < 2:
        return False
    need = members.radii[:, None] + members.radii[None]
    np.fill_diagonal(need, -np.inf)
    return any(bool((scaled_distances(at, at, members.downwash) < need - 1e-3).any()) for at in points[::2])


def _timed(track: _Track, points: Floats, squeeze: Floats, limits: timing.Limits) -> Moved:
    pace = timing.schedule(points, limits)
    samples = timing.sample(points, pace)
    index = timing.place_at(pace, samples[:, 0, 0])
    places = np.arange(len(squeeze))
    centre = track.centre
    middle = np.column_stack([samples[:, 0, 0], *(np.interp(index, places, centre[:, axis]) for axis in range(3))])
    motions = [np.ascontiguousarray(samples[:, i]) for i in range(samples.shape[1])]
    return Moved(motions, np.interp(index, places, squeeze), middle)
