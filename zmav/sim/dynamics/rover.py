"""Driving of N wheeled rovers of one frame, at a fixed step: a kinematic bicycle, or two sides that skid, on tyres with
a friction limit.

The bicycle turns at ``u tan(delta) / L``: Rajamani, "Vehicle Dynamics and Control", 2nd ed., section 2.2; good up to
the tyres' limit, as Kong et al. show in "Kinematic and dynamic vehicle models for autonomous driving control design",
IEEE IV 2015. A skid-steered rover turns at ``(v_left - v_right) / B_eff``, where the effective track is wider than the
real one because the wheels scrub: Mandow et al., "Experimental kinematics for wheeled skid-steer mobile robots", IROS
2007. What drives is a brushed or field-oriented motor, whose force falls linearly to nothing at the free speed (and
brakes beyond it), with a lag. The tyres give at most ``mu N`` in all directions together (the friction circle:
Rajamani, section 13.5): what driving leaves is there for turning, and a turn that asks for more is wider. Rolling
resistance is Coulomb's, air drag quadratic, gravity pulls along the slope of the plane, and the body lies as the
ground does. There is no side-slip: who slides, ploughs straight on.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, Flags, clamp, rotation_matrix, thrust_frame, wrap_pi
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.roverframe import RoverFrame
from zmav.sim.environment import Terrain


class RoverDynamics:
    """State of N rovers: ``pos`` and ``vel`` (3, N) NED metres, ``q`` (4, N), ``rate`` (3, N) rad/s body, ``yaw`` (N,)
    rad about the ground's normal, ``speed`` (N,) m/s forward, ``wheel`` (N,): rad of the front wheels, right positive.

    The inputs, -1 to 1: ``steering`` and ``throttle`` (N,) for Ackermann steering, ``left`` and ``right`` (N,) for a
    skid-steered frame; and ``wind`` (3, N) m/s NED. :meth:`step` advances by ``dt``.
    """

    def __init__(self, frame: RoverFrame, start: Array, yaw: Array, dt: float, terrain: Terrain | None = None) -> None:
        n = start.shape[1]
        self.frame = frame
        self.dt = dt
        self.terrain = terrain or Terrain()
        self.pos: Array = start.astype(float).copy()
        self.pos[2] = self.terrain.down(self.pos[0], self.pos[1])
        self.vel: Array = np.zeros((3, n))
        self.accel: Array = np.zeros((3, n))
        self.rate: Array = np.zeros((3, n))
        self.wind: Array = np.zeros((3, n))
        self.yaw: Array = yaw.astype(float).copy()
        self.speed: Array = np.zeros(n)
        self.wheel: Array = np.zeros(n)
        self.steering: Array = np.zeros(n)
        self.throttle: Array = np.zeros(n)
        self.left: Array = np.zeros(n)
        self.right: Array = np.zeros(n)
        self.efficiency: Array = np.ones((2, n))  # of the motors of either side: 1 whole, 0 failed
        self.drive: Array = np.zeros((2, n))  # of the left and the right motors, m/s^2 of the whole rover
        self.contact: Flags = np.ones(n, dtype=bool)
        self.impact: Array = np.zeros(n)
        self._spin: Array = np.zeros(n)  # yaw rate about the normal
        self._sides: Array = np.zeros((2, n))  # speeds over the ground of the left and the right wheels
        self._down = -np.array(self.terrain.normal)[:, None] * np.ones((1, n))
        self._level = self.terrain.slope_north == 0.0 == self.terrain.slope_east
        self._steep = float(self._down[2, 0])  # cosine of the slope
        self.q: Array = thrust_frame(self._down, self.yaw)
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
        grip = self.frame.friction * GRAVITY * self._steep
        asked = self._turn_skid() if self.frame.skid else self._turn_wheels()
        # Of the friction circle: what the drive leaves, less what holds the rover on a cross slope.
        driven = clamp(self.drive.sum(0), -grip, grip)
        side = np.sqrt(np.maximum(grip * grip - driven * driven, 0.0))
        across = self._gravity[1]
        wanted = asked * self.speed - across
        held = clamp(wanted, -side, side) + across
        fast = np.abs(self.speed) > 0.05
        self._spin = np.where(fast & (held != asked * self.speed), held / np.where(fast, self.speed, 1.0), asked)
        self._move(before, spin)

    def _push(self) -> None:
        """Forward acceleration: motors, slope, air, and what resists."""
        frame, dt = self.frame, self.dt
        if frame.skid:
            order = np.stack([self.left, self.right])
            turning = 0.5 * frame.effective_track_m * self._spin
            sides = np.stack([self.speed + turning, self.speed - turning])
        else:
            order = np.stack([self.throttle, self.throttle])
            sides = np.stack([self.speed, self.speed])
        wanted = 0.5 * frame.stall_accel * (clamp(order, -1.0, 1.0) - sides / frame.free_speed) * self.efficiency
        self.drive = self.drive + (wanted - self.drive) * self._lag
        grip = frame.friction * GRAVITY * self._steep
        air = self.speed - (self._forward * self.wind).sum(0)
        drag = 0.5 * AIR_DENSITY * frame.drag_area_m2 / frame.mass_kg * np.abs(air) * air
        push = clamp(self.drive.sum(0), -grip, grip) + self._gravity[0] - drag
        moved = self.speed + push * dt
        # Coulomb's: it takes away speed and never gives any, so that who stands stays.
        resist = frame.rolling * GRAVITY * self._steep * dt
        self.speed = np.sign(moved) * np.maximum(np.abs(moved) - resist, 0.0)

    def _turn_wheels(self) -> Array:
        """Yaw rate that the front wheels ask for; they turn at a limited rate."""
        frame = self.frame
        most = frame.steering_rate * self.dt
        target = clamp(self.steering, -1.0, 1.0) * frame.steering_max
        self.wheel = self.wheel + clamp(target - self.wheel, -most, most)
        return self.speed * np.tan(self.wheel) / frame.wheelbase_m

    def _turn_skid(self) -> Array:
        """Yaw rate of two sides that go at different speeds; the scrubbing wheels resist."""
        frame, dt = self.frame, self.dt
        half = 0.5 * frame.effective_track_m
        # Each side has half the mass to move; the wheels of both scrub while it turns.
        moved: Array = half * self._spin + (self.drive[0] - self.drive[1]) * dt
        scrub = frame.scrub * GRAVITY * self._steep * dt
        moved = np.sign(moved) * np.maximum(np.abs(moved) - scrub, 0.0)
        return moved / half

    def _move(self, before: Array, spin: Array) -> None:
        dt = self.dt
        mean, turned = 0.5 * (before + self.speed), 0.5 * (spin + self._spin) * dt
        # Along the chord of the arc: exact where speed and yaw rate stay.
        chord = mean * dt * np.sinc(turned / (2.0 * np.pi))
        self.yaw = self.yaw + 0.5 * turned
        self._axes()
        self.pos = self.pos + self._forward * chord
        self.yaw = wrap_pi(self.yaw + 0.5 * turned)
        self._axes()
        if not self._level:
            self.pos[2] = self.terrain.down(self.pos[0], self.pos[1])
        self.vel = self._forward * self.speed
        self.accel = self._forward * ((self.speed - before) / dt) + self._right * (self.speed * self._spin)
        self.rate[2] = self._spin

    def _axes(self) -> None:
        """Attitude, the body's forward and right in the world, and gravity along them, m/s^2."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        if self._level:
            zero = np.zeros_like(cos)
            self._forward, self._right = np.stack([cos, sin, zero]), np.stack([-sin, cos, zero])
            self._gravity = np.zeros((2, self.n))
            half = 0.5 * self.yaw
            self.q = np.stack([np.cos(half), zero, zero, np.sin(half)])
            return
        self.q = thrust_frame(self._down, self.yaw)
        rotation = rotation_matrix(self.q)
        self._forward, self._right = rotation[:, 0], rotation[:, 1]
        self._gravity = GRAVITY * np.stack([self._forward[2], self._right[2]])
