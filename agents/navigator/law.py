"""How far along a way one is at a time: each leg from rest to rest, with limited speed, acceleration and jerk.

Between two speeds the acceleration rises at the jerk's limit, stays, and falls again (an S curve).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.navigator.path import Array

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
