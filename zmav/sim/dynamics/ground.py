"""What the level ground does to bodies on feet: a spring, a damper and Coulomb friction under each foot; and the
cushion of air under rotors close to it.

Ground effect: I. C. Cheeseman and W. E. Bennett, "The effect of the ground on a helicopter rotor in forward flight",
ARC R&M 3021, 1955: thrust at the same power grows by 1 / (1 - (r / 4z)^2), here for each rotor of radius r.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, Flags, any_of, clamp, cross, rotation_matrix
from zmav.sim.dynamics.airframe import GRAVITY

SINK_M = 0.005  # how far the feet press into the ground under the vehicle's own weight
DAMPING = 0.7  # damping ratio of a bounce
FRICTION = 0.7  # Coulomb coefficient of the feet
SLIP_SPEED = 0.1  # m/s below which friction is taken as viscous
REST_SPEED = 0.05  # m/s, and rad/s: slower than that a standing body has come to rest
REACH_M = 0.5  # feet are looked at below this height
CLOSEST = 0.5  # rotor radii: the formula of the ground effect is not trusted below


class Ground:
    """The ground under bodies of one kind: ``feet`` (3, F) m in body axes, ``weight_n``; ``rotor_m``: radius of the
    rotors and their height over the feet.
    """

    def __init__(self, feet: Array, weight_n: float, rotor_m: tuple[float, float]) -> None:
        self._feet = feet
        count = feet.shape[1]
        self._stiff = weight_n / SINK_M / count
        self._damp = 2.0 * DAMPING * np.sqrt(GRAVITY / SINK_M) * weight_n / GRAVITY / count
        self._radius, self._rotor_height = rotor_m

    def push(self, pos: Array, vel: Array, q: Array, rate: Array) -> tuple[Flags, Array, Array, Array]:
        """Who touches (N,); the force (3, N) in newtons of the world; the torque (3, N) in newton metres of the body;
        and how fast each comes down on it, (N,) m/s.
        """
        rot = rotation_matrix(q)
        feet = np.einsum("ijn,jk->ikn", rot, self._feet)  # offsets in the world, (3, F, N)
        turning = np.einsum("ijn,jn->in", rot, rate)
        depth = feet[2] + pos[2]
        touching = depth > 0.0
        contact: Flags = np.any(touching, axis=0)
        closing: Array = vel[2]
        if not any_of(contact):
            return contact, np.zeros_like(vel), np.zeros_like(vel), closing
        speed = vel[:, None] + cross(turning[:, None], feet)
        sinking = speed[2]
        press = np.where(touching, np.maximum(self._stiff * depth + self._damp * sinking, 0.0), 0.0)
        slip = np.sqrt((speed[:2] * speed[:2]).sum(0))
        push = speed * (-FRICTION * press / np.maximum(slip, SLIP_SPEED))
        push[2] = -press
        torque: Array = np.einsum("jin,jn->in", rot, cross(feet, push).sum(1))
        return contact, push.sum(1), torque, closing

    def cushion(self, height: Array) -> Array:
        """Factor on the thrust of rotors whose feet are so high, (N,)."""
        if self._radius <= 0.0:
            return np.ones_like(height)
        near = self._radius / (4.0 * np.maximum(height + self._rotor_height, CLOSEST * self._radius))
        factor: Array = 1.0 / (1.0 - clamp(near, 0.0, 0.5) ** 2)
        return factor
