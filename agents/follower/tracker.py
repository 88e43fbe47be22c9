"""Where the target is: a constant-velocity Kalman filter in the plane, with gating. No clock and no network in here.

Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
sections 6.2 (white-noise acceleration) and 3.4 (gates). What is seen is of the past by the time it is known: the filter
stays at the time of the last sight, and anyone who asks is given a prediction for the time that he asks about.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GATE = 13.8
"""squared Mahalanobis distance in the plane that one true sight in a thousand exceeds"""
FIRST_SPEED, TOLD_SPEED = 1.5, 0.15
"""m/s: how fast a target may be of which nothing is known; and beside what it says itself"""
LEAST = 0.02
"""m: nothing is seen better than this, whatever it says of itself"""
SOON = 2.5
"""s after its first sight within which a second one must agree: before that it is no target, but may be anything"""
SURE = 4
"""sights in a row that were outside of the gate, near each other: it is the filter that is wrong"""
NEAR = 0.6
"""m that such sights may be apart, plus what a target may move between them"""


@dataclass(frozen=True)
class TargetEstimate:
    """Of one moment. ``pos``, ``vel``: (2,) north, east; ``sigma``: m, the position's larger semi-axis."""

    t: float
    pos: Array
    vel: Array
    sigma: float


class Tracker:
    """One target. Times are UTC seconds, places metres north and east about the fleet's origin.

    ``accel``: m/s², the standard deviation of what the target does beyond going straight on, over a second.
    """

    def __init__(self, accel: float = 0.8) -> None:
        self.accel = accel
        self._t: float | None = None
        self._confirmed = False
        """a second sight agreed with the first"""
        self._x: Array = np.zeros(4)
        self._p: Array = np.zeros((4, 4))
        self._strays: list[tuple[float, Array]] = []

    @property
    def t(self) -> float | None:
        """When the target was seen last; None: never, or once."""
        return self._t if self._confirmed else None

    def forget(self) -> None:
        self._t, self._confirmed, self._strays = None, False, []

    def see(
        self,
        t: float,
        pos: tuple[float, float],
        covariance: tuple[float, float, float] | None = None,
        told: tuple[float, float] | None = None,
        may_be_another: bool = True,
    ) -> bool:
        """It was seen at ``pos`` at ``t``; ``covariance``: north-north, north-east, east-east (m²); ``told``: the
        velocity (m/s) that it says itself, with which the filter begins; ``may_be_another``: outside of the gate it
        counts for another target. Whether that was believed: the first of all is not, nor what is outside of the gate,
        until several such sights agree with each other.
        """
        z, r = np.array(pos, dtype=np.float64), _covariance(covariance)
        if not (math.isfinite(t) and np.isfinite(z).all() and np.isfinite(r).all()):
            return False
        since = 0.0 if self._t is None else t - self._t
        if self._t is None or (not self._confirmed and abs(since) > SOON):
            self._begin(t, z, r, np.zeros(2), told)
            return False
        if since <= 0.0:
            return False
        x, p = self._ahead(t)
        s = p[:2, :2] + r
        off = z - x[:2]
        if float(off @ np.linalg.solve(s, off)) > GATE:
            return may_be_another and self._stray(t, z, r, told)
        gain = np.linalg.solve(s, p[:2]).T
        left = np.eye(4)
        left[:, :2] -= gain
        self._t, self._x, self._confirmed = t, x + gain @ off, True
        self._p = left @ p @ left.T + gain @ r @ gain.T
        self._strays = []
        return True

    def at(self, t: float) -> TargetEstimate | None:
        """Where it is at ``t`` as far as is known, before or after the last sight; None as of :attr:`t`."""
        if (seen := self.t) is None:
            return None
        if t < seen:
            back = self._x[:2] + (t - seen) * self._x[2:]
            return TargetEstimate(t, back, self._x[2:].copy(), _sigma(self._p))
        x, p = self._ahead(t)
        return TargetEstimate(t, x[:2], x[2:], _sigma(p))

    def _begin(self, t: float, z: Array, r: Array, vel: Array, told: tuple[float, float] | None) -> None:
        within = FIRST_SPEED
        if told is not None and np.isfinite(told).all():
            vel, within = np.array(told), TOLD_SPEED
        self._t, self._x = t, np.concatenate([z, vel])
        self._p = np.zeros((4, 4))
        self._p[:2, :2], self._p[2:, 2:] = r, np.eye(2) * within**2
        self._strays = []

    def _stray(self, t: float, z: Array, r: Array, told: tuple[float, float] | None) -> bool:
        """Outside of the gate. Where enough such sights in a row are one moving thing, that is the target."""
        if self._strays:
            before, place = self._strays[-1]
            if t <= before:
                return False
            if float(np.linalg.norm(z - place)) > NEAR + 2.0 * FIRST_SPEED * (t - before):
                self._strays = []
        self._strays.append((t, z))
        if len(self._strays) < SURE:
            return False
        first, place = self._strays[0]
        self._begin(t, z, r, (z - place) / (t - first), told)
        self._confirmed = True
        return True

    def _ahead(self, t: float) -> tuple[Array, Array]:
        assert self._t is not None
        dt = t - self._t
        f = np.eye(4)
        f[0, 2] = f[1, 3] = dt
        q = np.zeros((4, 4))
        for i in (0, 1):
            q[i, i], q[i, i + 2], q[i + 2, i], q[i + 2, i + 2] = dt**3 / 3.0, dt**2 / 2.0, dt**2 / 2.0, dt
        return f @ self._x, f @ self._p @ f.T + q * self.accel**2


def _covariance(told: tuple[float, float, float] | None) -> Array:
    nn, ne, ee = told or (0.0, 0.0, 0.0)
    least = LEAST * LEAST
    nn, ee = max(nn, least), max(ee, least)
    bound = 0.95 * math.sqrt(nn * ee)
    ne = max(-bound, min(bound, ne))
    return np.array([[nn, ne], [ne, ee]])


def _sigma(p: Array) -> float:
    return float(math.sqrt(max(np.linalg.eigvalsh(p[:2, :2])[-1], 0.0)))
