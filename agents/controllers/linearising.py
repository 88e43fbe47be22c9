"""Positions by feedback linearisation: EV2's outer loop, from errors of position to a thrust and where it points.

With p_e = p_ref - p, axes north, east and down, g downwards, mass m and the heading ψ that the vehicle has:

    U = p_ref'' + K_D p_e' + K_P p_e + K_I (p_e^{I,0} + ∫ p_e)          T = m |U - g|

and the roll and pitch whose thrust is against n = (g - U) / |g - U|:

    roll = asin(n_x sin ψ - n_y cos ψ)          pitch = atan2(n_x cos ψ + n_y sin ψ, n_z)

Their derivatives are those along U' = p_ref''' + K_D p_e'' + K_P p_e' + K_I p_e, with p_ref''' from one cycle's
acceleration to the next's, and p'' from an observer: what the rotors give by the model of their lag, and what the
velocity shows to be missing in that (wind). Nothing measured is differentiated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agents.controllers.backstepping import Vec, add, less, scaled, times

GRAVITY = 9.80665  # m/s²
DOWN = (0.0, 0.0, GRAVITY)
AHEAD_S = 1e-4  # the step of the tilt's derivatives
JERK_S = 0.03  # of the filter of p_ref'''
OBSERVER = 5.0  # 1/s, how soon the observer of p'' sees a wind
ROOM_ACROSS = 0.3  # of the most thrust, kept from the height's for the way, as PX4's MPC_THR_XY_MARG


@dataclass(frozen=True)
class Outer:
    """What the loop is tuned by; of matrices the diagonals: north, east, down."""

    kp: Vec
    """1/s²"""
    kd: Vec
    """1/s"""
    ki: Vec
    """1/s³"""
    speed_max: float
    """m/s beside the reference's that an error of position asks for"""
    integral_max: float
    """m/s²"""
    lean_max: float
    """rad"""
    least: float
    """m/s² of the rotors, as the next"""
    most: float
    rotor_tau: float
    """s"""


@dataclass(frozen=True)
class Aim:
    """What it asks for."""

    thrust: float
    """m/s² of the rotors together"""
    roll: float
    pitch: float
    roll_slope: float
    """rad/s"""
    pitch_slope: float


