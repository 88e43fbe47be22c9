"""The moving air: a steady wind and Dryden turbulence on it, one column per vehicle.

Turbulence after MIL-F-8785C, section 3.7 (the low-altitude model and its extension upward), in metres and seconds:

    L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2        (h in feet above the ground, 10 to 1000)
    sigma_w = 0.1 W20,  sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4
    H_u(s) = sigma_u sqrt(2 T_u / pi') / (1 + T_u s)
    H_v(s) = sigma_v sqrt(T_v / pi') (1 + sqrt(3) T_v s) / (1 + T_v s)^2,   T = L / V;  H_w like H_v

with W20 the mean wind at 20 ft: 15, 30 and 45 knots for light, moderate and severe turbulence. Above 1000 ft the
intensities stay, and the lengths grow to 1750 ft at 2000 ft. V is how fast a vehicle moves through the air that the
mean wind carries (frozen turbulence); it is taken as at least :data:`SLOWEST`, so that who drifts with the wind, or
stands in none, feels gusts come and go too.

Each filter is stepped by its exact solution for the airspeed of the moment, as a process of unit variance that is
multiplied with the intensity afterwards: the statistics do not depend on the step. Vehicles near each other feel
independent gusts, which is pessimistic for formations and harmless otherwise.
"""

from __future__ import annotations

import math

import numpy as np

from zmav.sim.arrays import Array, clamp, dot

BLOCK = 256  # draws of a vehicle at a time


