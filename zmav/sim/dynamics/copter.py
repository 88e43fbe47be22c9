"""Rigid-body flight of N multirotors of one airframe, at a fixed step.

Equations: Mahony, Kumar, Corke, "Multirotor Aerial Vehicles: Modeling, Estimation, and Control of Quadrotor", IEEE
Robotics & Automation Magazine 19(3), 2012, with axes north-east-down and forward-right-down:

    p' = v
    m v' = m g e3 - T R e3 + F_drag + F_ground
    q' = 1/2 q * (0, w)
    J w' = tau - w x J w

Each rotor turns at a speed (as a fraction of its maximum) that follows its throttle through the thrust curve with a
first-order lag; its thrust goes with the square of that speed, and where the airframe says so less with the air
coming from above. Drag is the body's (quadratic in air speed) plus the
rotor discs' (linear, in their plane: section "Blade flapping and induced drag" of the same paper). The ground is a
plane under four feet with a spring, a damper and friction; a vehicle that has come to rest on it stays exactly where
it is until its rotors lift it.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, Flags, all_of, any_of, body_z, clamp, cross, dot, quat_from_euler, rotation_matrix
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY, Airframe
from zmav.sim.dynamics.rigid import RigidBodies

SINK_M = 0.005  # how far the feet press into the ground under the vehicle's own weight
DAMPING = 0.7  # damping ratio of a bounce
FRICTION = 0.7  # Coulomb coefficient of the feet
SLIP_SPEED = 0.1  # m/s below which friction is taken as viscous
REST_SPEED = 0.05  # m/s, and rad/s: slower than that a standing body has come to rest
REACH_M = 0.5  # feet are looked at below this height
CLOSEST = 0.5  # rotor radii: the formula of the ground effect is not trusted below


REST_THRUST = 0.7  # of the weight: below it a standing vehicle does not move
SETTLED = 1e-6  # of full speed: a slower rotor has stopped


class CopterDynamics(RigidBodies):
    """State of N copters: ``pos`` and ``vel`` (3, N) metres NED, ``q`` (4, N), ``rate`` (3, N) rad/s body, ``rotor``
    (M, N).

    The inputs are ``throttle`` (M, N) in 0..1 and ``wind`` (3, N) m/s NED; :meth:`step` advances by ``dt``.
    ``efficiency`` (M, N): 1 a whole rotor, 0 a motor that has failed; ``supply`` (N,): the battery's voltage as a share
    of a full one's; ``density`` (N,): of the air, kg/m^3.
    """

    def __init__(self, airframe: Airframe, start: Array, yaw: Array, dt: float) -> None:
        n, m = start.shape[1], len(airframe.rotors)
        super().__init__(start, airframe.mass_kg, airframe.inertia_kgm2)
        self.airframe = airframe
        leg = airframe.leg_m
        feet = np.array([[leg, leg, -leg, -leg], [leg, -leg, leg, -leg], [0.0, 0.0, 0.0, 0.0]])
        rotor_m = (airframe.rotor_radius_m, airframe.rotor_height_m)
        self.ground = GroundContact(feet, airframe.weight_n, rotor_m)
        self.rotor: Array = np.zeros((m, n))
        self.throttle: Array = np.zeros((m, n))
        self.efficiency: Array = np.ones((m, n))
        self.supply: Array = np.ones(n)
        self.density: Array = np.full(n, airframe.air_density or AIR_DENSITY)
        self.thrust: Array = np.zeros((m, n))  # of the last step, N
        self.contact: Flags = self.pos[2] >= -1e-6
        self.resting: Flags = self.contact.copy()
        self.still = False
        """after a step: all rest, and no rotor turns or is asked to"""
        self.q: Array = quat_from_euler(0.0 * yaw, 0.0 * yaw, yaw)
        self._wrench = airframe.wrench_matrix()
        self._rests_n = REST_THRUST * airframe.weight_n
        self._forward = np.array([[r.forward_m] for r in airframe.rotors])
        self._right = np.array([[r.right_m] for r in airframe.rotors])
        self.dt = dt

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
        wanted = np.sqrt(u * (1.0 - frame.thrust_expo + u * frame.thrust_expo)) * self.supply
        self.rotor += (wanted - self.rotor) * self._lag
        lift = self.rotor * self.rotor
        if frame.inflow_mps > 0.0:
            lift = np.maximum(lift - self.rotor * self._inflow(), 0.0)
        most = frame.thrust_max_n
        self.thrust = (
            lift * self.efficiency * (self.density * (most / frame.air_density) if frame.air_density else most)
        )
        wrench = self._wrench.dot(self.thrust)  # half the cost of "@" on short arrays
        total = wrench[0]
        self.resting &= total < self._rests_n
        self.still = False
        if all_of(self.resting):
            self.stand()
            return
        down = body_z(self.q)
        force = self._force(down, total)
        torque = wrench[1:]
        if frame.spin_drag > 0.0:
            torque -= self.rate * frame.spin_drag
        self._touch(force, torque, down, total)
        self._integrate(force, torque)

    def stand(self) -> None:
        super().stand()
        if np.maximum.reduce(self.rotor, axis=None) < SETTLED and not any(self.throttle.ravel().tolist()):
            self.rotor[:] = self.thrust[:] = 0.0
            self.still = True

    def _inflow(self) -> Array:
        """Air through each rotor from above, as a share of the speed at which it gives nothing, (M, N).

        Thrust falls linearly with the advance ratio V / nD: T = T_max (r^2 - r V / V_0), r the share of full speed.
        """
        air = self.vel - self.wind
        climb = -dot(body_z(self.q), air)
        p, q, _ = self.rate
        share: Array = (climb - self._right * p + self._forward * q) * (1.0 / self.airframe.inflow_mps)
        return share

    def current(self) -> Array:
        """What the motors draw, A: the induced power of a rotor goes with its thrust to the 3/2 (momentum theory)."""
        if self.still:
            return np.zeros(self.n)
        frame = self.airframe
        share = self.thrust / frame.hover_thrust_n
        result: Array = dot(share, np.sqrt(share)) * (frame.hover_current_a / len(frame.rotors))
        return result

    def _force(self, down: Array, total: Array) -> Array:
        """The rotors' thrust and the air's forces, in newtons, world NED."""
        frame = self.airframe
        air = self.vel - self.wind
        speed = np.sqrt(dot(air, air))
        body = self.density * speed * (0.5 * frame.drag_area_m2)
        # The discs' drag goes with the rotors' speed: with the square root of thrust, one at hover. It acts in their
        # plane: what comes along their axis is left out.
        discs = np.sqrt(total / frame.weight_n) * frame.rotor_drag_kgps
        force: Array = down * (discs * dot(air, down) - total) - air * (body + discs)
        return force

    def _touch(self, force: Array, torque: Array, down: Array, total: Array) -> None:
        """Add what the ground does to those near it; notes first touches in ``impact``."""
        if all_of(self.pos[2] < -REACH_M):
            self.contact[:] = False
            return
        height = -self.pos[2]
        near = (height < REACH_M) & ~self.resting
        self.contact &= near | self.resting
        index = np.flatnonzero(near)
        if not index.size:
            return
        cushion = self.ground.cushion(height[index]) - 1.0
        force[:, index] -= down[:, index] * (total[index] * cushion)
        now, push, twist, closing = self.ground.push(
            self.pos[:, index], self.vel[:, index], self.q[:, index], self.rate[:, index]
        )
        first = now & ~self.contact[index]
        fresh = index[first]
        self.impact[fresh] = np.maximum(self.impact[fresh], closing[first])
        self.contact[index] = now
        force[:, index] += push
        torque[:, index] += twist

    def _integrate(self, force: Array, torque: Array) -> None:
        accel, before = self.linear(force), self.vel
        self.vel = before + accel * self.dt
        self.rate = self.rate + self.angular(torque) * self.dt
        if any_of(self.contact):
            self._rest(accel)
        self.move(before, accel)

    def _rest(self, accel: Array) -> None:
        """Those on the ground that hardly move and do not lift come to rest; those at rest do not move."""
        slow = (dot(self.vel, self.vel) < REST_SPEED**2) & (dot(self.rate, self.rate) < REST_SPEED**2)
        light = self.thrust.sum(0) < self._rests_n
        self.resting |= self.contact & slow & light
        self.hold(accel)


class GroundContact:
    """The level ground under bodies of one kind: a spring, a damper and Coulomb friction under each foot, and the
    cushion of air under rotors close to it. ``feet`` (3, F) m in body axes, ``weight_n``; ``rotor_m``: radius of the
    rotors and their height over the feet.

    Ground effect: I. C. Cheeseman and W. E. Bennett, "The effect of the ground on a helicopter rotor in forward
    flight", ARC R&M 3021, 1955: thrust at the same power grows by 1 / (1 - (r / 4z)^2), for each rotor of radius r.
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
