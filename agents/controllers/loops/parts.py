"""What the loops are made of: one axis of a PID that begins without a jump, the thrust that hovers, quaternions."""

from __future__ import annotations

import math
from collections.abc import Iterable

from zmav.rotation import Quaternion, from_euler, product

GRAVITY = 9.80665
SETTLE = 1.0
"""s over which an integrator follows what is needed of it while the autopilot flies, so that it takes over what lasts
(wind, a wrong hover thrust) and not what is of the moment"""
MOST = 3.0
"""m/s² that an integrator begins with at most, either way: against a wind of some 10 m/s. More does not last"""
LEARN = 2.0
"""s in which the hover thrust is learned meanwhile: what was believed on the ground is soon forgotten"""
FADE = 0.3
"""s in which the rest fades out once this flies"""
HOVER_LEAST, HOVER_MOST = 0.1, 0.9
FALLING = 0.5
"""g: with less of a load nothing is learned about the hover thrust"""
Vector = tuple[float, float, float]


class Lately:
    """Mean and mean square of what has come in lately."""

    def __init__(self) -> None:
        self.mean = self.square = 0.0

    def take(self, value: float, share: float) -> None:
        self.mean += (value - self.mean) * share
        self.square += (value * value - self.square) * share


class Axis:
    """State of a PID on one axis: integrator, slope of what is measured, and what fades out after a hand-over."""

    def __init__(self) -> None:
        self.integral = 0.0
        self.slope = 0.0
        self.fading = 0.0
        self._unseen = math.inf
        self._needed, self._flies = Lately(), Lately()
        self._value, self._t = 0.0, -math.inf

    def measure(self, value: float, t: float, cutoff_hz: float) -> float:
        """The low-passed slope at time ``t`` (s); of two calls for one time the second changes nothing."""
        dt = t - self._t
        if dt > 0.0:
            if math.isfinite(dt):
                share = dt / (dt + 1.0 / (math.tau * cutoff_hz))
                self.slope += ((value - self._value) / dt - self.slope) * share
            self._value, self._t = value, t
        return self.slope

    def settle(self, flies: float, partly: float, dt: float) -> None:
        """``flies``: what the autopilot asks for now; ``partly``: what the loop gives without integrator.

        The integrator is to be what lasts. That is the difference where both follow the same reference, but the whole
        where this one's lies elsewhere until it takes over: of the two, what has been smaller lately.
        """
        needed = flies - partly
        since = dt + self._unseen
        share = since / (since + SETTLE) if math.isfinite(since) else 1.0
        self._needed.take(needed, share)
        self._flies.take(flies, share)
        lasts = self._needed if self._needed.square < self._flies.square else self._flies
        self.integral = clamp(lasts.mean, -MOST, MOST)
        self.fading = needed - self.integral
        self._unseen = 0.0

    def forget(self, dt: float) -> None:
        """Let the integrator run down."""
        self.integral *= SETTLE / (SETTLE + dt)

    def add(self, change: float, dt: float, most: float) -> None:
        """After each cycle."""
        self.integral = clamp(self.integral + change * dt, -most, most)
        self._unseen += dt
        self.fading *= FADE / (FADE + dt)


class Hover:
    """The share of full thrust that carries the weight: begun with what the autopilot gives, and corrected slowly by
    the vertical acceleration that comes of a thrust, as PX4's hover thrust estimator does (MPC_USE_HTE).
    """

    def __init__(self) -> None:
        self.share = 0.5
        self._begun = False

    def learn(self, upward: float, acc_down: float, dt: float, tau: float) -> float:
        """``upward``: the vertical part of the thrust, 0 to 1; ``acc_down`` m/s². Gives old over new."""
        load = 1.0 - acc_down / GRAVITY
        if load < FALLING:
            return 1.0
        found = clamp(upward / load, HOVER_LEAST, HOVER_MOST)
        before = self.share if self._begun else found
        self._begun = True
        self.share = before + (found - before) * dt / (dt + tau)
        return before / self.share


def clamp(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


def shortened(x: float, y: float, most: float) -> tuple[float, float]:
    """The vector, no longer than ``most``."""
    length = math.hypot(x, y)
    return (x, y) if length <= most else (x * most / length, y * most / length)


def turn_from(actual: Quaternion, target: Quaternion) -> Quaternion:
    """The rotation from ``actual`` to ``target``, in body axes."""
    w, x, y, z = actual
    return product((w, -x, -y, -z), target)


def down_axis(q: Iterable[float]) -> Vector:
    """The body's down axis in NED."""
    w, x, y, z = q
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


def attitude_of(down: Vector, yaw: float) -> Quaternion:
    """The attitude whose down axis is ``down`` (a unit vector, NED) and whose nose points to ``yaw``; for leans below
    90 degrees. Source: Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA
    2011, section IV.
    """
    x, y, z = down
    c, s = math.cos(yaw), math.sin(yaw)
    # In the frame turned by yaw the nose is level: roll and pitch follow from the down axis seen there.
    roll, pitch = math.asin(clamp(x * s - y * c, -1.0, 1.0)), math.atan2(x * c + y * s, z)
    return from_euler(roll, pitch, yaw)