KNOT = 1852.0 / 3600.0
FOOT = 0.3048
GUSTS = {"none": 0.0, "light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}
"""Name -> W20, m/s"""
SLOWEST = 3.0  # m/s
LOWEST_FT, LOW_FT, HIGH_FT = 10.0, 1000.0, 2000.0  # the low-altitude model's range, and where the lengths end
LENGTH_HIGH_FT = 1750.0
SEA_LEVEL_DENSITY = 1.225  # kg/m^3
SCALES_EVERY = 10  # steps: heights and speeds change slower than gusts
ROOT_3 = math.sqrt(3.0)


def density(alt_amsl_m: Array) -> Array:
    """Of the air at heights above the sea (m, below 11 km), kg/m^3: the International Standard Atmosphere
    (ISO 2533), (N,).
    """
    result: Array = SEA_LEVEL_DENSITY * np.maximum(1.0 - 2.25577e-5 * alt_amsl_m, 0.2) ** 4.25588
    return result


def scales(height: Array, w20: float) -> tuple[Array, Array, Array, Array]:
    """Lengths (m) and intensities (m/s) at heights above the ground (m): horizontal length, vertical length,
    horizontal intensity, vertical intensity; (N,) each.
    """
    feet = clamp(height / FOOT, LOWEST_FT, LOW_FT)
    shape = 0.177 + 0.000823 * feet
    further = clamp((height / FOOT - LOW_FT) / (HIGH_FT - LOW_FT), 0.0, 1.0) * (LENGTH_HIGH_FT - LOW_FT)
    along = (feet / shape**1.2 + further) * FOOT
    upright = (feet + further) * FOOT
    sigma_w = np.full_like(feet, 0.1 * w20)
    return along, upright, sigma_w / shape**0.4, sigma_w


class Air:
    """The wind that N vehicles feel; made by :meth:`zmav.sim.environment.Environment.air`."""

    def __init__(
        self,
        wind: tuple[float, float, float],
        w20: float,
        n: int,
        seed: tuple[int, ...],
        dt: float,
    ) -> None:
        self.mean: Array = np.repeat(np.array(wind, dtype=float)[:, None], n, axis=1)
        self.w20 = w20
        self._dt = dt
        self._noise = WhiteNoise(np.random.default_rng([*seed, *b"air"]), 5, n)
        self._steps = 0
        # Axes of the gusts: along the mean wind, across it, down.
        speed = math.hypot(wind[0], wind[1])
        self._cos, self._sin = (wind[0] / speed, wind[1] / speed) if speed > 0.0 else (1.0, 0.0)
        # Rows: along; across, its second stage; down, its second stage. As they are in the long run.
        z = self._noise.draw()
        self._state: Array = z.copy()
        self._state[2::2] = 0.5 * (z[1::2] + z[2::2])
        self._wind: Array = self.mean.copy()

    @property
    def dt(self) -> float:
        """Seconds of one step; they may change."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        if dt != self._dt:
            self._dt, self._steps = dt, 0  # with new filters at the next step

    @property
    def calm(self) -> bool:
        """There is nothing but the mean wind."""
        return self.w20 == 0.0

    def step(self, pos: Array, vel: Array) -> Array:
        """Wind (3, N), m/s NED where it blows to, for vehicles at ``pos`` with ``vel`` (3, N), one ``dt`` later."""
        if self.calm:
            return self.mean
        if self._steps % SCALES_EVERY == 0:
            self._rescale(pos, vel)
        self._steps += 1
        state, white = self._state, self._noise.draw()
        first = state[1::2].copy()
        state[:] = self._keep * state
        state[2::2] += self._pass * first
        state[0::2] += self._kick0 * white[0::2]
        state[1::2] += self._kick1 * white[1::2]
        state[2::2] += self._mixed * white[1::2]
        u = self._sigma * state[0]
        v = self._sigma * ((ROOT_3 * state[1] + (1.0 - ROOT_3) * state[2]) / math.sqrt(2.0))
        w = self._sigma_w * ((ROOT_3 * state[3] + (1.0 - ROOT_3) * state[4]) / math.sqrt(2.0))
        wind = self._wind
        wind[0] = self.mean[0] + (self._cos * u - self._sin * v)
        wind[1] = self.mean[1] + (self._sin * u + self._cos * v)
        wind[2] = self.mean[2] + w
        return wind

    def _rescale(self, pos: Array, vel: Array) -> None:
        """The filters' steps for the height and the airspeed of now.

        First stage z1: an Ornstein-Uhlenbeck process of unit variance. Second: z2' = (z1 - z2) / T, driven by the same
        noise. With a = exp(-dt / T) and b = dt / T the noise of one step has the covariance

            [1 - a^2,  (1 - a^2 (1 + 2b)) / 2;  .,  (1 - a^2 (1 + 2b + 2b^2)) / 2]
        """
        along, upright, self._sigma, self._sigma_w = scales(-pos[2], self.w20)
        drift = vel - self.mean
        speed = np.maximum(np.sqrt(dot(drift, drift)), SLOWEST)
        ratio = self._dt * speed / np.array([along, along, upright])
        b = ratio[1:]
        keep = np.exp(-ratio)
        a2 = keep[1:] ** 2
        q11 = 1.0 - a2
        q12 = 0.5 * (1.0 - a2 * (1.0 + 2.0 * b))
        q22 = 0.5 * (1.0 - a2 * (1.0 + 2.0 * b + 2.0 * b * b))
        self._keep: Array = np.repeat(keep, (1, 2, 2), axis=0)
        self._pass: Array = b * keep[1:]
        self._kick1: Array = np.sqrt(q11)
        self._mixed: Array = q12 / self._kick1
        # Rows 0, 2, 4: along (its own noise), and the second stages' own share.
        own = np.sqrt(np.maximum(q22 - self._mixed**2, 0.0))
        self._kick0: Array = np.concatenate([np.sqrt(1.0 - keep[:1] ** 2), own])


class WhiteNoise:
    """``rows`` independent standard normal numbers a vehicle and draw. Every vehicle has a generator of its own: one
    more vehicle in a fleet leaves the noise of the others as it was.

    ``rng``: what the vehicles' generators are derived from; nothing else is taken from it.
    """

    def __init__(self, rng: np.random.Generator, rows: int, n: int) -> None:
        # First a child for this purpose, then one a vehicle: what was spawned before for others does not matter.
        self._generators = rng.spawn(1)[0].spawn(n)
        self._block: Array = np.zeros((BLOCK, rows, n))
        self._next = BLOCK

    def draw(self) -> Array:
        """The next (rows, N); a view that is good until the next draw."""
        if self._next == BLOCK:
            self._next = 0
            shape = self._block.shape[:2]
            for i, generator in enumerate(self._generators):
                self._block[:, :, i] = generator.standard_normal(shape)
        row: Array = self._block[self._next]
        self._next += 1
        return row
