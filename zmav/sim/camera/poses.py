"""Where all vehicles of a world are at one moment: what a picture is rendered from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from zmav.sim.arrays import Array, Flags, quat_multiply


class Poses(NamedTuple):
    """One column per vehicle, in the world's order; metres and m/s NED, rad/s body."""

    time_s: float
    pos: Array
    vel: Array
    q: Array
    rate: Array
    spinning: Flags
    """whose propellers turn"""

    def after(self, dt: float) -> Poses:
        """Moved on by ``dt`` seconds (also back) at constant velocity and rates."""
        speed = np.sqrt((self.rate * self.rate).sum(0))
        half = 0.5 * dt * speed
        turn = np.empty_like(self.q)
        turn[0] = np.cos(half)
        turn[1:] = self.rate * (0.5 * dt * np.sinc(half / math.pi))
        return self._replace(pos=self.pos + self.vel * dt, q=quat_multiply(self.q, turn))
