"""A small flight controller of its own, for the tests' protocol peers: attitude and position by proportional-derivative
loops, and an estimate made of nothing but what sensors say.

It knows no more of the simulator than the field's conventions: NED, forward-right-down, SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

G = 9.80665
STEEPEST = 0.35  # rad
Vector = tuple[float, float, float]


@dataclass
class State:
    """What the controller flies by: position, velocity (world), roll, pitch, yaw, and body rates."""

    pos: list[float]
    vel: list[float]
    euler: list[float]
    rate: list[float]


def state_of(told: Any) -> State:
    """An answer of the JSON interface."""
    w, x, y, z = told["quaternion"]
    euler = [
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(min(2 * (w * y - x * z), 1.0), -1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    ]
    return State(told["position"], told["velocity"], euler, told["imu"]["gyro"])


@dataclass(frozen=True)
class Frame:
    """A vehicle: each rotor as (roll, pitch, yaw) share of the torque it gives, the throttle that hovers, and throttle
    per rad/s of roll and pitch rate, and of yaw rate.
    """

    rotors: tuple[tuple[float, float, float], ...]
    hover: float
    lean_gain: float
    turn_gain: float


# In the motor order of ArduPilot's plus frame (right, left, front, rear) and PX4's X (front right, rear left, front
# left, rear right). A rotor on the left rolls to the right, one in front pitches up, one that turns counter-clockwise
# yaws to the right.
PLUS = Frame(((-1, 0, 1), (1, 0, 1), (0, 1, -1), (0, -1, -1)), hover=0.39, lean_gain=0.02, turn_gain=0.1)
CROSS = Frame(((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1)), hover=0.49, lean_gain=0.08, turn_gain=0.25)


def steer(frame: Frame, state: State, target: Vector, yaw: float) -> list[float]:
    """Throttles that bring it to ``target`` with its nose at ``yaw``."""
    error = [t - p for t, p in zip(target, state.pos, strict=True)]
    far = max(math.hypot(error[0], error[1]) / 3.0, 1.0)
    want = [1.0 * e / far for e in error[:2]]
    north, east = (1.6 * (w - v) for w, v in zip(want, state.vel[:2], strict=True))
    down = 2.5 * (min(max(error[2], -2.0), 1.0) - state.vel[2])
    roll, pitch, heading = state.euler
    c, s = math.cos(heading), math.sin(heading)
    want_pitch = min(max(-(north * c + east * s) / G, -STEEPEST), STEEPEST)
    want_roll = min(max((east * c - north * s) / G, -STEEPEST), STEEPEST)
    turn = math.remainder(yaw - heading, 2 * math.pi)
    p, q, r = state.rate
    torque = (
        frame.lean_gain * (5.0 * (want_roll - roll) - p),
        frame.lean_gain * (5.0 * (want_pitch - pitch) - q),
        frame.turn_gain * (1.0 * turn - r),
    )
    lift = frame.hover * (1.0 - down / G) / max(math.cos(roll) * math.cos(pitch), 0.5)
    throttles = [lift + sum(a * b for a, b in zip(rotor, torque, strict=True)) for rotor in frame.rotors]
    return [min(max(throttle, 0.0), 1.0) for throttle in throttles]


class Observer:
    """Attitude from gyroscopes, pulled to the accelerometers' down and the compass's north; position from
    accelerometers, pulled to the GPS and the barometer. ``declination``: of the place, rad.
    """

    def __init__(self, declination: float) -> None:
        self._declination = declination
        self.state: State | None = None
        self._euler: list[float] | None = None
        self._alt0 = 0.0
        self._fixes = 0

    def imu(self, gyro: Vector, accel: Vector, mag: Vector, altitude: float, dt: float) -> None:
        """One reading, ``dt`` seconds after the last; ``altitude`` by the barometer, m."""
        tilt = (math.atan2(-accel[1], -accel[2]), math.atan2(accel[0], math.hypot(accel[1], accel[2])))
        if self._euler is None:
            self._euler = [*tilt, 0.0]
            self._euler[2] = self._north(mag)
            self._alt0 = altitude
        roll, pitch, yaw = self._euler
        p, q, r = gyro
        sr, cr, tp, cp = math.sin(roll), math.cos(roll), math.tan(pitch), math.cos(pitch)
        roll += dt * (p + (q * sr + r * cr) * tp + 0.05 * (tilt[0] - roll))
        pitch += dt * (q * cr - r * sr + 0.05 * (tilt[1] - pitch))
        yaw += dt * ((q * sr + r * cr) / cp + 0.5 * math.remainder(self._north(mag) - yaw, 2 * math.pi))
        self._euler = [roll, pitch, yaw]
        state = self.state
        if state is None:
            return
        state.euler, state.rate = self._euler, list(gyro)
        push = to_world(accel, roll, pitch, yaw)
        for i, a in enumerate((push[0], push[1], push[2] + G)):
            state.pos[i] += state.vel[i] * dt + 0.5 * a * dt * dt
            state.vel[i] += a * dt
        off = (self._alt0 - altitude) - state.pos[2]
        state.pos[2] += 1.0 * off * dt
        state.vel[2] += 0.5 * off * dt

    def _north(self, mag: Vector) -> float:
        """Heading by the compass, with the tilt taken out."""
        assert self._euler is not None
        roll, pitch, _ = self._euler
        x, y, _ = to_world(mag, roll, pitch, 0.0)
        return math.atan2(-y, x) + self._declination

    def gps(self, pos: Vector, vel: Vector) -> None:
        """A solution: metres about any fixed point, m/s."""
        self._fixes += 1
        if self.state is None and self._euler is not None:
            self.state = State([pos[0], pos[1], 0.0], list(vel), self._euler, [0.0, 0.0, 0.0])
        if self.state is None:
            return
        for i in range(2):
            self.state.pos[i] += 0.1 * (pos[i] - self.state.pos[i])
            self.state.vel[i] += 0.3 * (vel[i] - self.state.vel[i])


def to_world(vector: Sequence[float], roll: float, pitch: float, yaw: float) -> Vector:
    """A body vector in world axes (Z-Y-X)."""
    x, y, z = vector
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return (
        cp * cy * x + (sr * sp * cy - cr * sy) * y + (cr * sp * cy + sr * sy) * z,
        cp * sy * x + (sr * sp * sy + cr * cy) * y + (cr * sp * sy - sr * cy) * z,
        -sp * x + sr * cp * y + cr * cp * z,
    )
