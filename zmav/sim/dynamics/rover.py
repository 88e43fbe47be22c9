"""Driving of N wheeled rovers of one frame, at a fixed step: a kinematic bicycle on tyres with a friction
limit.

The bicycle turns at ``u tan(delta) / L``: Rajamani, "Vehicle Dynamics and Control", 2nd ed., section 2.2; good up to
the tyres' limit, as Kong et al. show in "Kinematic and dynamic vehicle models for autonomous driving control design",
IEEE IV 2015. What drives is a brushed or field-oriented motor, whose force falls linearly to nothing at the free speed
(and brakes beyond it), with a lag. The tyres give at most ``mu N`` in all directions together (the friction circle:
Rajamani, section 13.5): what driving leaves is there for turning, and a turn that asks for more is wider. Rolling
resistance is Coulomb's, air drag quadratic. There is no side-slip: who slides, ploughs straight on.
"""

from __future__ import annotations

import numpy as np

from zmav.rotation import wrap
from zmav.sim.arrays import Array, Flags, any_of, clamp
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.roverframe import RoverFrame

SLIPS_ABOVE = 0.05  # m/s: slower, a turn needs no grip worth the name
SETTLED = 1e-6  # m/s^2: without throttle, a smaller drive is none


class RoverDynamics:
    """State of N rovers: ``pos`` and ``vel`` (3, N) NED metres, ``q`` (4, N), ``rate`` (3, N) rad/s body, ``yaw`` (N,)
    rad about the ground's normal, ``speed`` (N,) m/s forward, ``wheel`` (N,): rad of the front wheels, right positive.

    The inputs: ``steering`` and ``throttle`` (N,), -1 to 1, and ``wind`` (3, N) m/s NED. :meth:`step` advances by
    ``dt``.
    """

    def __init__(self, frame: RoverFrame, start: Array, yaw: Array, dt: float) -> None:
        n = start.shape[1]
        self.frame = frame
        self.dt = dt
        self.pos: Array = start.astype(float).copy()
        self.pos[2] = 0.0
        self.vel: Array = np.zeros((3, n))
        self.accel: Array = np.zeros((3, n))
        self.rate: Array = np.zeros((3, n))
        self.wind: Array = np.zeros((3, n))
        self.yaw: Array = yaw.astype(float).copy()
        self.speed: Array = np.zeros(n)
        self.wheel: Array = np.zeros(n)
        self.steering: Array = np.zeros(n)
        self.throttle: Array = np.zeros(n)
        self.efficiency: Array = np.ones((1, n))  # 1 a whole motor, 0 one that has failed
        self.drive: Array = np.zeros(n)  # of the motor, m/s^2
        self.contact: Flags = np.ones(n, dtype=bool)
        self.impact: Array = np.zeros(n)
        self._spin: Array = np.zeros(n)  # yaw rate about the normal
        self._grip = frame.friction * GRAVITY
        self._drag = 0.5 * AIR_DENSITY * frame.drag_area_m2 / frame.mass_kg
        self.q: Array = np.zeros((4, n))
        self._axes()

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
        self._lag = 1.0 - float(np.exp(-dt / self.frame.motor_tau_s))

    def step(self) -> None:
        """Advance every rover by ``dt`` seconds."""
        before, spin = self.speed, self._spin
        self._push()
        asked = self._turn()
        # Of the friction circle: what the drive leaves.
        grip = self._grip
        driven = clamp(self.drive, -grip, grip)
        side = np.sqrt(grip * grip - driven * driven)
        wanted = asked * self.speed
        held = clamp(wanted, -side, side)
        slips = held != wanted
        if any_of(slips):
            slips &= np.abs(self.speed) > SLIPS_ABOVE
            self._spin = np.where(slips, held / np.where(slips, self.speed, 1.0), asked)
        else:
            self._spin = asked
        self._move(before, spin)

    def current(self) -> Array:
        """What the motor draws, A: it goes with its force, and the battery gives it for that share of the time that
        the throttle says.
        """
        frame = self.frame
        share = np.abs(self.drive * self.throttle) / frame.stall_accel
        result: Array = frame.idle_current_a + frame.stall_current_a * np.minimum(share, 1.0)
        return result

    def _push(self) -> None:
        """Forward acceleration: motors, air, and what resists."""
        frame, dt, grip = self.frame, self.dt, self._grip
        order = clamp(self.throttle, -1.0, 1.0)
        wanted = self.efficiency[0] * ((order - self.speed * (1.0 / frame.free_speed)) * frame.stall_accel)
        self.drive = self.drive + (wanted - self.drive) * self._lag
        if 0.0 in self.throttle.tolist():
            self.drive = np.where((self.throttle == 0.0) & (np.abs(self.drive) < SETTLED), 0.0, self.drive)
        forward = self._forward
        air = self.speed - (forward[0] * self.wind[0] + forward[1] * self.wind[1])
        push = clamp(self.drive, -grip, grip) - self._drag * np.abs(air) * air
        moved = self.speed + push * dt
        # Coulomb's: it takes away speed and never gives any, so that who stands stays.
        resist = frame.rolling * GRAVITY * dt
        self.speed = np.copysign(np.maximum(np.abs(moved) - resist, 0.0), moved)

    def _turn(self) -> Array:
        """Yaw rate that the front wheels ask for; they turn at a limited rate."""
        frame = self.frame
        most = frame.steering_rate * self.dt
        target = clamp(self.steering, -1.0, 1.0) * frame.steering_max
        self.wheel = self.wheel + clamp(target - self.wheel, -most, most)
        asked: Array = self.speed * np.tan(self.wheel) * (1.0 / frame.wheelbase_m)
        return asked

    def _move(self, before: Array, spin: Array) -> None:
        dt = self.dt
        turned = (spin + self._spin) * (0.5 * dt)
        # Along the chord of the arc; its length is that of the arc but for a few millionths.
        way = (before + self.speed) * (0.5 * dt)
        middle = self.yaw + 0.5 * turned
        pos = self.pos.copy()
        pos[0] += np.cos(middle) * way
        pos[1] += np.sin(middle) * way
        self.pos = pos
        self.yaw = wrap(middle + 0.5 * turned)
        self._axes()
        self.vel = self._forward * self.speed
        self.accel = self._forward * ((self.speed - before) / dt) + self._right * (self.speed * self._spin)
        rate = np.zeros_like(pos)
        rate[2] = self._spin
        self.rate = rate

    def _axes(self) -> None:
        """Attitude, and the body's forward and right in the world."""
        forward, right, q = np.zeros((3, self.n)), np.zeros((3, self.n)), np.zeros((4, self.n))
        forward[0] = right[1] = np.cos(self.yaw)
        forward[1] = np.sin(self.yaw)
        np.negative(forward[1], out=right[0])
        half = 0.5 * self.yaw
        np.cos(half, out=q[0])
        np.sin(half, out=q[3])
        self._forward, self._right = forward, right
        self.q = q
