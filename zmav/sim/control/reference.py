"""The moving reference: turns targets that jump into a motion with limited speed, acceleration and jerk.

The position error asks for a speed by the square-root law (as fast as allowed, and no faster than can be braked),
the speed error for an acceleration, and the acceleration moves at a limited jerk. This is what makes a copter leave
and arrive smoothly; ArduPilot's position controller shapes its input likewise (ardupilot.org, "Copter Position
Control and Navigation").
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, Flags, any_of, clamp, dot, limit_length
from zmav.sim.control.setpoints import ACCELERATION, POSITION, VELOCITY, Setpoints

BRAKING = 0.6  # share of the allowed acceleration that braking is planned with: measured on ArduCopter SITL
# How fast speed and acceleration errors are worked off, 1/s. The second must well exceed the first, or arrivals
# overshoot.
POSITION_GAIN = 0.8
SPEED_GAIN = 3.0


class Reference:
    """Shaped position, velocity and acceleration (3, N) in world NED that the feedback loops follow."""

    def __init__(self, setpoints: Setpoints, pos: Array) -> None:
        self.pos: Array = pos.copy()
        self.vel: Array = np.zeros_like(pos)
        self.acc: Array = np.zeros_like(pos)
        self._sp = setpoints

    def follow(self, free_xy: Flags, free_z: Flags, pos: Array, vel: Array) -> None:
        """Where nothing is held (on the ground, attitude flown by hand) the reference goes with the vehicle."""
        if any_of(free_xy):
            self.pos[:2, free_xy], self.vel[:2, free_xy], self.acc[:2, free_xy] = (
                pos[:2, free_xy],
                vel[:2, free_xy],
                0.0,
            )
        if any_of(free_z):
            self.pos[2, free_z], self.vel[2, free_z], self.acc[2, free_z] = pos[2, free_z], vel[2, free_z], 0.0

    def advance(self, dt: float) -> None:
        """Move on by ``dt`` seconds toward the setpoints."""
        sp, lim = self._sp, self._sp.limits
        error = sp.pos - self.pos
        far = np.empty(sp.accels.shape)  # level and up or down, as the speed toward it and the gain of that
        far[0], far[1] = np.sqrt(dot(error[:2], error[:2])), np.abs(error[2])
        speed = root_speed(far, POSITION_GAIN, BRAKING * sp.accels) * (sp.kinds == POSITION)
        gain = SPEED_GAIN * (sp.kinds != ACCELERATION)
        wanted = sp.vel[:2] + error[:2] * (np.minimum(speed[0], lim["speed"]) / np.maximum(far[0], 1e-9))
        wanted = limit_length(wanted, lim["speed"])
        acc = limit_length(sp.acc[:2] + (wanted - self.vel[:2]) * gain[0], lim["accel"])
        self.acc[:2] += limit_length(acc - self.acc[:2], lim["jerk"] * dt)
        wanted = clamp(sp.vel[2] + np.copysign(speed[1], error[2]), -lim["speed_up"], lim["speed_down"])
        acc = clamp(sp.acc[2] + (wanted - self.vel[2]) * gain[1], -lim["accel_z"], lim["accel_z"])
        jerk = lim["jerk_z"] * dt
        self.acc[2] += clamp(acc - self.acc[2], -jerk, jerk)
        self.vel += self.acc * dt
        self.pos += self.vel * dt

    def take(self, raw: Flags, pos: Array, vel: Array) -> None:
        """Where setpoints are followed ``raw`` the reference is the setpoint itself; what is not held is as it is."""
        sp = self._sp
        for rows, kind in ((slice(0, 2), sp.horizontal), (slice(2, 3), sp.vertical)):
            held, moved, pushed = raw & (kind == POSITION), raw & (kind == VELOCITY), raw & (kind == ACCELERATION)
            self.pos[rows] = np.where(held, sp.pos[rows], np.where(moved | pushed, pos[rows], self.pos[rows]))
            self.vel[rows] = np.where(held | moved, sp.vel[rows], np.where(pushed, vel[rows], self.vel[rows]))
            self.acc[rows] = np.where(held | moved | pushed, sp.acc[rows], self.acc[rows])


def root_speed(distance: Array, gain: float, braking: Array) -> Array:
    """Speed to approach a point ``distance`` away: linear near it (``gain``), and v^2 = 2*a*d further out, joined
    smoothly.
    """
    join = braking / (gain * gain)
    far = np.sqrt(np.maximum(2.0 * braking * (distance - 0.5 * join), 0.0))
    return np.where(distance > join, far, gain * distance)
