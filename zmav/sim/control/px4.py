"""PX4's multicopter loops for N vehicles of one airframe, tuned by PX4's parameters: the same five blocks, with the
same limits, saturations and feedback of saturation.

    position (P) -> velocity (PID) -> acceleration to thrust vector and attitude -> attitude (quaternion P)
    -> body rates (PID) -> allocation

Sources: https://docs.px4.io/v1.16/en/flight_stack/controller_diagrams.html for the structure; D. Brescianini,
M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich, 2013, for the attitude with less weight on
yaw. A setpoint may enter at every level, the torque included.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import (
    Array,
    Flags,
    all_of,
    any_of,
    body_z,
    clamp,
    cross,
    dot,
    limit_length,
    quat_error,
    quat_from_euler,
    quat_multiply,
    thrust_frame,
)
from zmav.sim.control.cascade import Cascade, Estimated
from zmav.sim.control.setpoints import ACCELERATION, DIRECT, YAW_ANGLE, Setpoints
from zmav.sim.dynamics.airframe import GRAVITY, Airframe

VEL_D_CUTOFF_HZ = 5.0  # MPC_VELD_LP
GYRO_D_CUTOFF_HZ = 30.0  # IMU_DGYRO_CUTOFF
I_FADES_RADPS = 6.98  # 400 deg/s: the integrators of the rates stop where the error is a flip
SATURATED = 1e-4


class Px4Cascade(Cascade):
    """See :class:`Cascade`; throttles are what THR_MDL_FAC (``gains.curve``) makes of the rotors' shares of thrust."""

    def __init__(self, airframe: Airframe, setpoints: Setpoints, start: Array, yaw: Array) -> None:
        super().__init__(airframe, setpoints, start, yaw)
        n = start.shape[1]
        self.gains.hover[:] = airframe.hover_share
        self._vel_before: Array = np.zeros((3, n))
        self.vel_dot: Array = np.zeros((3, n))
        self._rate_before: Array = np.zeros((3, n))
        self.rate_dot: Array = np.zeros((3, n))
        self._missed: Array | None = None  # torque that found no room, with its sign
        self._products()

    def _products(self) -> None:
        """K times P, I and D: the parallel and the ideal form of the rate loop in one."""
        g = self.gains
        self._p, self._i, self._d = g.rate_k * g.rate_p, g.rate_k * g.rate_i, g.rate_k * g.rate_d
        self._seen = g.changes

    # ---- position and velocity

    def _drive(self, est: Estimated, raw: Flags, by_hand: Flags, ballistic: Flags, dt: float) -> None:
        g, ref, limits = self.gains, self.reference, self.setpoints.limits
        want = ref.vel + (ref.pos - est.pos) * g.pos_p
        want[:2] = limit_length(want[:2], limits["speed"])
        want[2] = clamp(want[2], -limits["speed_up"], limits["speed_down"])
        error = want - est.vel
        share = dt / (dt + 1.0 / (2.0 * np.pi * VEL_D_CUTOFF_HZ))
        self.vel_dot += ((est.vel - self._vel_before) / dt - self.vel_dot) * share
        self._vel_before = est.vel.copy()
        # Where only an acceleration is asked for, the velocity has no say: neither its error nor what was learnt of it.
        held = (self.setpoints.kinds != ACCELERATION)[[0, 0, 1]]
        acc = ref.acc + (error * g.vel_p + self.vel_i - self.vel_dot * g.vel_d) * held
        self.want_vel, self.want_acc = want, acc
        thrust = self._fit(self._thrust_vector(acc))
        self._integrate_velocity(error, acc, thrust, held, dt)
        self._forget(by_hand, ballistic)
        self._turn_at_once(raw)
        self._hold(est, thrust, by_hand, ballistic)

    def _thrust_vector(self, acc: Array) -> Array:
        """The thrust (3, N), shares of the full one, that gives an acceleration; leaning no more than allowed."""
        g, lean = self.gains, self.setpoints.limits["lean"]
        # The direction is that of a level flight (MPC_ACC_DECOUPLE): height and way do not disturb each other.
        level = limit_length(acc[:2], GRAVITY * np.tan(lean))
        up = 1.0 / np.sqrt(1.0 + dot(level, level) / GRAVITY**2)  # cosine of the lean
        down = acc[2] * (g.hover / GRAVITY) - g.hover
        collective = np.minimum(down / up, -g.thrust_min)
        out = np.empty_like(acc)
        out[:2] = level * (-collective * up / GRAVITY)
        out[2] = collective * up
        return out

    def _fit(self, thrust: Array) -> Array:
        """No more than there is: the height comes first, but for a margin that is kept for the way."""
        g = self.gains
        across = np.sqrt(dot(thrust[:2], thrust[:2]))
        kept = np.minimum(across, g.xy_margin)
        thrust[2] = np.maximum(thrust[2], -np.sqrt(g.thrust_max**2 - kept * kept))
        room = np.sqrt(np.maximum(g.thrust_max**2 - thrust[2] ** 2, 0.0))
        thrust[:2] *= np.minimum(room / np.maximum(across, 1e-9), 1.0)
        return thrust

    def _integrate_velocity(self, error: Array, acc: Array, thrust: Array, held: Flags, dt: float) -> None:
        """Integrators that do not wind up: vertically they wait, horizontally they follow what could be had."""
        g = self.gains
        low = (thrust[2] >= -g.thrust_min) & (error[2] >= 0.0)
        high = (thrust[2] <= -np.sqrt(g.thrust_max**2 - g.xy_margin**2)) & (error[2] <= 0.0)
        error[2] *= ~(low | high)
        produced = thrust[:2] * (GRAVITY / g.hover)
        excess = dot(acc[:2], acc[:2]) > dot(produced, produced)
        error[:2] -= (acc[:2] - limit_length(acc[:2], np.sqrt(dot(produced, produced)))) * (2.0 / g.vel_p[0]) * excess
        self.vel_i += error * held * g.vel_i * dt
        self.vel_i[2] = clamp(self.vel_i[2], -GRAVITY, GRAVITY)

    def _turn_at_once(self, raw: Flags) -> None:
        """A heading that is streamed goes to the attitude as it is; the others are turned to smoothly."""
        sp = self.setpoints
        direct = (raw | (sp.horizontal == DIRECT)) & (sp.yaw_kind == YAW_ANGLE) & self._flying
        if any_of(direct):
            self.yaw = np.where(direct, sp.yaw, self.yaw)
            self._turn = self._turn * ~direct

    def _hold(self, est: Estimated, thrust: Array, by_hand: Flags, ballistic: Flags) -> None:
        sp = self.setpoints
        size = np.sqrt(dot(thrust, thrust))
        self.attitude = thrust_frame(thrust / -np.maximum(size, 1e-6), self.yaw)
        if any_of(by_hand):
            self.attitude[:, by_hand] = quat_from_euler(sp.roll[by_hand], sp.pitch[by_hand], self.yaw[by_hand])
            # Lean as told: what is left to do is to carry the height, so divide by how upright the body is.
            size[by_hand] = (-thrust[2] / np.maximum(body_z(est.q)[2], 0.5))[by_hand]
        self.thrust = np.where(ballistic, sp.thrust, clamp(size, 0.0, 1.0)) * self._full_n

    # ---- attitude and rates

    def _rates(self, est: Estimated) -> Array:
        """Attitude loop: the axis of thrust first, the heading with ``yaw_weight`` of it."""
        g = self.gains
        down, wanted = body_z(est.q), body_z(self.attitude)
        # The shortest turn that brings the axis of thrust to where it is to be.
        tilt = np.empty_like(est.q)
        tilt[0] = 1.0 + dot(down, wanted)
        tilt[1:] = cross(down, wanted)
        size = np.sqrt(dot(tilt, tilt))
        flat = quat_multiply(tilt / np.maximum(size, 1e-9), est.q)
        flat = np.where(size > 1e-4, flat, self.attitude)  # upside down: any way round will do
        turn = quat_error(self.attitude, flat)
        half = np.arctan2(turn[3], turn[0])
        half = (half - np.pi * np.rint(half / np.pi)) * g.yaw_weight
        twist = np.zeros_like(est.q)
        twist[0], twist[3] = np.cos(half), np.sin(half)
        error = quat_multiply(quat_error(flat, est.q), twist)
        rate = error[1:] * (2.0 * np.where(error[0] < 0.0, -1.0, 1.0)) * g.angle_p
        rate[2] *= 1.0 / np.maximum(g.yaw_weight, 1e-3)
        # A turn fed forward is one about the world's down axis.
        if any_of(self._turn != 0.0):
            w, x, y, z = est.q
            rate[0] += 2.0 * (x * z - w * y) * self._turn
            rate[1] += 2.0 * (y * z + w * x) * self._turn
            rate[2] += down[2] * self._turn
        return clamp(rate, -g.rate_max, g.rate_max)

    def inner(self, est: Estimated, dt: float) -> Array:
        if not any_of(self._flying):
            self._rate_before = est.rate.copy()
            return self._idle
        g = self.gains
        if g.changes != self._seen:
            self._products()
        share = dt / (dt + 1.0 / (2.0 * np.pi * GYRO_D_CUTOFF_HZ))
        self.rate_dot += ((est.rate - self._rate_before) / dt - self.rate_dot) * share
        self._rate_before = est.rate.copy()
        miss = self.want_rate - est.rate
        torque = miss * self._p + self.rate_i - self.rate_dot * self._d + self.want_rate * g.rate_ff
        self._integrate_rates(miss, dt)
        if self._by_torque is not None:
            torque[:, self._by_torque] = self.setpoints.body[:, self._by_torque]
            self.rate_i[:, self._by_torque] = 0.0
        shares, self._missed = self.allocator.allocate(torque, self.thrust * (1.0 / self._full_n))
        throttle = _throttle(shares, g.curve)
        return throttle if all_of(self._flying) else np.where(self._flying, throttle, self._idle)

    def _integrate_rates(self, miss: Array, dt: float) -> None:
        """Where the rotors have no room for more torque, the integrators take no more of that sign."""
        g = self.gains
        error = miss
        if self._missed is not None:
            error = np.where(self._missed > SATURATED, np.minimum(miss, 0.0), miss)
            error = np.where(self._missed < -SATURATED, np.maximum(error, 0.0), error)
        fade = np.maximum(1.0 - (error * (1.0 / I_FADES_RADPS)) ** 2, 0.0)
        kept = clamp(self.rate_i + error * fade * self._i * dt, -g.rate_i_max, g.rate_i_max)
        self.rate_i = kept if all_of(self._flying) else kept * self._flying


def _throttle(share: Array, curve: Array) -> Array:
    """The inverse of (1 - c) u + c u^2, for each vehicle's own c (THR_MDL_FAC)."""
    if not any(curve.tolist()):
        return share
    linear = 1.0 - curve
    root = np.sqrt(linear * linear + 4.0 * curve * share) - linear
    result: Array = np.where(curve > 1e-6, root / np.maximum(2.0 * curve, 1e-6), share)
    return result
