"""The controllers of N planes: guidance and energy (every few ticks) -> roll, pitch and throttle -> rates -> surfaces
(every tick).

Structure, parameters and units after ArduPilot's (ardupilot.org, "Roll, Pitch and Yaw Controller Tuning"): an angle's
error over a time constant asks for a rate; feed-forward, P, I and D of the rate move the surface, scaled with airspeed
so that a surface does as much at any speed; a bank asks for the pitch rate of its coordinated turn, g tan(phi)
sin(phi) / V (Beard and McLain, section 9.2); the rudder goes with the aileron.
"""

from __future__ import annotations

import math

import numpy as np

from zmav.rotation import wrap
from zmav.sim.arrays import Array, Flags, clamp
from zmav.sim.control.cascade import Estimated
from zmav.sim.control.l1 import L1
from zmav.sim.control.planetargets import AILERON, ELEVATOR, ENERGY, LINE, PITCH, ROLL, Flown, PlaneTargets
from zmav.sim.control.tecs import Tecs
from zmav.sim.dynamics.airframe import GRAVITY

FULL = math.radians(45.0)  # what the rate controllers call full deflection
LEAST_BANK = math.radians(25.0)  # allowed however slow it flies
COORDINATED = math.radians(80.0)  # no more bank is reckoned with
STEEP = math.radians(70.0)  # of pitch: no turn is coordinated beyond


class _RateLoops:
    """Feed-forward and PID of the roll and the pitch rate, in their surfaces' shares; (2, N) throughout."""

    def __init__(self, gains: dict[str, Array], n: int) -> None:
        self._gains = gains
        self._wanted: Array = np.zeros((2, n))
        self._i: Array = np.zeros((2, n))
        self._error: Array = np.zeros((2, n))
        self._slope: Array = np.zeros((2, n))
        self._last: Array = np.zeros((2, n))

    def tune(self, dt: float) -> None:
        """Reckon what follows from the gains; to be called after they change."""
        parts = ("P", "I", "D", "FF", "IMAX", "FLTT", "FLTD")
        g = {part: np.array([self._gains[f"{axis}_RATE_{part}"] for axis in ("RLL", "PTCH")]) for part in parts}
        self._target_share, self._slope_share = _lowpass(g["FLTT"], dt), _lowpass(g["FLTD"], dt)
        slowest = self._gains["AIRSPEED_MIN"]
        self._g, self._slow = g, np.array([slowest, 0.5 * slowest])

    def update(self, wanted: Array, rate: Array, eas: Array, scale: Array, still: Flags, dt: float) -> Array:
        """Shares of the travel for a rate (rad/s). ``still``: the integrator is emptied; at a slow airspeed, or where
        the surface has no travel left, it does not grow.
        """
        g, moves = self._g, ~still
        self._wanted += (wanted - self._wanted) * self._target_share
        error = (self._wanted - rate) * (scale * scale)
        self._slope += ((error - self._error) / dt - self._slope) * self._slope_share
        self._error = error
        grown = clamp(self._i + error * g["I"] * dt, -g["IMAX"], g["IMAX"])
        hold = (np.abs(self._last) >= 1.0) | (eas < self._slow)
        self._i = np.where(hold & (np.abs(grown) > np.abs(self._i)), self._i, grown) * moves
        out = self._wanted * g["FF"] * scale + error * g["P"] + self._i + self._slope * g["D"] * moves
        self._last = clamp(out * (1.0 / FULL), -1.0, 1.0)
        return self._last


def _lowpass(cutoff_hz: Array, dt: float) -> Array:
    """Share of a first-order filter's step; all of it for a cutoff of zero."""
    rc = 1.0 / (2.0 * math.pi * np.maximum(cutoff_hz, 1e-3))
    result: Array = np.where(cutoff_hz > 0.0, dt / (dt + rc), 1.0)
    return result


