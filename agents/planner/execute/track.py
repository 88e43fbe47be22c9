"""One vehicle's way through a plan as a smooth curve over the plan's own time, and the clock that runs along it.

A plan is sampled and piecewise linear; a vehicle interpolates what it is sent by cubics (Hermite's). :class:`Track` is
the cubic through the samples. :class:`Profile` says which moment of the plan is flown when: its rate is 1 at the plan's
own pace, less when the common clock is slowed, and goes to zero along a stop tail. ENU metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agents.planner.model.problem import Floats, Motion

KNOT_EVERY, REST_EVERY, CLOSEST = 1.0, 2.5, 0.06
"""s between two points of a segment while moving and at rest, and at least"""
NEAR = 0.02
"""m by which the curve between two points may leave the track's"""
SHARES = np.array([[0.25], [0.5], [0.75]])
"""of the time between two points, at which it is looked at"""
DENSE = 0.1
"""s between the samples by which what will be flown is checked"""
EASE = 0.5
"""s over which a plan's places are averaged, so that no acceleration comes at once: its curve leaves the samples by
at most a · EASE² / 24 where these accelerate by a"""
ROUND_M = 3
"""decimals of places and velocities on the wire"""
ROUND_S = 4


Piece = tuple[float, float, float, float]
"""from time t on at moment s, with a rate that changes by slope a second: t, s, rate, slope"""


class Track:
    """A vehicle's motion in a plan: from rest to rest, held at both ends. ``motion`` is (T, 4).

    ``ease``: s over which it is averaged; all that is flown together is eased alike, and takes so much longer.
    """

    def __init__(self, motion: Motion, ease: float = EASE) -> None:
        if len(motion) == 1:
            motion = np.vstack((motion, motion + np.array([1.0, 0.0, 0.0, 0.0])))
        if ease > 0.0:
            motion = _eased(motion, ease)
        self.s: Floats = np.ascontiguousarray(motion[:, 0], dtype=np.float64)
        self.pos: Floats = np.ascontiguousarray(motion[:, 1:4], dtype=np.float64)
        self.vel = _velocities(self.s, self.pos)
        moving = np.flatnonzero(np.any(np.abs(self.pos - self.pos[-1]) > 1e-6, axis=1))
        self.end = float(self.s[moving[-1] + 1]) if len(moving) else float(self.s[0])
        """the moment from which it is at its goal for good"""
        self.speed = float(np.max(np.linalg.norm(self.vel, axis=1)))
        """m/s at most"""

    def at(self, s: Floats) -> tuple[Floats, Floats]:
        """Places and velocities (per second of the plan) at the moments ``s``: (K, 3) each."""
        return _hermite(self.s, self.pos, self.vel, s)


def _eased(motion: Motion, ease: float) -> Motion:
    """At each time the mean place of the last ``ease`` seconds: exact at both ends."""
    t = motion[:, 0] - motion[0, 0]
    step = np.diff(t)[:, None]
    middle = 0.5 * (motion[1:, 1:] + motion[:-1, 1:])
    sums = np.vstack((np.zeros(3), np.cumsum(step * middle, axis=0)))

    def total(at: Floats) -> Floats:
        """The integral of the place from the first sample on."""
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
        since = (np.clip(at, 0.0, t[-1]) - t[k])[:, None]
        slope = (motion[k + 1, 1:] - motion[k, 1:]) / step[k]
        inside = sums[k] + since * (motion[k, 1:] + 0.5 * since * slope)
        before, after = np.minimum(at, 0.0)[:, None], np.maximum(at - t[-1], 0.0)[:, None]
        whole: Floats = inside + before * motion[0, 1:] + after * motion[-1, 1:]
        return whole

    at = np.unique(np.round(np.concatenate((t, t + ease, np.arange(0.0, t[-1] + ease, 0.1))), 6))
    places = (total(at) - total(at - ease)) / ease
    places = np.round(places, 9)  # where it stands, it does so exactly
    places[0], places[-1] = motion[0, 1:], motion[-1, 1:]
    return np.column_stack((at + motion[0, 0], places))


