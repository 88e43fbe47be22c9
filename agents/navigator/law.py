"""How far along a way one is at a time: with limited speed, acceleration and jerk from rest to rest.

Between two speeds the acceleration rises at the jerk's limit, stays, and falls again (an S curve); it is zero where
one leg ends and the next begins, so that each is planned by itself between the speeds at its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agents.navigator.path import Array

HALVINGS = 60
NOTHING = 1e-9


@dataclass(frozen=True)
class Leg:
    """What is planned at once: ``length`` m at up to ``speed``, ``accel`` and ``jerk`` along the way.

    ``stop``: s at rest at its end; None: it is passed. The last one's way ends at rest in any case.
    """

    length: float
    speed: float
    accel: float
    jerk: float
    stop: float | None = 0.0


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

    def when(self, s: float) -> float:
        """The first time at which it is so far."""
        there = np.flatnonzero(abs(self.s - s) < NOTHING)
        if len(there):
            return float(self.t[there[0]])
        low, high = 0.0, self.end
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if float(self.at(np.array([middle]))[0][0]) < s - NOTHING:
                low = middle
            else:
                high = middle
        return high

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
    """The quickest of its kind, from rest to rest."""
    ends = _speeds(legs)
    rows: list[tuple[Array, ...]] = []
    t = s = 0.0
    for leg, (first, last) in zip(legs, pairwise(ends), strict=True):
        made = _chain(s, first, _phases(leg, first, last), t)
        rows.append(tuple(x[:-1] for x in made))
        t, s = float(made[0][-1]), s + leg.length
        if leg.stop:
            rows.append((np.array([t]), np.array([s]), *(np.zeros(1) for _ in range(3))))
            t += leg.stop
    rows.append((np.array([t]), np.array([s]), *(np.zeros(1) for _ in range(3))))
    return Law(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _speeds(legs: list[Leg]) -> list[float]:
    """At the legs' ends, the first one's beginning included: as high as can be reached and left again."""
    ends = [0.0]
    for leg, after in pairwise(legs):
        ends.append(0.0 if leg.stop is not None else min(leg.speed, after.speed))
    ends.append(0.0)
    for k, leg in enumerate(legs):
        ends[k + 1] = min(ends[k + 1], _reached(ends[k], leg))
    for k, leg in reversed(list(enumerate(legs))):
        ends[k] = min(ends[k], _reached(ends[k + 1], leg))
    return ends


def _reached(speed: float, leg: Leg) -> float:
    """The speed that a leg's length is enough for, from this one on; that to slow down from it is the same."""
    low, high = speed, max(leg.speed, speed)
    if _way(low, high, leg) <= leg.length:
        return high
    return _greatest(low, high, lambda v: _way(speed, v, leg) <= leg.length)


def _phases(leg: Leg, first: float, last: float) -> list[Phase]:
    low = max(first, last)

    def fits(v: float) -> bool:
        return _way(first, v, leg) + _way(v, last, leg) <= leg.length

    top = leg.speed if fits(leg.speed) else _greatest(low, max(leg.speed, low), fits)
    rest = max(leg.length - _way(first, top, leg) - _way(top, last, leg), 0.0)
    cruise = [(rest / top, 0.0, 0.0)] if rest > NOTHING else []
    return [*_ramp(first, top, leg), *cruise, *_ramp(top, last, leg)]


def _greatest(low: float, high: float, true: Callable[[float], bool]) -> float:
    """Where a condition that holds at ``low`` and not at ``high`` ends to hold."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if true(middle) else (low, middle)
    return low


def _way(v0: float, v1: float, leg: Leg) -> float:
    """m from one speed to another: the curve is symmetric about its middle."""
    return 0.5 * (v0 + v1) * sum(each[0] for each in _ramp(v0, v1, leg))


def _ramp(v0: float, v1: float, leg: Leg) -> list[Phase]:
    change, sign = abs(v1 - v0), math.copysign(1.0, v1 - v0)
    if change < NOTHING:
        return []
    top = min(leg.accel, math.sqrt(change * leg.jerk))
    rise, flat = top / leg.jerk, change / top - top / leg.jerk
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