class Linearising:
    """Its three integrators are :attr:`integral`, m/s²: K_I (p_e^{I,0} + ∫ p_e). For gains that stay that is the same
    as an integral of p_e; a gain changed in flight does not jump, and it begins right even where K_I is zero.
    """

    def __init__(self) -> None:
        self.integral: Vec = (0.0, 0.0, 0.0)
        self.rotors = GRAVITY
        """m/s² that the rotors give now, by the model of their lag"""
        self._vel: Vec = (0.0, 0.0, 0.0)  # the observer's
        self._jerk: Vec = (0.0, 0.0, 0.0)
        self._before: Vec | None = None

    def reset(self, k: Outer, error: Vec, slip: Vec, acc: Vec, vel: Vec, axis: Vec, thrust: float) -> None:
        """Begin so that the first :meth:`step` of these errors asks for ``thrust`` (m/s²) against ``axis``, the down
        axis that the autopilot asks for, NED. ``vel``: the vehicle's.
        """
        asked = add(acc, _feedback(k, error, slip)[0])
        self.integral = less(less(DOWN, scaled(thrust, axis)), asked)
        self._vel = add(vel, scaled(1.0 / OBSERVER, self.integral))  # the integral is there against a wind
        self.rotors, self._jerk, self._before = thrust, (0.0, 0.0, 0.0), None

    def step(
        self, k: Outer, error: Vec, slip: Vec, acc: Vec, vel: Vec, yaw: float, yaw_rate: float, axis: Vec, dt: float
    ) -> Aim:  # fmt: skip
        """One cycle of ``dt`` s at p_e (m), p_e' (m/s), p_ref'' (m/s²) and p' (m/s), at that heading (rad,
        rad/s); ``axis``: the body's down, NED.
        """
        feedback, free = _feedback(k, error, slip)
        pull = less(DOWN, add(add(acc, feedback), self.integral))
        fitted = _fit(k, pull)
        thrust, roll, pitch = _aim(fitted, yaw)

        spring = times(free, add(times(k.kp, slip), times(k.ki, error)))
        u_dot = add(self._jerk_of(acc, dt), add(times(k.kd, less(acc, self._acc(vel, axis, dt))), spring))
        then = _fit(k, less(pull, scaled(AHEAD_S, u_dot)))
        _, roll_then, pitch_then = _aim(then, yaw + yaw_rate * AHEAD_S)

        self._integrate(k, error, free, less(pull, fitted), dt)
        self.rotors += (thrust - self.rotors) * (1.0 - math.exp(-dt / k.rotor_tau) if k.rotor_tau > 0.0 else 1.0)
        return Aim(thrust, roll, pitch, (roll_then - roll) / AHEAD_S, (pitch_then - pitch) / AHEAD_S)

    def _jerk_of(self, acc: Vec, dt: float) -> Vec:
        """p_ref''', m/s³."""
        before = acc if self._before is None else self._before
        self._before = acc
        share = 1.0 - math.exp(-dt / JERK_S)
        self._jerk = add(self._jerk, scaled(share, less(scaled(1.0 / dt, less(acc, before)), self._jerk)))
        return self._jerk

    def _acc(self, vel: Vec, axis: Vec, dt: float) -> Vec:
        """p'', m/s²."""
        now = add(less(DOWN, scaled(self.rotors, axis)), scaled(OBSERVER, less(vel, self._vel)))
        self._vel = add(self._vel, scaled(dt, now))
        return now

    def _integrate(self, k: Outer, error: Vec, free: Vec, excess: Vec, dt: float) -> None:
        """Not where that would ask for more of what cannot be had, nor beyond the limit (but from there back)."""
        kept = []
        for i in range(3):
            now = self.integral[i]
            most = max(k.integral_max, abs(now))
            step = k.ki[i] * error[i] * dt * free[i] if error[i] * excess[i] >= 0.0 else 0.0
            kept.append(min(max(now + step, -most), most))
        self.integral = (kept[0], kept[1], kept[2])


def _feedback(k: Outer, error: Vec, slip: Vec) -> tuple[Vec, Vec]:
    """K_D p_e' + K_P p_e, with p_e no longer than what asks for the speed there may be; and 1 where it is not cut."""
    x, y, z = times(k.kp, error)
    across, most = math.hypot(x, y), k.speed_max * k.kd[0]
    cut = most / across if across > most else 1.0
    up = k.speed_max * k.kd[2]
    free = 1.0 if cut == 1.0 else 0.0
    return add((x * cut, y * cut, min(max(z, -up), up)), times(k.kd, slip)), (free, free, 1.0 if abs(z) <= up else 0.0)


def _fit(k: Outer, pull: Vec) -> Vec:
    """g - U as it can be had: the height first, but for a margin that is kept for the way."""
    x, y, z = pull
    across = math.hypot(x, y)
    kept = min(across, ROOM_ACROSS * k.most)
    z = min(max(z, k.least), math.sqrt(k.most * k.most - kept * kept))
    room = min(z * math.tan(k.lean_max), math.sqrt(max(k.most * k.most - z * z, 0.0)))
    if across > room:
        x, y = x * room / across, y * room / across
    return x, y, z


def _aim(pull: Vec, yaw: float) -> tuple[float, float, float]:
    """|g - U|, roll and pitch; the third of ``pull`` is positive."""
    x, y, z = pull
    sine, cosine = math.sin(yaw), math.cos(yaw)
    size = math.sqrt(x * x + y * y + z * z)
    return size, math.asin((x * sine - y * cosine) / size), math.atan2(x * cosine + y * sine, z)
