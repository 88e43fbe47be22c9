"""Rigid-body flight of N multirotors of one airframe, at a fixed step.

Equations: Mahony, Kumar, Corke, "Multirotor Aerial Vehicles: Modeling, Estimation, and Control of Quadrotor", IEEE
Robotics & Automation Magazine 19(3), 2012, with axes north-east-down and forward-right-down:

    p' = v
    m v' = m g e3 - T R e3 + F_drag + F_ground
    q' = 1/2 q * (0, w)
    J w' = tau - w x J w

Each rotor turns at a speed (as a fraction of its maximum) that follows its throttle through the thrust curve with a
first-order lag; its thrust goes with the square of that speed. Drag is the body's (quadratic in air speed) plus the
rotor discs' (linear, in their plane: section "Blade flapping and induced drag" of the same paper). The ground is a
plane under four feet with a spring, a damper and friction; a vehicle that has come to rest on it stays exactly where
it is until its rotors lift it.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, Flags, body_z, dot, quat_rate, rotation_matrix
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY, Airframe
from zmav.sim.environment import Terrain

SINK_M = 0.005  # how far the feet press into the ground under the vehicle's own weight
GROUND_DAMPING = 0.7  # damping ratio of a vertical bounce
FRICTION = 0.7  # Coulomb coefficient of the feet
SLIP_SPEED = 0.1  # m/s below which friction is taken as viscous
CONTACT_REACH_M = 0.5  # feet are looked at below this height
REST_SPEED = 0.05  # m/s, and rad/s
REST_THRUST = 0.7  # of the weight: below it a standing vehicle does not move


class CopterDynamics:
    """State of N copters: ``pos`` and ``vel`` (3, N) metres NED, ``q`` (4, N), ``rate`` (3, N) rad/s body, ``rotor``
    (M, N).

    The inputs are ``throttle`` (M, N) in 0..1 and ``wind`` (3, N) m/s NED; :meth:`step` advances by ``dt``.
    """

    def __init__(self, airframe: Airframe, start: Array, yaw: Array, dt: float, terrain: Terrain | None = None) -> None:
        n, m = start.shape[1], len(airframe.rotors)
        self.airframe = airframe
        self.pos: Array = start.astype(float).copy()
        self.vel: Array = np.zeros((3, n))
        self.q: Array = np.zeros((4, n))
        self.q[0], self.q[3] = np.cos(yaw / 2), np.sin(yaw / 2)
        self.rate: Array = np.zeros((3, n))
        self.rotor: Array = np.zeros((m, n))
        self.throttle: Array = np.zeros((m, n))
        self.wind: Array = np.zeros((3, n))
        self.terrain = terrain or Terrain()
        self.ground_down = self.terrain.down_m
        self.accel: Array = np.zeros((3, n))  # of the last step, m/s^2 NED, gravity included
        self.thrust: Array = np.zeros((m, n))  # of the last step, N
        self.contact: Flags = self.pos[2] >= self.ground_down - 1e-6
        self.resting: Flags = self.contact.copy()
        self.impact: Array = np.zeros(n)  # down speed of the last touch of the ground, m/s; cleared by who reads it
        self._wrench = airframe.wrench_matrix()
        self._inertia = np.array(airframe.inertia_kgm2)[:, None]
        jx, jy, jz = airframe.inertia_kgm2
        self._gyro: Array = np.zeros((3, n))
        self._gyro_inertia = np.array([[jz - jy], [jx - jz], [jy - jx]])
        self.dt = dt
        leg = airframe.leg_m
        self._feet = np.array([[leg, leg, -leg, -leg], [leg, -leg, leg, -leg], [0.0, 0.0, 0.0, 0.0]])

    @property
    def n(self) -> int:
        return int(self.pos.shape[1])

    @property
    def dt(self) -> float:
        """Seconds of one step; an external flight stack may change them from step to step."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._dt = dt
        self._lag = 1.0 - np.exp(-dt / self.airframe.rotor_tau_s)

    def step(self) -> None:
        """Advance every vehicle by ``dt`` seconds."""
        frame = self.airframe
        u = self.throttle
        wanted = np.sqrt(u * (1.0 - frame.thrust_expo) + u * u * frame.thrust_expo)
        self.rotor += (wanted - self.rotor) * self._lag
        self.thrust = self.rotor * self.rotor * frame.thrust_max_n
        wrench = self._wrench @ self.thrust
        total = wrench[0]
        self.resting &= total < REST_THRUST * frame.weight_n
        if self.resting.all():
            self.vel[:] = 0.0
            self.rate[:] = 0.0
            self.accel[:] = 0.0
            return
        down = body_z(self.q)
        force = self._drag(down, total) - down * total
        torque = wrench[1:]
        self._ground(force, torque)
        self._integrate(force, torque)

    def energy(self) -> Array:
        """Kinetic and potential energy of each vehicle in joules, (N,); potential is zero on the ground."""
        kinetic = 0.5 * self.airframe.mass_kg * dot(self.vel, self.vel)
        spinning = 0.5 * (self._inertia * self.rate * self.rate).sum(0)
        height: Array = self.ground_down - self.pos[2]
        result: Array = kinetic + spinning + self.airframe.weight_n * height
        return result

    def _drag(self, down: Array, total: Array) -> Array:
        """Air forces in newtons, world NED."""
        frame = self.airframe
        air = self.vel - self.wind
        speed = np.sqrt(dot(air, air))
        body = air * (-0.5 * AIR_DENSITY * frame.drag_area_m2 * speed)
        # The discs' drag goes with the rotors' speed: with the square root of thrust, one at hover.
        in_plane = air - down * dot(air, down)
        discs = in_plane * (-frame.rotor_drag_kgps * np.sqrt(total / frame.weight_n))
        result: Array = body + discs
        return result

    def _ground(self, force: Array, torque: Array) -> None:
        """Add the forces of the ground on the feet of those near it; notes first touches in ``impact``."""
        if self.pos[2].max() < self.ground_down - CONTACT_REACH_M:
            self.contact[:] = False
            return
        near = (self.pos[2] > self.ground_down - CONTACT_REACH_M) & ~self.resting
        self.contact &= near | self.resting
        index = np.flatnonzero(near)
        if not index.size:
            return
        frame = self.airframe
        rot = rotation_matrix(self.q[:, index])
        feet = np.einsum("ijn,jk->ikn", rot, self._feet)  # world offsets of the feet, (3, 4, near)
        rate = np.einsum("ijn,jn->in", rot, self.rate[:, index])
        depth = feet[2] + (self.pos[2, index] - self.ground_down)
        touching = depth > 0.0
        now = touching.any(0)
        first = now & ~self.contact[index]
        fresh = index[first]
        self.impact[fresh] = np.maximum(self.impact[fresh], self.vel[2, fresh])
        self.contact[index] = now
        if not now.any():
            return
        speed = self.vel[:, None, index] + np.cross(rate[:, None, :], feet, axis=0)
        stiff = frame.weight_n / SINK_M / 4.0
        damp = 2.0 * GROUND_DAMPING * np.sqrt(GRAVITY / SINK_M) * frame.mass_kg / 4.0
        press = np.where(touching, np.maximum(stiff * depth + damp * speed[2], 0.0), 0.0)
        slip = np.sqrt(speed[0] * speed[0] + speed[1] * speed[1])
        grip = -FRICTION * press / np.maximum(slip, SLIP_SPEED)
        push = np.stack([grip * speed[0], grip * speed[1], -press])
        force[:, index] += push.sum(1)
        twist = np.cross(feet, push, axis=0).sum(1)
        torque[:, index] += np.einsum("jin,jn->in", rot, twist)

    def _integrate(self, force: Array, torque: Array) -> None:
        dt = self.dt
        accel = force / self.airframe.mass_kg
        accel[2] += GRAVITY
        # w x Jw, for an inertia without products.
        p, q, r = self.rate
        np.multiply(q, r, out=self._gyro[0])
        np.multiply(r, p, out=self._gyro[1])
        np.multiply(p, q, out=self._gyro[2])
        spin = (torque - self._gyro * self._gyro_inertia) / self._inertia
        before = self.vel
        self.vel = before + accel * dt
        self.rate = self.rate + spin * dt
        if self.contact.any():
            self._rest(accel)
        self.accel = accel
        self.pos += (before + self.vel) * (0.5 * dt)
        self.q += quat_rate(self.q, self.rate) * dt
        self.q /= np.sqrt(dot(self.q, self.q))

    def _rest(self, accel: Array) -> None:
        """Those on the ground that hardly move and do not lift come to rest; those at rest do not move."""
        slow = (dot(self.vel, self.vel) < REST_SPEED**2) & (dot(self.rate, self.rate) < REST_SPEED**2)
        light = self.thrust.sum(0) < REST_THRUST * self.airframe.weight_n
        self.resting |= self.contact & slow & light
        moving = ~self.resting
        self.vel *= moving
        self.rate *= moving
        accel *= moving
