"""The estimate that controllers and telemetry see: the truth, plus a slowly wandering GPS error when one is asked for.

The error is a first-order Gauss-Markov process per axis (Kayton and Fried, "Avionics Navigation Systems", ch. 3),
updated at the rate of the GPS and smoothed as a position filter would; velocity, attitude and rates are taken as true.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, euler_from_quat
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.dynamics.body import Body

GPS_PERIOD_S = 0.2
CORRELATION_S = 60.0
SMOOTHING_S = 1.0


class Estimator:
    """``pos``, ``vel`` (3, N) NED metres; ``q`` (4, N); ``rate`` (3, N) rad/s; after :meth:`observe` also ``euler``
    and ``force``.
    """

    def __init__(self, dynamics: Body, rng: np.random.Generator, gps_noise_m: float) -> None:
        self._dyn = dynamics
        self._rng = rng
        self._sigma = gps_noise_m
        n = dynamics.n
        self.gps_error: Array = np.zeros((3, n))
        self._offset: Array = np.zeros((3, n))
        self._since_gps = 0.0
        if gps_noise_m > 0.0:
            self.gps_error = rng.normal(0.0, gps_noise_m, (3, n))
            self._offset = self.gps_error.copy()
        self.euler: Array = euler_from_quat(dynamics.q)
        self.force: Array = np.zeros((3, n))
        self.refresh()
        self.observe(0.0)

    def refresh(self) -> None:
        """Take over the state after a step of the physics."""
        dyn = self._dyn
        self.pos: Array = dyn.pos if self._sigma <= 0.0 else dyn.pos + self._offset
        self.vel: Array = dyn.vel
        self.q: Array = dyn.q
        self.rate: Array = dyn.rate

    def observe(self, dt: float) -> None:
        """Once a tick: GPS error, Euler angles (3, N) and accelerometer reading ``force`` (3, N) m/s^2 body."""
        if self._sigma > 0.0:
            self._wander(dt)
        self.euler = euler_from_quat(self.q)
        w, x, y, z = self.q
        ax, ay, az = self._dyn.accel
        az = az - GRAVITY
        # The rotation matrix's columns: world to body.
        self.force = np.array(
            [
                (1 - 2 * (y * y + z * z)) * ax + 2 * (x * y + w * z) * ay + 2 * (x * z - w * y) * az,
                2 * (x * y - w * z) * ax + (1 - 2 * (x * x + z * z)) * ay + 2 * (y * z + w * x) * az,
                2 * (x * z + w * y) * ax + 2 * (y * z - w * x) * ay + (1 - 2 * (x * x + y * y)) * az,
            ]
        )

    def _wander(self, dt: float) -> None:
        self._since_gps += dt
        while self._since_gps >= GPS_PERIOD_S:
            self._since_gps -= GPS_PERIOD_S
            keep = np.exp(-GPS_PERIOD_S / CORRELATION_S)
            kick = self._sigma * np.sqrt(1.0 - keep * keep)
            self.gps_error = self.gps_error * keep + self._rng.normal(0.0, kick, self.gps_error.shape)
        self._offset += (self.gps_error - self._offset) * min(dt / SMOOTHING_S, 1.0)
