"""Rigid-body flight of N fixed wings of one type, at a fixed step.

Equations: Beard and McLain, "Small Unmanned Aircraft: Theory and Practice", Princeton 2012, chapters 3 and 4:

    p' = v,    m v' = m g e3 + R (F_air + T e1) + F_ground
    q' = 1/2 q * (0, w),    J w' = tau_air + tau_ground - w x J w

with lift, drag, side force and moments from coefficients of angle of attack, sideslip, body rates and surfaces, and a
stall that blends into a flat plate (:mod:`zmav.sim.dynamics.wing`). Sideslip and angle of attack enter the moments by
their sines, which is the same near zero and right for any attitude. The damping of body rates is taken implicitly, so
that no airspeed makes the step unstable. The ground is a plane under wheels and wing tips with springs, dampers and
friction; a plane that has come to rest on it stays exactly where it is until its engine moves it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array, Flags, all_of, any_of, clamp, cross, dot, rotation_matrix
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.rigid import RigidBodies
from zmav.sim.dynamics.wing import Wing

SINK_M = 0.01  # how far a wheel presses into the ground under a third of the weight
GROUND_DAMPING = 0.7  # damping ratio of a vertical bounce
FRICTION = 0.7  # Coulomb coefficient across a wheel, and of everything that is no wheel
ROLLING = 0.12  # along a wheel, on grass
SLIP_SPEED = 0.2  # m/s below which friction is taken as viscous
STEERING = 0.3  # rad, of the nose wheel at full rudder
CONTACT_REACH_M = 1.5  # wheels are looked at below this height
REST_SPEED = 0.05  # m/s, and rad/s
REST_THRUST = 0.1  # of the weight: below it a standing plane does not move
FASTEST_AIR = 120.0  # m/s: beyond it, where these coefficients mean nothing, forces grow no more


class PlaneDynamics(RigidBodies):
    """State of N planes: ``pos`` and ``vel`` (3, N) metres NED, ``q`` (4, N), ``rate`` (3, N) rad/s body.

    The inputs are ``surface`` (3, N): aileron, elevator, rudder as shares of their travel (right, up, right
    positive), ``throttle`` (N,) in 0..1 and ``wind`` (3, N) m/s NED; :meth:`step` advances by ``dt``. ``deflection``
    is where the surfaces are by now. ``density`` (N,): of the air, kg/m^3.
    """

    def __init__(self, wing: Wing, start: Array, yaw: Array, dt: float) -> None:
        n = start.shape[1]
        super().__init__(start, wing.mass_kg, wing.inertia_kgm2)
        self.wing = wing
        self.dt = dt
        self.density: Array = np.full(n, AIR_DENSITY)
        self.q: Array = np.zeros((4, n))
        self.q[0], self.q[3] = np.cos(yaw / 2), np.sin(yaw / 2)
        self.surface: Array = np.zeros((3, n))
        self.deflection: Array = np.zeros((3, n))
        self.throttle: Array = np.zeros(n)
        self.efficiency: Array = np.ones((1, n))  # 1 a whole motor, 0 one that has failed
        self.thrust: Array = np.zeros(n)  # of the last step, N
        self.airspeed: Array = np.zeros(n)  # of the last step, m/s
        self.alpha: Array = np.zeros(n)  # angle of attack and sideslip of the last step, rad
        self.beta: Array = np.zeros(n)
        self._points = np.array([[w.forward_m, w.right_m, w.down_m] for w in wing.wheels]).T
        self._along = np.array([ROLLING if w.rolls else FRICTION for w in wing.wheels])[:, None]
        self._steered = np.array([w.steered for w in wing.wheels])
        wheels = max(sum(w.rolls for w in wing.wheels), 1)
        self._stiff = wing.weight_n / wheels / SINK_M
        self._damp = 2.0 * GROUND_DAMPING * np.sqrt(GRAVITY / SINK_M) * wing.mass_kg / wheels
        area, span, chord = wing.area_m2, wing.span_m, wing.chord_m
        # Of the moments: what rates damp, per rho V, (3, 1).
        self._damping = (
            0.25 * area * np.array([[span**2 * -wing.roll_p], [chord**2 * -wing.pitch_q], [span**2 * -wing.yaw_r]])
        )
        self.pos[2] = np.minimum(self.pos[2], 0.0)  # who starts on the ground starts on its wheels
        self.contact: Flags = self.pos[2] >= -1e-6
        self.resting: Flags = self.contact.copy()

    @property
    def stand_m(self) -> float:
        """How high the centre of mass is over the ground, standing on the wheels. Positions are told of the point
        that far below it, so that a standing plane is where the ground is.
        """
        return max(w.down_m for w in self.wing.wheels if w.rolls)

    def step(self) -> None:
        """Advance every vehicle by ``dt`` seconds."""
        most = self.wing.servo_rate * self.dt
        self.deflection += clamp(self.surface - self.deflection, -most, most)
        rot = rotation_matrix(self.q)
        air = np.einsum("jin,jn->in", rot, self.vel - self.wind)
        force, torque, drag = self._air(air)
        self.resting &= self.thrust < REST_THRUST * self.wing.weight_n
        if all_of(self.resting):
            self.stand()
            return
        push = np.einsum("ijn,jn->in", rot, force)
        self._ground(rot, push, torque)
        self._integrate(push, torque, drag)

    def launch(self, index: int, speed: float, pitch: float) -> None:
        """Throw one plane by hand: it is in the air at shoulder height, and moves along its nose at ``speed`` m/s."""
        w, _, _, z = self.q[:, index]
        yaw = 2.0 * np.arctan2(z, w)
        half = 0.5 * pitch
        self.q[:, index] = (
            np.cos(half) * np.cos(yaw / 2),
            -np.sin(half) * np.sin(yaw / 2),
            np.sin(half) * np.cos(yaw / 2),
            np.cos(half) * np.sin(yaw / 2),
        )
        along = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
        self.vel[:, index] = speed * along
        self.pos[2, index] -= 1.5
        self.resting[index] = self.contact[index] = False

    def current(self) -> Array:
        """What the motor draws, A: power goes with the square of the throttle, as in ArduPilot's simulation."""
        current: Array = self.wing.full_current_a * self.throttle * self.throttle
        return current

    def _air(self, air: Array) -> tuple[Array, Array, Array]:
        """Forces (N) and moments (N m) in body axes from the motion through the air (3, N), and how much the moments
        fall per rad/s, (3, N).
        """
        wing, rho = self.wing, self.density
        u, v, w = air
        speed = np.sqrt(dot(air, air))
        self.airspeed = speed
        some = np.maximum(speed, 1e-3)
        self.alpha = np.arctan2(w, u)
        slip = v / some
        self.beta = np.arcsin(clamp(slip, -1.0, 1.0))
        held = np.minimum(speed, FASTEST_AIR)
        pressed = 0.5 * rho * wing.area_m2 * held * held
        lift, drag = wing.lift_drag(self.alpha)
        cos_a, sin_a = np.cos(self.alpha), np.sin(self.alpha)
        aileron, elevator, rudder = self.deflection
        force = np.empty_like(air)
        self.thrust = wing.thrust(self.throttle, np.maximum(u, 0.0)) * self.efficiency[0]
        # Lift and drag are in the plane of symmetry; what flows across it drags with the side force.
        force[0] = pressed * (lift * sin_a - drag * cos_a) + self.thrust
        force[1] = pressed * (wing.side_beta * slip + wing.side_rudder * rudder)
        force[2] = pressed * (-lift * cos_a - drag * sin_a)
        half = 0.5 * wing.span_m / some
        p, r = self.rate[0] * half, self.rate[2] * half
        torque = np.empty_like(air)
        torque[0] = (
            pressed
            * wing.span_m
            * (wing.roll_beta * slip + wing.roll_r * r + wing.roll_aileron * aileron + wing.roll_rudder * rudder)
        )
        torque[1] = pressed * wing.chord_m * (wing.pitch_0 + wing.pitch_alpha * sin_a + wing.pitch_elevator * elevator)
        torque[2] = pressed * wing.span_m * (wing.yaw_beta * slip + wing.yaw_p * p + wing.yaw_rudder * rudder)
        return force, torque, self._damping * (rho * held)

    def _ground(self, rot: Array, force: Array, torque: Array) -> None:
        """Add the forces of the ground on the wheels and tips of those near it; notes first touches in ``impact``."""
        if all_of(self.pos[2] < -CONTACT_REACH_M):
            self.contact[:] = False
            return
        height = -self.pos[2]  # of the wheels, upright
        near = (height < CONTACT_REACH_M) & ~self.resting
        self.contact &= near | self.resting
        index = np.flatnonzero(near)
        if not index.size:
            return
        rot = rot[:, :, index]
        points = np.einsum("ijn,jk->ikn", rot, self._points)  # world offsets, (3, points, near)
        depth = points[2] + self.pos[2, index] - self.stand_m
        touching = depth > 0.0
        now = touching.any(0)
        first = now & ~self.contact[index]
        fresh = index[first]
        self.impact[fresh] = np.maximum(self.impact[fresh], self.vel[2, fresh])
        self.contact[index] = now
        if not any_of(now):
            return
        rate = np.einsum("ijn,jn->in", rot, self.rate[:, index])
        speed = self.vel[:, None, index] + cross(rate[:, None], points)
        press = np.where(touching, np.maximum(self._stiff * depth + self._damp * speed[2], 0.0), 0.0)
        speed[2] = 0.0
        push = self._friction(rot, speed, press, index)
        push[2] -= press
        force[:, index] += push.sum(1)
        twist = cross(points, push).sum(1)
        torque[:, index] += np.einsum("jin,jn->in", rot, twist)

    def _friction(self, rot: Array, slide: Array, press: Array, index: NDArray[np.intp]) -> Array:
        """Forces along the ground (3, points, near): little along a wheel, much across it."""
        angle = STEERING * self.deflection[2, index] * self._steered[:, None]
        nose, side = rot[:, 0, :][:, None, :], rot[:, 1, :][:, None, :]
        ahead = nose * np.cos(angle) + side * np.sin(angle)
        ahead = ahead / np.maximum(np.sqrt(np.einsum("ikn,ikn->kn", ahead, ahead)), 1e-6)
        along = np.einsum("ikn,ikn->kn", slide, ahead)
        across = slide - ahead * along
        fast = np.maximum(np.sqrt(np.einsum("ikn,ikn->kn", slide, slide)), SLIP_SPEED)
        grip = press / fast
        result: Array = -(ahead * along * self._along + across * FRICTION) * grip
        return result

    def _integrate(self, force: Array, torque: Array, damping: Array) -> None:
        accel, before = self.linear(force), self.vel
        self.vel = before + accel * self.dt
        self.rate = (self.rate + self.angular(torque) * self.dt) / (1.0 + damping / self._inertia * self.dt)
        if any_of(self.contact):
            self._rest(accel)
        self.move(before, accel)

    def _rest(self, accel: Array) -> None:
        """Those on the ground that hardly move, with the engine idle, come to rest; those at rest do not move."""
        slow = (dot(self.vel, self.vel) < REST_SPEED**2) & (dot(self.rate, self.rate) < REST_SPEED**2)
        light = self.thrust < REST_THRUST * self.wing.weight_n
        self.resting |= self.contact & slow & light
        self.hold(accel)
