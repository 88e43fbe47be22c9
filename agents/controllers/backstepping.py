"""Attitude by command-filtered backstepping: EV2's inner loop, from Euler angles to torques in N m.

The plant, with roll, pitch and yaw Φ (turned yaw first), body rates Ω, inertia I and torque τ:

    Φ' = W(Φ) Ω                      I Ω' = τ - Ω x I Ω

Backstepping chooses rates Ω_d that would bring the error Z1 = Φ_ref - Φ down, and torques that bring the rates there.
A filter takes the place of the derivative of Ω_d, and ε keeps account of what the filter leaves out, so that the
compensated error Z̄1 = Z1 - ε knows nothing of it (J. A. Farrell, M. Polycarpou, M. Sharma, W. Dong, "Command filtered
backstepping", IEEE Transactions on Automatic Control 54(6), 2009):

    Ω_d    = W^-1 (Φ_ref' + Γ1 Z1)
    Ω_ref' = -Γ̄ (Ω_ref - Ω_d)
    ε'     = -Γ1 ε - W (Ω_ref - Ω_d)
    Z2     = Ω_ref - Ω
    τ      = Ω x I Ω + Γ2 Z2 + I (W^T Z̄1 + Ω_ref')

Put in, this leaves Z̄1' = -Γ1 Z̄1 + W Z2 and I Z2' = -Γ2 Z2 - I W^T Z̄1, and so for V = (|Z̄1|² + |Z2|²) / 2

    V' = -Z̄1^T Γ1 Z̄1 - Z2^T I^-1 Γ2 Z2  <  0

whatever the references do, as long as the torque is given. Rates and turning accelerations asked for are limited in the
filter, where that paper puts limits: Ω_ref follows the limited, ε is told of the whole.

Plain floats: an array of three costs more than the sums in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from zmav.rotation import wrap

Vec = tuple[float, float, float]

LEAST_COSINE = 0.17
"""of the pitch (80 degrees): W is infinite with the nose straight up, and what is beyond counts as this"""


@dataclass(frozen=True)
class Inner:
    """What the loop is tuned by; each is the diagonal of its matrix, about the body's axes."""

    gamma1: Vec
    """1/s, of the angles' errors"""
    gamma2: Vec
    """N m s, of the rates' errors"""
    gamma_bar: Vec
    """1/s, of the filter"""
    inertia: Vec
    """kg m²"""
    rate_max: Vec
    """rad/s that are asked for"""
    turn_max: Vec
    """rad/s² that are asked for"""


class Backstepping:
    """Its six integrators are Ω_ref (:attr:`omega_ref`, rad/s) and ε (:attr:`epsilon`, rad)."""

    def __init__(self) -> None:
        self.omega_ref: Vec = (0.0, 0.0, 0.0)
        self.epsilon: Vec = (0.0, 0.0, 0.0)
        self.z1 = self.z1_bar = self.z2 = self.omega_d = (0.0, 0.0, 0.0)
        """of the last step, to be shown"""

    @property
    def lyapunov(self) -> float:
        """V of the last step; what falls as long as the model holds and no limit is met."""
        return 0.5 * sum(each * each for each in (*self.z1_bar, *self.z2))

    def reset(self, rates: Vec) -> None:
        """Begin at the vehicle's present rates: the filter then adds no torque but that of the way to Ω_d."""
        self.omega_ref, self.epsilon = rates, (0.0, 0.0, 0.0)

    def step(self, k: Inner, angles: Vec, rates: Vec, wanted: Vec, slopes: Vec, dt: float) -> Vec:
        """Torque (N m) at Euler angles and body rates, for those angles ``wanted`` and their derivatives ``slopes``;
        ``dt`` (s) is how long the torque will be in force. Radians and rad/s, none of them limited in size.
        """
        z1 = less(wanted, angles)
        z1 = (wrap(z1[0]), wrap(z1[1]), wrap(z1[2]))
        omega_d = rates_of(angles, add(slopes, times(k.gamma1, z1)))
        z2 = less(self.omega_ref, rates)
        z1_bar = less(z1, self.epsilon)

        # The filter's derivative as its mean over the step, which stays stable however long that is.
        goal = _within(omega_d, k.rate_max)
        fade, kept = _fading(k.gamma_bar, dt), _fading(k.gamma1, dt)
        share = scaled(1.0 / dt, less((1.0, 1.0, 1.0), fade))
        omega_dot = _within(times(share, less(goal, self.omega_ref)), k.turn_max)
        back = _push(angles, z1_bar)
        ix, iy, iz = k.inertia
        p, q, r = rates
        torque = (
            q * r * (iz - iy) + k.gamma2[0] * z2[0] + ix * (back[0] + omega_dot[0]),
            r * p * (ix - iz) + k.gamma2[1] * z2[1] + iy * (back[1] + omega_dot[1]),
            p * q * (iy - ix) + k.gamma2[2] * z2[2] + iz * (back[2] + omega_dot[2]),
        )

        missed = angle_rates(angles, less(self.omega_ref, omega_d))
        self.epsilon = less(times(kept, self.epsilon), scaled(dt, missed))
        self.omega_ref = add(self.omega_ref, scaled(dt, omega_dot))
        self.z1, self.z1_bar, self.z2, self.omega_d = z1, z1_bar, z2, omega_d
        return torque


def angle_rates(angles: Vec, rates: Vec) -> Vec:
    """W(Φ) Ω: derivatives of roll, pitch and yaw at body rates."""
    p, q, r = rates
    sr, cr, sp, cp = _sines(angles)
    yaw = (sr * q + cr * r) / cp
    return p + sp * yaw, cr * q - sr * r, yaw


def rates_of(angles: Vec, slopes: Vec) -> Vec:
    """W(Φ)^-1 Φ': body rates at derivatives of roll, pitch and yaw. Finite at every attitude."""
    roll, pitch, yaw = slopes
    sr, cr = math.sin(angles[0]), math.cos(angles[0])
    sp, cp = math.sin(angles[1]), math.cos(angles[1])
    return roll - sp * yaw, cr * pitch + sr * cp * yaw, cr * cp * yaw - sr * pitch


def _push(angles: Vec, error: Vec) -> Vec:
    """W(Φ)^T Z̄1."""
    roll, pitch, yaw = error
    sr, cr, sp, cp = _sines(angles)
    turn = (sp * roll + yaw) / cp
    return roll, cr * pitch + sr * turn, cr * turn - sr * pitch


def _sines(angles: Vec) -> tuple[float, float, float, float]:
    """Sine and cosine of roll, and of a pitch that is kept from where W has no value."""
    cosine = math.cos(angles[1])
    return math.sin(angles[0]), math.cos(angles[0]), math.sin(angles[1]), max(cosine, LEAST_COSINE)


def less(a: Vec, b: Vec) -> Vec:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def add(a: Vec, b: Vec) -> Vec:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def times(a: Vec, b: Vec) -> Vec:
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


def scaled(size: float, a: Vec) -> Vec:
    return size * a[0], size * a[1], size * a[2]


def _fading(rates: Vec, dt: float) -> Vec:
    return math.exp(-rates[0] * dt), math.exp(-rates[1] * dt), math.exp(-rates[2] * dt)


def _within(a: Vec, limit: Vec) -> Vec:
    return (
        min(max(a[0], -limit[0]), limit[0]),
        min(max(a[1], -limit[1]), limit[1]),
        min(max(a[2], -limit[2]), limit[2]),
    )
