"""A route in time: what is to be flown at any moment, and as segments that a vehicle flies by itself.

Each leg is flown from rest to rest, with limited speed, acceleration and jerk. Between two speeds the acceleration
rises at the jerk's limit, stays, and falls again (an S curve).

Straight ways use the limits in full. On a curve the acceleration is shared between along and across the way, and the
jerk between what speeds up, what the two do together, and what turns, so that no moment is beyond a limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.navigator.path import Array
from agents.navigator.routes import Route, RoutePiece, check
from zmav import wire
from zmav.rotation import wrap

HALVINGS = 60
NOTHING = 1e-9


@dataclass(frozen=True)
class Leg:
    """``length`` m at up to ``speed``, ``accel`` and ``jerk`` along the way, and ``stop`` s at rest at its end."""

    length: float
    speed: float
    accel: float
    jerk: float
    stop: float = 0.0


Phase = tuple[float, float, float]
"""s that it lasts, acceleration at its beginning, jerk"""


class Law:
    """Pieces of constant jerk: at ``t`` (K,) the distance ``s``, speed ``v`` and acceleration ``a``, with ``j`` from
    there. The last one rests.
    """

    def __init__(self, t: Array, s: Array, v: Array, a: Array, j: Array) -> None:
        self.t, self.s, self.v, self.a, self.j = t, s, v, a, j

    @property
    def end(self) -> float:
        """s at which it comes to rest for good."""
        return float(self.t[-1])

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """(N,) each: distances, speeds and accelerations; at rest before zero and after the end."""
        t = np.clip(t, 0.0, self.end)
        k = np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)
        x, j = t - self.t[k], self.j[k]
        s = self.s[k] + x * (self.v[k] + x * (self.a[k] / 2.0 + x * j / 6.0))
        return s, np.maximum(self.v[k] + x * (self.a[k] + x * j / 2.0), 0.0), self.a[k] + x * j

    def braked(self, t: float, accel: float, jerk: float) -> Law:
        """The same until ``t``, and then to rest at these limits, or where it rests next by itself if sooner."""
        (s,), (v,), (a,) = self.at(np.array([t]))
        phases = _halt(float(v), float(a), accel, jerk)
        made = _chain(float(s), float(v), phases, t)
        resting = np.flatnonzero((self.t >= t) & (self.v < NOTHING) & (abs(self.a) < NOTHING))
        if len(resting) and self.s[resting[0]] <= made[1][-1]:
            last = int(resting[0]) + 1
            none = np.array([0.0])
            return Law(
                self.t[:last], self.s[:last], *(np.append(x[: last - 1], none) for x in (self.v, self.a, self.j))
            )
        keep = self.t < t - NOTHING
        old = (self.t, self.s, self.v, self.a, self.j)
        return Law(*(np.concatenate((x[keep], more)) for x, more in zip(old, made, strict=True)))


def plan(legs: list[Leg]) -> Law:
    """The quickest of its kind."""
    rows: list[tuple[Array, ...]] = []
    t = s = 0.0
    for leg in legs:
        made = _chain(s, 0.0, _phases(leg), t)
        rows.append(tuple(x[:-1] for x in made))
        t, s = float(made[0][-1]), s + leg.length
        if leg.stop:
            rows.append((np.array([t]), np.array([s]), *(np.zeros(1) for _ in range(3))))
            t += leg.stop
    rows.append((np.array([t]), np.array([s]), *(np.zeros(1) for _ in range(3))))
    return Law(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _phases(leg: Leg) -> list[Phase]:
    """Up to the greatest speed that the length is enough for, on at it, and down again."""
    low, high = 0.0, leg.speed
    if 2.0 * _way(high, leg) > leg.length:
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if 2.0 * _way(middle, leg) <= leg.length else (low, middle)
        high = low
    rest = max(leg.length - 2.0 * _way(high, leg), 0.0)
    cruise = [(rest / high, 0.0, 0.0)] if rest > NOTHING else []
    return [*_ramp(high, 1.0, leg), *cruise, *_ramp(high, -1.0, leg)]


def _way(speed: float, leg: Leg) -> float:
    """m from rest to a speed, or back: the curve is symmetric about its middle."""
    return 0.5 * speed * sum(each[0] for each in _ramp(speed, 1.0, leg))


def _ramp(speed: float, sign: float, leg: Leg) -> list[Phase]:
    """From rest to a speed (``sign`` 1.0), or from it to rest (-1.0)."""
    if speed < NOTHING:
        return []
    top = min(leg.accel, math.sqrt(speed * leg.jerk))
    rise, flat = top / leg.jerk, speed / top - top / leg.jerk
    middle = [(flat, sign * top, 0.0)] if flat > NOTHING else []
    return [(rise, 0.0, sign * leg.jerk), *middle, (rise, sign * top, -sign * leg.jerk)]


def _halt(v: float, a: float, accel: float, jerk: float) -> list[Phase]:
    """From a speed and an acceleration along the way to rest."""
    if v < NOTHING and abs(a) < NOTHING:
        return []
    accel = max(accel, -a)
    most = math.sqrt(max(jerk * v + 0.5 * a * a, 0.0))
    top = max(min(accel, most), -a)
    flat = max(0.0, (v + (0.5 * a * a - top * top) / jerk) / top) if top > NOTHING else 0.0
    middle = [(flat, -top, 0.0)] if flat > NOTHING else []
    return [((a + top) / jerk, a, -jerk), *middle, (top / jerk, -top, jerk)]


def _chain(s: float, v: float, phases: list[Phase], t: float) -> tuple[Array, Array, Array, Array, Array]:
    """Rows of a law from there on, and as the last one where it has come to, with neither acceleration nor jerk."""
    rows = []
    for lasts, a, j in phases:
        rows.append((t, s, v, a, j))
        s += lasts * (v + lasts * (a / 2.0 + lasts * j / 6.0))
        v += lasts * (a + lasts * j / 2.0)
        t += lasts
    rows.append((t, s, v, 0.0, 0.0))
    times, ways, speeds, accels, jerks = (np.array(column) for column in zip(*rows, strict=True))
    if rows[-1][2] < 1e-6:
        speeds[-1] = 0.0
    return times, ways, speeds, accels, jerks


WINDOW = 20.0
"""s of the way that a segment has before it brakes"""
KNOT, REST = 0.25, 5.0
"""s between two points of a segment on a curve, and elsewhere, at most"""
LEAST = 1.0
"""s that one lasts at least, at rest in the end: a vehicle takes none that is over when it comes there"""
CLOSEST, BESIDE = 0.021, 0.1
"""s between two points at least; beside where the jerk changes, so that what is left out there bends nothing farther"""


@dataclass(frozen=True)
class Limits:
    """m/s, m/s² and m/s³, of the whole motion. Raises :class:`~zmav.errors.BadInput`."""

    speed: float = 1.0
    accel: float = 1.0
    jerk: float = 2.0

    def __post_init__(self) -> None:
        check("speed", self.speed, 0.05, 20.0, "m/s")
        check("accel", self.accel, 0.05, 10.0, "m/s²")
        check("jerk", self.jerk, 0.05, 100.0, "m/s³")


@dataclass(frozen=True)
class Moment:
    """(N, 3) each: m, m/s and m/s² NED; along (N,) m of the way."""

    pos: Array
    vel: Array
    acc: Array
    along: Array


class Trajectory:
    """A route flown from rest to rest within limits, from ``t`` = 0 on, with the heading ``yaw`` (rad)."""

    def __init__(self, route: Route, limits: Limits, yaw: float = 0.0, law: Law | None = None) -> None:
        self.route, self.limits, self.yaw = route, limits, yaw
        self._legs = [_leg(stage, limits) for stage in route.stages]
        self.law = plan(self._legs) if law is None else law

    @property
    def duration(self) -> float:
        """s"""
        return self.law.end

    @property
    def begins(self) -> float:
        """s at which the route itself does, at the end of the way to it, dwell included; inf: it is not come to"""
        if self.route.begins == 0.0:
            return 0.0
        rows = np.flatnonzero(self.law.s > self.route.begins + 1e-9)
        return float(self.law.t[int(rows[0]) - 1]) if len(rows) else math.inf

    def at(self, t: Array) -> Moment:
        """What is to be flown at the times ``t`` (N,); at rest before zero and after the end."""
        s, v, a = self.law.at(t)
        place, tangent, bend = self.route.at(s)
        acc = a[:, None] * tangent + (v * v)[:, None] * bend
        return Moment(place, v[:, None] * tangent, acc, s)

    def braked(self, t: float) -> Trajectory:
        """The same until ``t``, and from there to rest along the way as soon as the limits allow: on the leg that it is
        on, at whose end it rests in any case.
        """
        leg = self._legs[self._stage(t)]
        return Trajectory(self.route, self.limits, self.yaw, self.law.braked(t, leg.accel, leg.jerk))

    def points(self, begin: float, t0: float) -> list[wire.SegmentPoint]:
        """From ``begin`` until it rests; ``t0``: UTC s at which it is at 0. Between two of them the vehicle flies the
        polynomial of the fifth degree, which on straight ways is the way itself, and elsewhere less than 1 mm off it.
        """
        times = np.round(self._knots(begin) + t0, 6) - t0  # it is where it should be at the times that are told
        found = self.at(times)
        points, yaw = [], round(wrap(self.yaw), 6)
        for k, t in enumerate(times):
            last = k + 1 == len(times)
            pos, vel, acc = (_vector(rows[k]) for rows in (found.pos, found.vel, found.acc))
            still = (0.0, 0.0, 0.0)
            points.append(
                wire.SegmentPoint(
                    t=round(t0 + float(t), 6), pos=pos, vel=still if last else vel, acc=still if last else acc, yaw=yaw
                )
            )
        return points

    def segment(self, begin: float, t0: float, window: float = WINDOW) -> list[wire.SegmentPoint]:
        """As :meth:`points`, of ``window`` s, after which it brakes; where less is left, until its end.

        The next one, given before the window's end, takes its place while both are on the same way.
        """
        if begin + window >= self.duration:
            return self.points(begin, t0)
        return self.braked(begin + window).points(begin, t0)

    def _knots(self, begin: float) -> Array:
        """(K,) s: ``begin``, wherever the jerk changes, some in between, and the end or :data:`LEAST` s later."""
        end = max(self.duration, begin + LEAST)
        marks = self.law.t[(self.law.t > begin) & (self.law.t < end)]
        found = [begin]
        for mark in (*marks, end):
            gap = float(mark) - found[-1]
            if gap > 4 * BESIDE:
                bends = self._bends(0.5 * (found[-1] + float(mark)))
                first, inside = found[-1] + BESIDE, gap - 2 * BESIDE
                count = math.ceil(inside / (KNOT if bends else REST))
                found += [first + inside * k / count for k in range(count + 1)]
            found.append(float(mark))
        return np.array(_thinned(found))

    def _bends(self, t: float) -> bool:
        return self.route.stages[self._stage(t)].piece.bend > 0.0

    def _stage(self, t: float) -> int:
        """The index of the stage that it is on at ``t``."""
        return int(self.route.stage_at(self.law.at(np.array([t]))[0])[0])


def _leg(stage: RoutePiece, limits: Limits) -> Leg:
    piece, speed = stage.piece, limits.speed
    if piece.bend == 0.0:
        return Leg(piece.length, speed, limits.accel, limits.jerk, stage.dwell)
    share = limits.accel / math.sqrt(2.0)
    speed = min(speed, math.sqrt(share / piece.bend), (limits.jerk / 3.0 / piece.jolt) ** (1.0 / 3.0))
    accel = min(share, limits.jerk / (9.0 * speed * piece.bend))
    return Leg(piece.length, speed, accel, limits.jerk / 3.0, stage.dwell)


def _thinned(times: list[float]) -> list[float]:
    """Without those that come too soon after the one before; both ends stay."""
    kept = times[:1]
    for t in times[1:-1]:
        if t - kept[-1] >= CLOSEST and times[-1] - t >= CLOSEST:
            kept.append(t)
    return [*kept, times[-1]]


def _vector(row: Array) -> wire.Vector:
    north, east, down = (round(float(x), 7) + 0.0 for x in row)
    return north, east, down
