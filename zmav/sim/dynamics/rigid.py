"""What bodies that fly share: their state, how a step goes from forces to motion, and how they stand still."""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import LAST, NEXT, Array, Flags, dot, quat_rate
from zmav.sim.dynamics.airframe import GRAVITY

_WEIGHT = np.array([[0.0], [0.0], [GRAVITY]])


class RigidBodies:
    """N equal rigid bodies, still at ``start`` (3, N); state as in :class:`zmav.sim.dynamics.body.Body`. An inertia
    (kg m^2) without products. A subclass sets ``q``, ``contact`` and ``resting`` (N,): those stay where they are.
    """

    dt: float
    q: Array
    contact: Flags
    resting: Flags

    def __init__(self, start: Array, mass_kg: float, inertia_kgm2: tuple[float, float, float]) -> None:
        n = start.shape[1]
        self.pos: Array = start.astype(float).copy()
        self.vel: Array = np.zeros((3, n))
        self.rate: Array = np.zeros((3, n))
        self.accel: Array = np.zeros((3, n))  # of the last step, m/s^2 NED, gravity included
        self.wind: Array = np.zeros((3, n))
        self.impact: Array = np.zeros(n)  # down speed of the last touch of the ground, m/s; cleared by who reads it
        self._mass = mass_kg
        self._inertia = np.array(inertia_kgm2)[:, None]
        jx, jy, jz = inertia_kgm2
        self._gyro_inertia = np.array([[jz - jy], [jx - jz], [jy - jx]])

    @property
    def n(self) -> int:
        return int(self.pos.shape[1])

    def stand(self) -> None:
        """A step in which all are at rest."""
        self.vel[:] = 0.0
        self.rate[:] = 0.0
        self.accel[:] = 0.0

    def linear(self, force: Array) -> Array:
        """Acceleration, m/s^2 NED, from what acts beside gravity (N, NED)."""
        accel: Array = force / self._mass + _WEIGHT
        return accel

    def angular(self, torque: Array) -> Array:
        """Angular acceleration, rad/s^2 body, from N m about the body's axes: J w' = tau - w x J w."""
        gyro = self.rate.take(NEXT, axis=0) * self.rate.take(LAST, axis=0)
        result: Array = (torque - gyro * self._gyro_inertia) / self._inertia
        return result

    def hold(self, accel: Array) -> None:
        """Take all motion from those at rest."""
        moving = ~self.resting
        self.vel *= moving
        self.rate *= moving
        accel *= moving

    def move(self, before: Array, accel: Array) -> None:
        """Go on from the velocity ``before`` to the new one, and turn at the new rate."""
        self.accel = accel
        self.pos += (before + self.vel) * (0.5 * self.dt)
        self.q += quat_rate(self.q, self.rate * self.dt)
        self.q /= np.sqrt(dot(self.q, self.q))