class PlaneControl:
    """Controllers of N planes; ``surface`` (3, N) and ``throttle`` (N,) are what they ask for."""

    def __init__(self, targets: PlaneTargets, eas2tas: float) -> None:
        n = targets.lateral.shape[0]
        self.targets = targets
        self.eas2tas = eas2tas
        self.l1, self.tecs = L1(targets), Tecs(targets)
        self.surface: Array = np.zeros((3, n))
        self.throttle: Array = np.zeros(n)
        self.roll: Array = np.zeros(n)  # asked for
        self.pitch: Array = np.zeros(n)
        self.rate_loops = _RateLoops(targets.gains, n)
        self._tuned: tuple[int, float] | None = None

    def navigate(self, est: Estimated, euler: Array, airspeed: Array, dt: float) -> None:
        """Guidance and energy; ``euler`` (3, N) rad, ``airspeed`` (N,) true."""
        t = self.targets
        self.l1.update(est.pos, est.vel, euler[2], dt)
        by_path = t.lateral >= LINE
        steep = np.cos(clamp(euler[1], -math.pi / 3.0, math.pi / 3.0))
        bank = np.arctan(self.l1.accel / (GRAVITY * steep))
        wanted = np.where(by_path, bank, t.roll)
        self.roll = np.where(t.lateral >= ROLL, clamp(wanted, -t.roll_limit, t.roll_limit), wanted)
        self._keep_flying(airspeed)
        load = 1.0 / np.cos(clamp(np.abs(self.roll), 0.0, math.radians(85.0)))
        self.tecs.update(-est.pos[2], -est.vel[2], euler[1], euler[0], load, self.eas2tas, dt)

    def _keep_flying(self, airspeed: Array) -> None:
        """No more bank than this airspeed can carry (STALL_PREVENTION)."""
        g = self.targets.gains
        ratio = np.maximum(airspeed / (self.eas2tas * g["AIRSPEED_MIN"]), 1.0)
        most = np.maximum(np.arccos(1.0 / (ratio * ratio)), LEAST_BANK)
        guarded = (g["STALL_PREVENTION"] > 0.0) & (self.targets.lateral >= ROLL)
        self.roll = np.where(guarded, clamp(self.roll, -most, most), self.roll)

    def level(self, est: Estimated, euler: Array, force: Array, airspeed: Array, dt: float) -> None:
        """Attitude and rate loops, once a tick: ``force`` (3, N) m/s^2 is what the accelerometers read."""
        t, g = self.targets, self.targets.gains
        self.tecs.sense(airspeed, force[0] - GRAVITY * np.sin(euler[1]), dt)
        if self._tuned != (t.tuned, dt):
            self._tune(dt)
        eas = np.maximum(airspeed / self.eas2tas, 0.1)
        scale = clamp(g["SCALING_SPEED"] / eas, *self._scale_bounds)
        by_energy = t.upright == ENERGY
        self.pitch = np.where(by_energy, self.tecs.pitch, t.pitch)
        roll_rate = clamp(wrap(self.roll - euler[0]) / g["RLL2SRV_TCONST"], *self._roll_rates)
        rates = np.array([roll_rate, self._pitch_rate(euler, airspeed)])
        aileron, elevator = self.rate_loops.update(rates, est.rate[:2], eas, scale, t.idle, dt)
        self.surface[0] = np.where(t.lateral == AILERON, t.aileron, aileron)
        self.surface[1] = np.where(t.upright == ELEVATOR, t.elevator, elevator)
        self.surface[2] = self._rudder()
        wanted = np.where(t.auto_throttle, self.tecs.throttle, t.throttle)
        self.throttle = clamp(wanted, 0.0, 1.0)

    def _tune(self, dt: float) -> None:
        """Reckon what follows from the gains alone."""
        g = self.targets.gains
        self._tuned = self.targets.tuned, dt
        self.rate_loops.tune(dt)
        self._scale_bounds = (
            np.minimum(0.5, g["SCALING_SPEED"] / (2.0 * g["AIRSPEED_MAX"])),
            np.maximum(2.0, g["SCALING_SPEED"] / (0.7 * g["AIRSPEED_MIN"])),
        )
        self._roll_rates = _rates(g["RLL2SRV_RMAX"], g["RLL2SRV_RMAX"])
        self._pitch_rates = _rates(g["PTCH2SRV_RMAX_DN"], g["PTCH2SRV_RMAX_UP"])
        self._bank_margin = np.minimum(np.radians(g["ROLL_LIMIT_DEG"] + 5.0), math.radians(85.0))

    def _pitch_rate(self, euler: Array, airspeed: Array) -> Array:
        t, g = self.targets, self.targets.gains
        roll, pitch = euler[0], euler[1]
        upright = np.abs(roll) < 0.5 * math.pi
        bank = clamp(roll, -COORDINATED, COORDINATED)
        slowest = np.maximum(airspeed, g["AIRSPEED_MIN"])
        turn = np.cos(pitch) * np.abs(GRAVITY / slowest * np.tan(bank) * np.sin(bank)) * g["PTCH2SRV_RLL"]
        turn = np.where(np.abs(pitch) > STEEP, 0.0, turn)
        wanted = (self.pitch - pitch) / g["PTCH2SRV_TCONST"]
        rate = clamp(wanted + turn, *self._pitch_rates)
        rate = np.where(upright, rate, -wanted - turn)
        # Beyond the bank limit the bank comes first: the elevator would turn it, not raise it.
        lean = np.where(upright, np.abs(roll), math.pi - np.abs(roll))
        margin = self._bank_margin
        over = clamp((lean - margin) / (0.5 * math.pi - margin), 0.0, 1.0)
        rate = np.where(np.abs(pitch) < STEEP, rate * (1.0 - over), rate)
        result: Array = np.where(t.upright >= PITCH, rate, 0.0)
        return result

    def _rudder(self) -> Array:
        t, g = self.targets, self.targets.gains
        mixed = g["KFF_RDDRMIX"] * self.surface[0] + t.rudder
        return clamp(np.where(t.auto_rudder, mixed, t.rudder), -1.0, 1.0)

    def flown(self, index: int) -> Flown:
        """What is done about one plane."""
        l1, tecs, t = self.l1, self.tecs, self.targets
        by_energy = t.upright[index] == ENERGY
        return Flown(
            float(self.roll[index]),
            float(self.pitch[index]),
            float(l1.bearing[index]),
            float(l1.error[index]),
            float(l1.cross_track[index]),
            bool(l1.circling[index]),
            float(l1.distance[index]),
            float(tecs.speed_error[index]) if by_energy else 0.0,
            float(t.height[index]),
        )


def _rates(down: Array, up: Array) -> tuple[Array, Array]:
    """Bounds of a rate, rad/s, from degrees a second; zero is no bound."""
    return -np.radians(np.where(down > 0.0, down, 1e6)), np.radians(np.where(up > 0.0, up, 1e6))
