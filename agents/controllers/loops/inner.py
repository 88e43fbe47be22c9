"""The loops about the body's axes: attitude, rates."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from agents.controllers.controller import Controller, parameter
from agents.controllers.loops.parts import FADE, Axis, Vector, clamp, down_axis, turn_from
from agents.controllers.types import RatesThrust, Reference, State, TorqueThrust, Trim
from zmav.rotation import Quaternion, product

I_FADES = 6.98
"""rad/s (400 degrees): where the error is a flip the integrators of the rates stop"""
OPPOSITE = 1e-4


class AttitudeLoop(Controller):
    """P on the quaternion's error: the axis of thrust first, the heading with less weight.

    Source: D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich, 2013.
    """

    level = "attitude"

    kp_roll = parameter(6.5, 0.0, 12.0, "1/s", "MC_ROLL_P")
    kp_pitch = parameter(6.5, 0.0, 12.0, "1/s", "MC_PITCH_P")
    kp_yaw = parameter(2.8, 0.0, 5.0, "1/s", "MC_YAW_P")
    yaw_weight = parameter(0.4, 0.05, 1.0, "", "of the heading beside the lean (MC_YAW_WEIGHT)")
    max_roll = parameter(math.radians(220.0), 0.1, 30.0, "rad/s", "MC_ROLLRATE_MAX")
    max_pitch = parameter(math.radians(220.0), 0.1, 30.0, "rad/s", "MC_PITCHRATE_MAX")
    max_yaw = parameter(math.radians(200.0), 0.1, 30.0, "rad/s", "MC_YAWRATE_MAX")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self.fading: Vector = (0.0, 0.0, 0.0)
        """rad/s that are left of what the autopilot asked for beside this, just before"""

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        p, q, r = self._law(state, reference)
        x, y, z = trim.rates.tolist()
        self.fading = (x - p, y - q, z - r)

    def update(self, state: State, reference: Reference) -> RatesThrust:
        p, q, r = self._law(state, reference)
        x, y, z = self.fading
        rates = np.array((p + x, q + y, r + z))
        left = FADE / (FADE + state.dt)
        self.fading = (x * left, y * left, z * left)
        return RatesThrust(rates, reference.thrust)

    def _law(self, state: State, reference: Reference) -> Vector:
        actual, wanted = _quaternion(state.q), _quaternion(reference.attitude)
        x, y, z, yaw = _error(actual, wanted, self.yaw_weight)
        told = self.signals
        told["error.x"], told["error.y"], told["error.z"] = x, y, yaw
        # A turn fed forward is one about the world's down axis.
        turn = reference.yaw_rate
        qw, qx, qy, qz = actual
        p = x * self.kp_roll + 2.0 * (qx * qz - qw * qy) * turn
        q = y * self.kp_pitch + 2.0 * (qy * qz + qw * qx) * turn
        r = z * self.kp_yaw / self.yaw_weight + (1.0 - 2.0 * (qx * qx + qy * qy)) * turn
        return (
            clamp(p, -self.max_roll, self.max_roll),
            clamp(q, -self.max_pitch, self.max_pitch),
            clamp(r, -self.max_yaw, self.max_yaw),
        )


class RatesLoop(Controller):
    """PID on the body rates, with what is asked for fed forward; D is on the measurement, low-passed.

    Where a motor is at the end of its range, or a torque at that of its own, the integrators take no more of the sign
    that asks for more. While the autopilot flies they follow the rates that it asks for, as its own do (but forget
    within a second, as nobody says when it stands on the ground): of its torque it tells nothing.
    """

    level = "rates"

    kp_roll = parameter(0.15, 0.0, 0.6, "s/rad", "MC_ROLLRATE_P")
    ki_roll = parameter(0.2, 0.0, 2.0, "1/rad", "MC_ROLLRATE_I")
    kd_roll = parameter(0.003, 0.0, 0.02, "s²/rad", "MC_ROLLRATE_D")
    ff_roll = parameter(0.0, 0.0, 0.5, "s/rad", "MC_ROLLRATE_FF")
    kp_pitch = parameter(0.15, 0.0, 0.6, "s/rad", "MC_PITCHRATE_P")
    ki_pitch = parameter(0.2, 0.0, 2.0, "1/rad", "MC_PITCHRATE_I")
    kd_pitch = parameter(0.003, 0.0, 0.02, "s²/rad", "MC_PITCHRATE_D")
    ff_pitch = parameter(0.0, 0.0, 0.5, "s/rad", "MC_PITCHRATE_FF")
    kp_yaw = parameter(0.2, 0.0, 0.6, "s/rad", "MC_YAWRATE_P")
    ki_yaw = parameter(0.1, 0.0, 2.0, "1/rad", "MC_YAWRATE_I")
    kd_yaw = parameter(0.0, 0.0, 0.02, "s²/rad", "MC_YAWRATE_D")
    ff_yaw = parameter(0.0, 0.0, 0.5, "s/rad", "MC_YAWRATE_FF")
    i_max = parameter(0.3, 0.0, 1.0, "", "of each integrator (MC_RR_INT_LIM and its like)")
    d_cutoff = parameter(30.0, 5.0, 100.0, "Hz", "of the low pass before D (IMU_DGYRO_CUTOFF)")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self.axes = (Axis(), Axis(), Axis())

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        gains = (self.ki_roll, self.ki_pitch, self.ki_yaw)
        wanted, measured = trim.rates.tolist(), state.rates.tolist()
        for axis, gain, want, is_ in zip(self.axes, gains, wanted, measured, strict=True):
            axis.measure(is_, state.t, self.d_cutoff)
            axis.forget(state.dt)
            axis.add(_unless_flip(want - is_) * gain, state.dt, self.i_max)

    def update(self, state: State, reference: Reference) -> TorqueThrust:
        full = bool(state.saturated)
        torques = []
        gains = (
            (self.kp_roll, self.ki_roll, self.kd_roll, self.ff_roll),
            (self.kp_pitch, self.ki_pitch, self.kd_pitch, self.ff_pitch),
            (self.kp_yaw, self.ki_yaw, self.kd_yaw, self.ff_yaw),
        )
        wanted, measured, told = reference.rates.tolist(), state.rates.tolist(), self.signals
        for name, axis, (p, i, d, ff), want, is_ in zip("xyz", self.axes, gains, wanted, measured, strict=True):
            miss = want - is_
            torque = miss * p + axis.integral - axis.measure(is_, state.t, self.d_cutoff) * d + want * ff
            more = miss * torque > 0.0 and (full or abs(torque) >= 1.0)
            axis.add(0.0 if more else _unless_flip(miss) * i, state.dt, self.i_max)
            torques.append(clamp(torque, -1.0, 1.0))
            told[f"error.{name}"], told[f"integral.{name}"] = miss, axis.integral
        told["saturated"] = float(full)
        return TorqueThrust(np.array(torques), reference.thrust)


def _error(actual: Quaternion, wanted: Quaternion, yaw_weight: float) -> tuple[float, float, float, float]:
    """Twice the vector part of the weighted turn from ``actual`` to ``wanted`` in body axes, and the whole error of
    the heading; rad.
    """
    ax, ay, az = down_axis(actual)
    wx, wy, wz = down_axis(wanted)
    # The shortest turn that brings the axis of thrust to where it is to be, in the world's axes.
    tw, tx, ty, tz = 1.0 + ax * wx + ay * wy + az * wz, ay * wz - az * wy, az * wx - ax * wz, ax * wy - ay * wx
    size = math.sqrt(tw * tw + tx * tx + ty * ty + tz * tz)
    # Upside down any way round will do.
    flat = product((tw / size, tx / size, ty / size, tz / size), actual) if size > OPPOSITE else wanted
    around = turn_from(flat, wanted)
    half = math.atan2(around[3], around[0])
    half -= math.pi * round(half / math.pi)
    twist = (math.cos(half * yaw_weight), 0.0, 0.0, math.sin(half * yaw_weight))
    w, x, y, z = product(turn_from(actual, flat), twist)
    twice = -2.0 if w < 0.0 else 2.0
    return twice * x, twice * y, twice * z, 2.0 * half


def _unless_flip(miss: float) -> float:
    return miss * max(1.0 - (miss / I_FADES) ** 2, 0.0)


def _quaternion(q: np.ndarray) -> Quaternion:
    w, x, y, z = q.tolist()
    return w, x, y, z
