"""When to be where along given ways: the fastest speed that all vehicles' limits allow, from rest to rest.

Time-optimal path parametrisation (Bobrow, Dubowsky, Gibson 1985) by one forward and one backward pass: the ways of
all vehicles hang on one parameter, so their geometry stays as it was drawn and only the common pace changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.problem import Floats
from agents.planner.solve.jit import jit

Bools = NDArray[np.bool_]

SAMPLE = 0.19
"""s between samples at most: a plan has five a second or more"""
SHARE = 0.95
"""of the acceleration limit that is planned with"""
CORNERING = 0.8
"""of that which a curve may take, so that there is some left to brake in it"""

KINK = 0.25
"""rad between two steps: a sharper corner is no curve, and everybody stops in it"""


@dataclass(frozen=True)
class Limits:
    """(N,) each: m/s, m/s², m/s up and down."""

    speed: Floats
    accel: Floats
    climb: Floats
    descend: Floats


@jit
def paces(ceiling: Floats, rate: Floats, along: Floats, across: Floats, accel: Floats) -> Floats:
    """The square of the parameter's rate at each of M places, from rest to rest, as fast as the limits allow.

    ``ceiling`` (M,): the most it may be. For each of M - 1 steps and N vehicles: ``rate`` metres a step, ``along`` and
    ``across`` the second derivative along the way and across it. ``accel`` (N,).
    """
    places, vehicles = ceiling.shape[0], accel.shape[0]
    square = ceiling.copy()
    square[0] = 0.0
    square[places - 1] = 0.0
    for way in range(2):
        sign = 1.0 if way == 0 else -1.0
        for step in range(places - 1):
            k = step if way == 0 else places - 1 - step
            part = k if way == 0 else k - 1
            most = np.inf
            for i in range(vehicles):
                if rate[part, i] < 1e-9:
                    continue
                side = across[part, i] * square[k]
                room = np.sqrt(max(0.0, accel[i] ** 2 - side**2)) - sign * along[part, i] * square[k]
                most = min(most, max(0.0, room) / rate[part, i])
            follow = k + 1 if way == 0 else k - 1
            square[follow] = min(square[follow], square[k] + 2.0 * most)
    return square


@dataclass(frozen=True)
class Pace:
    """(M,) each: when the vehicles are at each place, and how many places a second they pass there."""

    times: Floats
    rate: Floats


def schedule(points: Floats, limits: Limits) -> Pace:
    """When to be at each of ``points`` (M, N, 3), M >= 2; all vehicles rest at both ends."""
    step = np.diff(points, axis=0)
    rate = np.linalg.norm(step, axis=2)
    bend = np.zeros_like(points)
    bend[1:-1] = np.diff(step, axis=0)
    size = np.linalg.norm(bend, axis=2)
    stops = _not_twice(stops_of(step))
    bend[stops], size[stops] = 0.0, 0.0
    accel = SHARE * limits.accel
    with np.errstate(divide="ignore"):
        ceiling = np.minimum.reduce(
            [
                _lower((limits.speed / rate) ** 2),
                _lower((limits.climb / np.maximum(step[:, :, 2], 0.0)) ** 2),
                _lower((limits.descend / np.maximum(-step[:, :, 2], 0.0)) ** 2),
                np.min(CORNERING * accel / size, axis=1),
            ]
        )
    ceiling = np.ascontiguousarray(np.where(stops, 0.0, np.minimum(ceiling, 1e9)))
    middle = np.maximum(size[1:], size[:-1])
    turning = np.where((size[1:] >= size[:-1])[:, :, None], bend[1:], bend[:-1])
    along = np.sum(turning * step, axis=2) / np.maximum(rate, 1e-12)
    across = np.sqrt(np.maximum(middle**2 - along**2, 0.0))
    pace = np.sqrt(paces(ceiling, rate, along, across, np.ascontiguousarray(accel)))
    together = pace[1:] + pace[:-1]
    standing = rate.max(axis=1) < 1e-9
    lasts = np.where(standing, 0.0, 2.0 / np.maximum(together, 1e-9))
    return Pace(np.concatenate(([0.0], np.cumsum(lasts))), pace)


def stops_of(step: Floats) -> Bools:
    """(M,) where everybody must stop, because somebody's way (M - 1 steps, N, 3) has a sharp corner there."""
    rate = np.linalg.norm(step, axis=2)
    size = np.linalg.norm(np.diff(step, axis=0), axis=2)
    kinks = (size > KINK * rate.max(axis=0)).any(axis=1)
    return np.concatenate(([False], kinks, [False]))


def _not_twice(stops: Bools) -> Bools:
    """Without those right after another one, or right beside the ends: nobody gets from rest to rest in one step."""
    kept = np.zeros_like(stops)
    before = True
    for k in range(1, len(stops) - 2):
        kept[k] = before = bool(stops[k]) and not before
    return kept


def fly(points: Floats, limits: Limits) -> Floats:
    """(T, N, 4) samples along ``points`` (M, N, 3), whose corners may be sharp, from rest to rest."""
    stops = stops_of(np.diff(points, axis=0))
    stops[0] = stops[-1] = True
    if (stops[1:] & stops[:-1]).any() or len(points) < 3:
        between = (points[1:] + points[:-1]) / 2.0
        finer = np.empty((2 * len(points) - 1, *points.shape[1:]))
        finer[::2], finer[1::2] = points, between
        points = finer
    return sample(points, schedule(points, limits))


def _lower(steps: Floats) -> Floats:
    """(M - 1, N) values of the steps -> (M,) the least at each place, of either side and all vehicles."""
    least = np.min(steps, axis=1)
    lower: Floats = np.minimum(np.append(least, least[-1]), np.append(least[0], least))
    return lower


def sample(points: Floats, pace: Pace) -> Floats:
    """(T, N, 4) t, x, y, z at even times, from :func:`schedule`'s: between two places the pace changes evenly."""
    end = float(pace.times[-1])
    ticks = np.linspace(0.0, end, max(2, int(np.ceil(end / SAMPLE)) + 1))
    lasts = np.diff(pace.times)
    at = np.clip(np.searchsorted(pace.times, ticks, side="right") - 1, 0, len(lasts) - 1)
    gone = ticks - pace.times[at]
    change = (pace.rate[at + 1] - pace.rate[at]) / np.maximum(lasts[at], 1e-12)
    index = np.clip(at + pace.rate[at] * gone + 0.5 * change * gone**2, at, at + 1.0)
    low = np.minimum(index.astype(np.int64), len(points) - 2)
    share = (index - low)[:, None, None]
    where = points[low] * (1.0 - share) + points[low + 1] * share
    stamps = np.broadcast_to(ticks[:, None, None], (*where.shape[:2], 1))
    samples: Floats = np.round(np.concatenate((stamps, where), axis=2), 6)
    return samples
