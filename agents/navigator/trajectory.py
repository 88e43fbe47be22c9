"""A route in time: what is to be flown at any moment, and as segments that a vehicle flies by itself.

Straight ways use the limits in full. On a curve the acceleration is shared between along and across the way, and the
jerk between what speeds up, what the two do together, and what turns, so that no moment is beyond a limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.navigator.law import Law, Leg, plan
from agents.navigator.path import Array
from agents.navigator.routes import Route, RoutePiece, check
from zmav import wire
from zmav.rotation import wrap

WINDOW = 20.0
"""s of the way that a segment has before it brakes"""
KNOT, REST = 0.25, 5.0
"""s between two points of a segment on a curve, and elsewhere, at most"""
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
        """(K,) s: ``begin``, wherever the jerk changes, some in between, and the end."""
        end = max(self.duration, begin + 2 * CLOSEST)
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
