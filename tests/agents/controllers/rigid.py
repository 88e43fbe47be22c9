"""A multirotor as its textbook has it, for tests of controllers: one rigid body, integrated by Runge-Kutta.

    p' = v,   m v' = m g + F - T R e3,   q' = q (0, Ω) / 2,   I Ω' = τ - Ω x I Ω,   T and τ lag by ``rotor_tau``

North, east, down; forward, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from agents.controllers import Array, Reference, State, TorqueThrust, Trim
from agents.controllers.ev2 import Ev2

GRAVITY = 9.80665
CYCLE = 0.004
HOVER = Reference(pos=np.zeros(3))


@dataclass
class Body:
    """``row`` (17,): p, v, q, Ω, T (N), τ (N m)."""

    mass: float = 3.2
    inertia: tuple[float, float, float] = (0.043, 0.040, 0.069)
    full: float = 62.1
    torques: tuple[float, float, float] = (6.98, 6.98, 0.994)
    rotor_tau: float = 0.035
    force: Array = field(default_factory=lambda: np.zeros(3))
    t: float = 0.0
    row: Array = field(default_factory=lambda: np.zeros(17))

    def __post_init__(self) -> None:
        self.row[6] = 1.0
        self.row[13] = self.mass * GRAVITY

    def state(self) -> State:
        pos, vel, q, rates = (part.copy() for part in np.split(self.row[:13], [3, 6, 10]))
        return State(self.t, CYCLE, pos, vel, q, rates)

    def trim(self) -> Trim:
        """Of an autopilot that would have it stay as it is."""
        return Trim(self.row[13] / self.full, self.row[6:10].copy(), self.row[10:13].copy())

    def turn(self, roll: float, pitch: float, yaw: float) -> None:
        self.row[6:10] = quaternion(roll, pitch, yaw)

    def step(self, output: TorqueThrust) -> None:
        goal = np.append(output.thrust * self.full, output.torque * self.torques)
        y, h = self.row, CYCLE
        a = self._slope(y, goal)
        b = self._slope(y + 0.5 * h * a, goal)
        c = self._slope(y + 0.5 * h * b, goal)
        d = self._slope(y + h * c, goal)
        y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        y[6:10] /= np.linalg.norm(y[6:10])
        self.row = y
        self.t += h

    def _slope(self, y: Array, goal: Array) -> Array:
        # By numbers: for arrays as short as these NumPy takes ten times as long.
        vn, ve, vd, w, x, y_, z, p, q, r, *given = y[3:].tolist()
        thrust, *torque = given
        fn, fe, fd = self.force.tolist()
        lift = thrust / (w * w + x * x + y_ * y_ + z * z) / self.mass
        return np.array(
            [
                *(vn, ve, vd),
                fn / self.mass - lift * 2.0 * (x * z + w * y_),
                fe / self.mass - lift * 2.0 * (y_ * z - w * x),
                fd / self.mass - lift * (w * w - x * x - y_ * y_ + z * z) + GRAVITY,
                0.5 * (-x * p - y_ * q - z * r),
                0.5 * (w * p + y_ * r - z * q),
                0.5 * (w * q + z * p - x * r),
                0.5 * (w * r + x * q - y_ * p),
                *spin((p, q, r), torque, self.inertia),
                *((wish - has) / self.rotor_tau for wish, has in zip(goal.tolist(), given, strict=True)),
            ]
        )


def spin(rates: Sequence[float], torque: Sequence[float], inertia: Sequence[float]) -> tuple[float, float, float]:
    """Angular acceleration, rad/s^2 body: Euler's equations of a body with these principal moments."""
    (p, q, r), (roll, pitch, yaw), (ix, iy, iz) = rates, torque, inertia
    return (roll - (iz - iy) * q * r) / ix, (pitch - (ix - iz) * r * p) / iy, (yaw - (iy - ix) * p * q) / iz


def quaternion(roll: float, pitch: float, yaw: float) -> Array:
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def fly(ev2: Ev2, body: Body, reference: Reference, seconds: float) -> list[State]:
    """The states of each cycle; anyone who calls has reset the controller."""
    states = []
    for _ in range(round(seconds / CYCLE)):
        states.append(body.state())
        output = ev2.update(states[-1], reference)
        assert isinstance(output, TorqueThrust)
        body.step(output)
    return states
