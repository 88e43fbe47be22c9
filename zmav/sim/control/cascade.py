"""The cascade: reference -> position -> velocity -> lean and thrust (outer), attitude -> rate -> rotors (inner).
A setpoint may enter at every level.

The outer loops run every other tick, the attitude loop every tick, the rate loop with every step of the physics.
Structure and gains after ArduCopter's position and attitude controllers (ardupilot.org, "Copter Position Control and
Navigation", "Copter Attitude Control"); the thrust is projected on the actual body axis as in Lee, Leok, McClamroch,
"Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from zmav.rotation import wrap
from zmav.sim.arrays import (
    Array,
    Flags,
    all_of,
    any_of,
    body_z,
    clamp,
    dot,
    limit_length,
    quat_error,
    quat_from_euler,
    thrust_frame,
    yaw_of,
)
from zmav.sim.control.allocation import Allocator
from zmav.sim.control.reference import Reference
from zmav.sim.control.setpoints import DIRECT, FLY, IDLE, RATES, TORQUE, YAW_ANGLE, Setpoints
from zmav.sim.dynamics.airframe import GRAVITY, Airframe, throttle_for

VEL_I_MAX = 4.0  # m/s^2
YAW_P = 2.5  # 1/s, of the turn toward a heading
IDLE_THROTTLE = 0.10  # MOT_SPIN_ARM
MIN_THROTTLE = 0.15  # MOT_SPIN_MIN
YAW_SHARE = 0.2  # of the rotors' thrust that turning may take (MOT_YAW_HEADROOM)


class Estimated(Protocol):
    """What the loops believe: ``pos``, ``vel`` (3, N) NED, ``q`` (4, N), ``rate`` (3, N) body."""

    pos: Array
    vel: Array
    q: Array
    rate: Array


class Cascade:
    """Controllers of N vehicles of one airframe; writes throttles (M, N)."""

    def __init__(self, airframe: Airframe, setpoints: Setpoints, start: Array, yaw: Array) -> None:
        n = start.shape[1]
        self.airframe = airframe
        self.setpoints = setpoints
        self.gains = setpoints.gains
        self.reference = Reference(setpoints, start)
        self.yaw: Array = yaw.astype(float).copy()  # the heading asked for now, on its way to the setpoint
        self.attitude: Array = quat_from_euler(np.zeros(n), np.zeros(n), self.yaw)
        self.thrust: Array = np.zeros(n)  # newtons asked of all rotors together
        self._turn: Array = np.zeros(n)  # yaw rate and acceleration fed forward
        self._turn_acc: Array = np.zeros(n)
        self.vel_i: Array = np.zeros((3, n))
        self.rate_i: Array = np.zeros((3, n))
        self._inertia = np.array(airframe.inertia_kgm2)[:, None]
        self._full_n = airframe.thrust_max_n * len(airframe.rotors)
        mix = np.linalg.pinv(airframe.wrench_matrix()) / airframe.thrust_max_n  # to shares of a rotor's full thrust
        self._mix_lean, self._mix_turn = mix[:, 1:3], mix[:, 3:]
        expo = airframe.thrust_expo
        self._least = (1.0 - expo) * MIN_THROTTLE + expo * MIN_THROTTLE**2
        self.allocator = Allocator(airframe)
        self.want_rate: Array = np.zeros((3, n))  # body rates asked for, rad/s
        self.want_vel: Array = np.zeros((3, n))  # what the velocity loop follows and gives
        self.want_acc: Array = np.zeros((3, n))
        self._flying: Flags = np.zeros(n, dtype=bool)
        self._idle: Array = np.zeros((len(mix), n))
        self._by_rates: Flags | None = None  # whose body rates or torques are given; None: nobody's
        self._by_torque: Flags | None = None

    def outer(self, est: Estimated, dt: float) -> None:
        """Position and velocity loops: sets the attitude and thrust to hold until the next call."""
        sp = self.setpoints
        self._flying = sp.spool == FLY
        self._idle[:] = np.where(sp.spool == IDLE, IDLE_THROTTLE, 0.0)
        grounded = ~self._flying
        if all_of(grounded):
            self._stand(est)
            return
        by_hand = grounded | (sp.horizontal >= DIRECT)
        ballistic = grounded | (sp.vertical == DIRECT)
        ref = self.reference
        ref.follow(by_hand, ballistic, est.pos, est.vel)
        ref.advance(dt)
        raw = sp.raw & self._flying
        if any_of(raw):
            ref.take(raw, est.pos, est.vel)
        self._head(est, grounded, dt)
        self._drive(est, raw, by_hand, ballistic, dt)
        self._below_attitude(est)

    def _drive(self, est: Estimated, raw: Flags, by_hand: Flags, ballistic: Flags, dt: float) -> None:
        """From the reference to the attitude and the thrust to hold."""
        sp, gains, ref = self.setpoints, self.gains, self.reference
        want_vel = ref.vel + (ref.pos - est.pos) * gains.pos_p
        if any_of(raw):
            limits = sp.limits
            want_vel[:2, raw] = limit_length(want_vel[:2, raw], limits["speed"][raw])
            want_vel[2, raw] = clamp(want_vel[2, raw], -limits["speed_up"][raw], limits["speed_down"][raw])
        error = want_vel - est.vel
        self.vel_i = clamp(self.vel_i + error * gains.vel_i * dt, -VEL_I_MAX, VEL_I_MAX)
        self._forget(by_hand, ballistic)
        acc = ref.acc + error * gains.vel_p + self.vel_i
        acc[2] = np.minimum(acc[2], 0.75 * GRAVITY)
        acc[:2] = limit_length(acc[:2], np.minimum(GRAVITY, GRAVITY - acc[2]) * np.tan(sp.limits["lean"]))
        self.want_vel, self.want_acc = want_vel, acc
        self._lean_and_lift(est, acc, by_hand, ballistic)

    def _forget(self, by_hand: Flags, ballistic: Flags) -> None:
        """No integrator of a velocity that is not held."""
        if any_of(by_hand):
            self.vel_i[:2, by_hand] = 0.0
        if any_of(ballistic):
            self.vel_i[2, ballistic] = 0.0

    def _below_attitude(self, est: Estimated) -> None:
        """Note who is flown by body rates or torques; their attitude is whatever it is."""
        by_rates = self._flying & (self.setpoints.horizontal >= RATES)
        self._by_rates = by_rates if any_of(by_rates) else None
        self._by_torque = None
        if self._by_rates is not None:
            self.attitude[:, by_rates] = est.q[:, by_rates]
            self.yaw[by_rates] = yaw_of(est.q)[by_rates]
            self._turn_acc[by_rates] = 0.0
            by_torque = by_rates & (self.setpoints.horizontal == TORQUE)
            self._by_torque = by_torque if any_of(by_torque) else None

    def _stand(self, est: Estimated) -> None:
        """Nobody flies: everything is where it is."""
        ref = self.reference
        ref.pos, ref.vel, ref.acc = est.pos.copy(), est.vel.copy(), np.zeros_like(est.vel)
        self.vel_i[:] = 0.0
        self.rate_i[:] = 0.0
        self.want_rate[:] = 0.0
        self._by_rates = self._by_torque = None
        self.attitude = est.q.copy()
        self.yaw = yaw_of(est.q)
        self._turn[:] = 0.0
        self._turn_acc[:] = 0.0

    def _head(self, est: Estimated, grounded: Flags, dt: float) -> None:
        sp = self.setpoints
        slew = sp.limits["yaw_slew"]
        toward = clamp(wrap(sp.yaw - self.yaw) * YAW_P, -slew, slew)
        rate = np.where(sp.yaw_kind == YAW_ANGLE, toward, sp.yaw_rate)
        # Easing in and out: the rate asked for may change by about 150 deg/s^2.
        step = 2.6 * dt
        change = clamp(rate - self._turn, -step, step)
        self._turn = self._turn + change
        self._turn_acc = change / dt
        self.yaw = wrap(self.yaw + self._turn * dt)
        if any_of(grounded):
            self._turn[grounded] = self._turn_acc[grounded] = 0.0
            self.yaw[grounded] = yaw_of(est.q)[grounded]

    def _lean_and_lift(self, est: Estimated, acc: Array, by_hand: Flags, ballistic: Flags) -> None:
        sp, frame = self.setpoints, self.airframe
        pull = -acc
        pull[2] += GRAVITY  # the specific force wanted, turned round: along the body's down axis
        down = pull / np.maximum(np.sqrt(dot(pull, pull)), 1e-6)
        self.attitude = thrust_frame(down, self.yaw)
        actual_down = body_z(est.q)
        lift = frame.mass_kg * dot(pull, actual_down)
        if any_of(by_hand):
            self.attitude[:, by_hand] = quat_from_euler(sp.roll[by_hand], sp.pitch[by_hand], self.yaw[by_hand])
            # Lean as told: what is left to do is to carry the height, so divide by how upright the body is.
            lift[by_hand] = (frame.mass_kg * pull[2] / np.maximum(actual_down[2], 0.5))[by_hand]
        self.thrust = clamp(lift, 0.0, self._full_n)
        if any_of(ballistic):
            self.thrust[ballistic] = sp.thrust[ballistic] * self._full_n

    def level(self, est: Estimated) -> None:
        """Attitude loop, once a tick: sets the body rates to hold, but those that are given."""
        by_rates, given = self._by_rates, self.setpoints
        if by_rates is None:
            self.want_rate = self._rates(est)
            return
        rate = given.body.copy() if all_of(by_rates) else np.where(by_rates, given.body, self._rates(est))
        # Beside body rates or torques a thrust does not wait for the outer loops' next turn.
        direct = by_rates & (given.vertical == DIRECT)
        self.thrust[direct] = given.thrust[direct] * self._full_n
        self.want_rate = rate

    def _rates(self, est: Estimated) -> Array:
        """The body rates (3, N), rad/s, that bring the attitude to what is asked for."""
        error = quat_error(self.attitude, est.q)
        gains = self.gains
        rate = clamp(error[1:] * (2.0 * np.sign(error[0])) * gains.angle_p, -gains.rate_max, gains.rate_max)
        rate[2] += self._turn
        return rate

    def inner(self, est: Estimated, dt: float) -> Array:
        """Rate loop and mix, with every step of the physics: throttles (M, N), 0..1."""
        if not any_of(self._flying):
            return self._idle
        gains = self.gains
        miss = self.want_rate - est.rate
        kept = clamp(self.rate_i + miss * (gains.rate_i * dt), -gains.rate_i_max, gains.rate_i_max)
        all_fly = all_of(self._flying)
        self.rate_i = kept if all_fly else kept * self._flying
        spin = miss * gains.rate_p + self.rate_i
        spin[2] += self._turn_acc
        torque = self._inertia * spin
        if self._by_torque is not None:
            torque[:, self._by_torque] = (self.setpoints.body * self.allocator.torque_nm[:, None])[:, self._by_torque]
            self.rate_i[:, self._by_torque] = 0.0
        throttle = self._mix(torque)
        return throttle if all_fly else np.where(self._flying, throttle, self._idle)

    def _mix(self, torque: Array) -> Array:
        """Rotor throttles for the thrust and torque asked; where they do not fit, turning gives way first, then
        height.
        """
        spread = self._mix_lean.dot(torque[:2]) + clamp(self._mix_turn * torque[2], -YAW_SHARE, YAW_SHARE)
        lift = np.minimum(self.thrust / self._full_n, 1.0 - np.maximum.reduce(spread))
        share = clamp(np.maximum(lift, 0.0) + spread, self._least, 1.0)
        return throttle_for(share, self.airframe.thrust_expo)