def _velocities(t: Floats, pos: Floats) -> Floats:
    """Of the parabola through each sample and its neighbours; at rest at the ends and wherever it stands."""
    step = np.diff(t)[:, None]
    slope = np.diff(pos, axis=0) / step
    vel = np.zeros_like(pos)
    before, after = step[:-1], step[1:]
    vel[1:-1] = (slope[:-1] * after + slope[1:] * before) / (before + after)
    stands = ~np.any(slope, axis=1)
    vel[:-1][stands] = 0.0
    vel[1:][stands] = 0.0
    return vel


def _hermite(t: Floats, pos: Floats, vel: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Places and velocities of the cubic through samples with velocities; held before the first and after the last."""
    within = np.clip(at, t[0], t[-1])
    k = np.clip(np.searchsorted(t, within, side="right") - 1, 0, len(t) - 2)
    h = (t[k + 1] - t[k])[:, None]
    u = (within - t[k])[:, None] / h
    p0, p1, v0, v1 = pos[k], pos[k + 1], vel[k] * h, vel[k + 1] * h
    rest = 1.0 - u
    place = rest * rest * (p0 * (1.0 + 2.0 * u) + v0 * u) + u * u * (p1 * (3.0 - 2.0 * u) - v1 * rest)
    velocity = (6.0 * u * rest * (p1 - p0) + v0 * rest * (1.0 - 3.0 * u) + v1 * u * (3.0 * u - 2.0)) / h
    velocity[(at < t[0]) | (at >= t[-1])] = 0.0
    return place, velocity


@dataclass(frozen=True)
class Profile:
    """Which moment ``s`` of the plan is flown at time ``t``: pieces from (t, s) on with a rate that changes steadily.

    The first moment is held before the first piece; the last piece stands still.
    """

    t: Floats
    s: Floats
    rate: Floats
    slope: Floats
    """1/s by which the rate changes"""

    @classmethod
    def resting(cls, s: float, since: float) -> Profile:
        return cls(np.array([since]), np.array([s]), np.zeros(1), np.zeros(1))

    @property
    def stop(self) -> float:
        """The moment of the plan at which it comes to rest."""
        return float(self.s[-1])

    @property
    def rest_at(self) -> float:
        """When it does."""
        return float(self.t[-1])

    def at(self, t: Floats) -> tuple[Floats, Floats]:
        """Moments of the plan and rates at the times ``t``."""
        k = np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)
        since = np.maximum(t - self.t[k], 0.0)
        rate = np.where(t < self.t[0], 0.0, self.rate[k] + self.slope[k] * since)
        return self.s[k] + (self.rate[k] + 0.5 * self.slope[k] * since) * since, rate

    def then(self, d: float, pieces: list[Piece]) -> Profile:
        """The same until ``d``, and then others: rows of t, s, rate, slope."""
        keep = self.t < d
        more = np.array(pieces)
        t, s, rate, slope = (
            np.concatenate((old[keep], new))
            for old, new in zip((self.t, self.s, self.rate, self.slope), more.T, strict=True)
        )
        return Profile(t, s, rate, slope)


@dataclass(frozen=True)
class CommonClock:
    """The common clock: at ``t`` the plan is at ``s``, and goes on at ``pace``."""

    t: float
    s: float
    pace: float = 1.0

    def at(self, t: float) -> float:
        return self.s + self.pace * (t - self.t)

    def when(self, s: float) -> float:
        return self.t + (s - self.s) / self.pace


def join(d: float, s: float, rate: float, line: CommonClock, slope: float) -> tuple[list[Piece], float, float]:
    """From moment ``s`` at time ``d`` to the common clock: who is ahead of it goes slower until it comes up.

    Gives the pieces, and the time and moment from which the rate is the line's. Who is behind stays behind.
    """
    pace = line.pace
    if s <= 0.0 and rate == 0.0:  # at rest at the plan's beginning: it may start at full rate
        start = max(d, line.when(0.0))
        return ([(d, s, 0.0, 0.0)] if start > d else []), start, s
    ahead = s - line.at(d)
    low = _lowest(rate, pace, ahead, slope)
    pieces: list[Piece] = []
    if rate > low:
        pieces.append((d, s, rate, -slope))
        span = (rate - low) / slope
        d, s = d + span, s + 0.5 * (rate + low) * span
    lost = _lost(rate, low, pace, slope)
    if low < pace and ahead > lost + 1e-9:  # even standing still for a moment is not enough
        span = (ahead - lost) / (pace - low)
        pieces.append((d, s, low, 0.0))
        d, s = d + span, s + low * span
    if low < pace:
        pieces.append((d, s, low, slope))
        span = (pace - low) / slope
        d, s = d + span, s + 0.5 * (pace + low) * span
    return pieces, d, s


def behind(d: float, s: float, rate: float, line: CommonClock, slope: float) -> float:
    """Seconds of the plan by which one that is at ``s`` at time ``d`` must fall behind the common clock; 0: none."""
    if s <= 0.0 and rate == 0.0:
        return max(0.0, line.at(d))
    low = min(rate, line.pace)
    return max(0.0, line.at(d) - s + _lost(rate, low, line.pace, slope))


def _lost(rate: float, low: float, pace: float, slope: float) -> float:
    """What the clock gains on one who goes from ``rate`` down to ``low`` and up to ``pace``."""
    down = (pace - 0.5 * (rate + low)) * (rate - low) / slope
    return down + 0.5 * (pace - low) ** 2 / slope


def _lowest(rate: float, pace: float, ahead: float, slope: float) -> float:
    """The rate to go down to, so that the clock comes up; 0: it must stand for a while as well."""
    high, low = min(rate, pace), 0.0
    if _lost(rate, high, pace, slope) >= ahead:
        return high
    if _lost(rate, 0.0, pace, slope) <= ahead:
        return 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _lost(rate, middle, pace, slope) >= ahead:
            low = middle
        else:
            high = middle
    return low


def tail(t: float, s: float, rate: float, slope: float) -> list[Piece]:
    """Slow down to rest from there."""
    span = rate / slope
    if span <= 0.0:
        return [(t, s, 0.0, 0.0)]
    return [(t, s, rate, -slope), (t + span, s + 0.5 * rate * span, 0.0, 0.0)]


def onward(before: Profile, d: float, line: CommonClock, stop: float, end: float, slope: float) -> Profile | None:
    """Go on from ``before`` at ``d`` by the common clock, to rest at the moment ``stop`` (``end``: the track's own end,
    where no tail is needed). None where there is no room for a tail.
    """
    (s,), (rate,) = before.at(np.array([d]))
    pieces, t, at = join(d, float(s), float(rate), line, slope)
    pace = line.pace
    if stop >= end:
        if at > end:
            return None
        rest = t + (end - at) / pace
        return before.then(d, [*pieces, (t, at, pace, 0.0), (rest, end, 0.0, 0.0)])
    begin = stop - 0.5 * pace * pace / slope
    if begin < at - 1e-9:
        return None
    when = t + (begin - at) / pace
    return before.then(d, [*pieces, (t, at, pace, 0.0), *tail(when, begin, pace, slope)])


def braked(before: Profile, d: float, slope: float) -> Profile:
    """Slow down to rest from ``d`` on."""
    (s,), (rate,) = before.at(np.array([d]))
    return before.then(d, tail(d, float(s), float(rate), slope))


def crept(before: Profile, d: float, stop: float, slope: float) -> Profile | None:
    """From rest at ``d`` a little way on, to rest again at ``stop``; None where it does not rest, or is there."""
    (s,), (rate,) = before.at(np.array([d]))
    way = stop - float(s)
    if rate > 0.0 or not 0.0 < way < 1.0 / slope:
        return None
    top = float(np.sqrt(way * slope))
    span = top / slope
    half = float(s) + 0.5 * way
    return before.then(d, [(d, float(s), 0.0, slope), *tail(d + span, half, top, slope)])


def knots(track: Track, profile: Profile, begin: float) -> Floats:
    """(K, 7): t, place, velocity: the points of a segment from ``begin`` until it rests.

    The vehicle's cubics between them stay within :data:`NEAR` of the track, as far as :data:`CLOSEST` allows.
    """
    last = max(profile.rest_at, begin + 2.0 * CLOSEST)
    marks = profile.t[(profile.t > begin + CLOSEST) & (profile.t < last - CLOSEST)]
    times = _thinned(np.concatenate(([begin], marks, [last])))
    times = _filled(track, profile, times)
    for _ in range(4):
        rows = _rows(track, profile, times)
        worst = _bend(track, profile, rows)
        wide = (worst > NEAR) & (np.diff(times) > 2.0 * CLOSEST)
        if not np.any(wide):
            break
        times = np.sort(np.concatenate((times, 0.5 * (times[:-1] + times[1:])[wide])))
    return _rows(track, profile, np.round(times, ROUND_S))


def _thinned(times: Floats) -> Floats:
    """Without those that come too soon after the one before; the last stays."""
    keep = [float(times[0])]
    for t in times[1:-1]:
        if t - keep[-1] > CLOSEST:
            keep.append(float(t))
    return np.array([*keep, float(times[-1])])


def _filled(track: Track, profile: Profile, times: Floats) -> Floats:
    fine = [np.linspace(a, b, int(np.ceil((b - a) / KNOT_EVERY)) + 1) for a, b in pairwise(times.tolist())]
    begins = np.cumsum([0, *map(len, fine[:-1])])
    place, _ = track.at(profile.at(np.concatenate(fine))[0])
    moved = np.maximum.reduceat(place, begins) - np.minimum.reduceat(place, begins)
    for n in np.flatnonzero(moved.max(axis=1) < 1e-6).tolist():
        a, b = fine[n][[0, -1]].tolist()
        fine[n] = np.linspace(a, b, int(np.ceil((b - a) / REST_EVERY)) + 1)
    return np.concatenate((times[:1], *(each[1:] for each in fine)))


def _rows(track: Track, profile: Profile, times: Floats) -> Floats:
    s, rate = profile.at(times)
    place, vel = track.at(s)
    vel = vel * rate[:, None]
    vel[-1] = 0.0
    return np.column_stack((times, np.round(place, ROUND_M), np.round(vel, ROUND_M)))


def _bend(track: Track, profile: Profile, rows: Floats) -> Floats:
    """(K - 1,): how far each cubic leaves the track, in m."""
    t = (rows[:-1, 0] + SHARES * np.diff(rows[:, 0])).ravel()
    flown, _ = _hermite(rows[:, 0], rows[:, 1:4], rows[:, 4:7], t)
    meant, _ = track.at(profile.at(t)[0])
    worst: Floats = np.linalg.norm(flown - meant, axis=1).reshape(len(SHARES), -1).max(axis=0)
    return worst


def flown(rows: Floats) -> Motion:
    """What a vehicle flies by these points, as samples: (T, 4), within millimetres in between."""
    count = max(1, int(np.ceil((rows[-1, 0] - rows[0, 0]) / DENSE)))
    return sampled(rows, np.unique(np.concatenate((rows[:, 0], np.linspace(rows[0, 0], rows[-1, 0], count + 1)))))


def sampled(rows: Floats, t: Floats) -> Motion:
    """Where a vehicle is at the times ``t`` by these points: (T, 4)."""
    place, _ = _hermite(rows[:, 0], rows[:, 1:4], rows[:, 4:7], t)
    return np.ascontiguousarray(np.column_stack((t, place)))


def state_at(rows: Floats, t: float) -> tuple[Floats, Floats]:
    """Place and velocity at ``t`` by these points, (3,) each."""
    place, vel = _hermite(rows[:, 0], rows[:, 1:4], rows[:, 4:7], np.array([t]))
    return place[0], vel[0]
