"""The loops over the ground and the height: position, velocity, altitude."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from agents.controllers.controller import Controller, parameter
from agents.controllers.loops.parts import (
    FADE,
    GRAVITY,
    LEARN,
    Axis,
    Hover,
    attitude_of,
    clamp,
    down_axis,
    shortened,
)
from agents.controllers.types import AttitudeThrust, Reference, State, Trim, Velocity
from zmav.rotation import wrap

STEEPEST = 0.5
"""cosine of the lean beyond which a thrust is no longer raised for the height"""


class PositionLoop(Controller):
    """P on the position, with the reference's velocity fed forward."""

    level = "position"

    kp = parameter(0.95, 0.0, 3.0, "1/s", "over the ground (MPC_XY_P)")
    kp_z = parameter(1.0, 0.0, 3.0, "1/s", "of the height (MPC_Z_P)")
    vel_max = parameter(12.0, 0.5, 20.0, "m/s", "over the ground, at most (MPC_XY_VEL_MAX)")
    vel_max_up = parameter(3.0, 0.5, 8.0, "m/s", "climbing, at most (MPC_Z_VEL_MAX_UP)")
    vel_max_dn = parameter(1.5, 0.5, 4.0, "m/s", "descending, at most (MPC_Z_VEL_MAX_DN)")

    def update(self, state: State, reference: Reference) -> Velocity:
        x, y, z = (reference.pos - state.pos).tolist()
        vx, vy, vz = reference.vel.tolist()
        north, east = shortened(vx + x * self.kp, vy + y * self.kp, self.vel_max)
        down = clamp(vz + z * self.kp_z, -self.vel_max_up, self.vel_max_dn)
        told = self.signals
        told["error.x"], told["error.y"], told["error.z"] = x, y, z
        told["vel.x"], told["vel.y"], told["vel.z"] = north, east, down
        return Velocity(np.array((north, east, down)), reference.yaw, reference.yaw_rate)


class ThrustLoop(Controller):
    """What loops have in common that hold a climb by the thrust."""

    d_cutoff = parameter(5.0, 0.5, 50.0, "Hz", "of the low pass before D (MPC_VELD_LP)")
    thr_min = parameter(0.12, 0.0, 0.5, "", "of full thrust (MPC_THR_MIN)")
    thr_max = parameter(1.0, 0.3, 1.0, "", "of full thrust (MPC_THR_MAX)")
    hover_tau = parameter(10.0, 1.0, 100.0, "s", "in which the hover thrust is learned")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self.down = Axis()
        self.hover = Hover()
        self.given = 0.5
        """the thrust of the last cycle, 0 to 1"""

    def _learn(self, state: State, tau: float) -> float:
        """Where the hover thrust changes, the integrator gives way, so that the thrust does not; gives how upright the
        body is.
        """
        upright = down_axis(state.q.tolist())[2]
        ratio = self.hover.learn(self.given * upright, self.down.slope, state.dt, tau)
        self.down.integral += GRAVITY * (1.0 - ratio)
        return upright


class VelocityLoop(ThrustLoop):
    """PID on the velocity, and from the acceleration that it asks for to an attitude and a thrust.

    D is on the measurement. Where the thrust or the lean is at its limit the integrators do not wind up: vertically
    they wait, over the ground they follow what could be had.
    """

    level = "velocity"
    gives = "attitude"

    kp = parameter(1.8, 0.0, 6.0, "1/s", "over the ground (MPC_XY_VEL_P_ACC)")
    ki = parameter(0.4, 0.0, 4.0, "1/s²", "over the ground (MPC_XY_VEL_I_ACC)")
    kd = parameter(0.2, 0.0, 2.0, "", "over the ground (MPC_XY_VEL_D_ACC)")
    kp_z = parameter(4.0, 0.0, 12.0, "1/s", "of the climb (MPC_Z_VEL_P_ACC)")
    ki_z = parameter(2.0, 0.0, 6.0, "1/s²", "of the climb (MPC_Z_VEL_I_ACC)")
    kd_z = parameter(0.0, 0.0, 2.0, "", "of the climb (MPC_Z_VEL_D_ACC)")
    tilt_max = parameter(math.radians(45.0), 0.1, 1.4, "rad", "of lean (MPC_TILTMAX_AIR)")
    thr_xy_marg = parameter(0.3, 0.0, 0.3, "", "of full thrust kept for the way (MPC_THR_XY_MARG)")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self.axes = (Axis(), Axis(), self.down)
        self.turning = 0.0
        """rad that are left of the heading that the autopilot asked for beside the reference's, just before"""

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        partly = self._partly(state, reference)
        self.given = trim.thrust
        self._learn(state, min(LEARN, self.hover_tau))
        x, y, z = down_axis(trim.attitude.tolist())
        hover, lift = self.hover.share, max(trim.thrust * z, 1e-3)
        # The acceleration that would make this thrust and this attitude of it, as far as it could.
        most = GRAVITY * math.tan(self.tilt_max)
        north, east = shortened(-x * trim.thrust * GRAVITY / lift, -y * trim.thrust * GRAVITY / lift, most)
        wanted = (north, east, (1.0 - lift / hover) * GRAVITY)
        self.turning = wrap(State(q=trim.attitude).yaw - reference.yaw)
        for axis, want, part in zip(self.axes, wanted, partly, strict=True):
            axis.settle(want, part, state.dt)

    def update(self, state: State, reference: Reference) -> AttitudeThrust:
        north, east, down = self.axes
        partly = self._partly(state, reference)
        self._learn(state, self.hover_tau)
        ax, ay, az = (part + axis.integral + axis.fading for part, axis in zip(partly, self.axes, strict=True))
        x, y, z = self._thrust(ax, ay, az)
        self._integrate(state, reference, (ax, ay, az), (x, y, z))
        size = max(math.sqrt(x * x + y * y + z * z), 1e-6)
        attitude = attitude_of((-x / size, -y / size, -z / size), reference.yaw + self.turning)
        self.turning *= FADE / (FADE + state.dt)
        self.given = min(size, 1.0)
        told = self.signals
        told["acc.x"], told["acc.y"], told["acc.z"] = ax, ay, az
        told["integral.x"], told["integral.y"], told["integral.z"] = north.integral, east.integral, down.integral
        told["hover"] = self.hover.share
        return AttitudeThrust(np.array(attitude), self.given, reference.yaw_rate)

    def _partly(self, state: State, reference: Reference) -> tuple[float, float, float]:
        """What is fed forward, P and D: m/s²."""
        north, east, down = self.axes
        vx, vy, vz = state.vel.tolist()
        rx, ry, rz = reference.vel.tolist()
        fx, fy, fz = reference.acc.tolist()
        t, cutoff = state.t, self.d_cutoff
        told = self.signals
        told["error.x"], told["error.y"], told["error.z"] = rx - vx, ry - vy, rz - vz
        return (
            fx + (rx - vx) * self.kp - north.measure(vx, t, cutoff) * self.kd,
            fy + (ry - vy) * self.kp - east.measure(vy, t, cutoff) * self.kd,
            fz + (rz - vz) * self.kp_z - down.measure(vz, t, cutoff) * self.kd_z,
        )

    def _thrust(self, ax: float, ay: float, az: float) -> tuple[float, float, float]:
        """The thrust (NED, shares of the full one) that gives an acceleration; leaning no more than allowed."""
        hover = self.hover.share
        # The lean is that of a level flight (MPC_ACC_DECOUPLE): height and way do not disturb each other.
        lx, ly = shortened(ax, ay, GRAVITY * math.tan(self.tilt_max))
        cosine = 1.0 / math.sqrt(1.0 + (lx * lx + ly * ly) / GRAVITY**2)
        z = min((az / GRAVITY - 1.0) * hover, -self.thr_min * cosine)
        x, y = lx * -z / GRAVITY, ly * -z / GRAVITY
        # No more than there is: the height comes first, but for a margin that is kept for the way.
        kept = min(math.hypot(x, y), self.thr_xy_marg)
        z = max(z, -math.sqrt(self.thr_max**2 - kept * kept))
        x, y = shortened(x, y, math.sqrt(max(self.thr_max**2 - z * z, 0.0)))
        return x, y, z

    def _integrate(
        self, state: State, reference: Reference, acc: tuple[float, float, float], thrust: tuple[float, float, float]
    ) -> None:
        ex, ey, ez = (reference.vel - state.vel).tolist()
        x, y, z = thrust
        least, most = -self.thr_min, -math.sqrt(self.thr_max**2 - self.thr_xy_marg**2)
        if (z >= least and ez >= 0.0) or (z <= most and ez <= 0.0):
            ez = 0.0
        had = math.hypot(x, y) * GRAVITY / self.hover.share
        if math.hypot(acc[0], acc[1]) > had and self.kp > 0.0:
            hx, hy = shortened(acc[0], acc[1], had)
            ex, ey = ex - (acc[0] - hx) * 2.0 / self.kp, ey - (acc[1] - hy) * 2.0 / self.kp
        north, east, down = self.axes
        # What fades out is as if the reference moved over from what flew before.
        ex, ey = ex + north.fading / max(self.kp, 0.1), ey + east.fading / max(self.kp, 0.1)
        ez += down.fading / max(self.kp_z, 0.1)
        north.add(ex * self.ki, state.dt, GRAVITY)
        east.add(ey * self.ki, state.dt, GRAVITY)
        down.add(ez * self.ki_z, state.dt, GRAVITY)


class AltitudeLoop(ThrustLoop):
    """P on the height and PID on the climb, to a thrust; the attitude is the reference's. The thrust makes up for the
    lean that there is.
    """

    level = "altitude"
    gives = "attitude"

    kp = parameter(1.0, 0.0, 3.0, "1/s", "of the height (MPC_Z_P)")
    vel_kp = parameter(4.0, 0.0, 12.0, "1/s", "of the climb (MPC_Z_VEL_P_ACC)")
    vel_ki = parameter(2.0, 0.0, 6.0, "1/s²", "of the climb (MPC_Z_VEL_I_ACC)")
    vel_kd = parameter(0.0, 0.0, 2.0, "", "of the climb (MPC_Z_VEL_D_ACC)")
    vel_max_up = parameter(3.0, 0.5, 8.0, "m/s", "climbing, at most (MPC_Z_VEL_MAX_UP)")
    vel_max_dn = parameter(1.5, 0.5, 4.0, "m/s", "descending, at most (MPC_Z_VEL_MAX_DN)")

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        _, partly = self._partly(state, reference)
        self.given = trim.thrust
        upright = max(self._learn(state, min(LEARN, self.hover_tau)), STEEPEST)
        wanted = (1.0 - trim.thrust * upright / self.hover.share) * GRAVITY
        self.down.settle(wanted, partly, state.dt)

    def update(self, state: State, reference: Reference) -> AttitudeThrust:
        down = self.down
        error, partly = self._partly(state, reference)
        upright = max(self._learn(state, self.hover_tau), STEEPEST)
        acc = partly + down.integral + down.fading
        thrust = clamp((1.0 - acc / GRAVITY) * self.hover.share / upright, self.thr_min, self.thr_max)
        # At an end the integrator waits: the thrust falls as the wanted climb does.
        waits = (thrust <= self.thr_min and error > 0.0) or (thrust >= self.thr_max and error < 0.0)
        # What fades out is as if the reference moved over from what flew before.
        moved = error + down.fading / max(self.vel_kp, 0.1)
        down.add(0.0 if waits else moved * self.vel_ki, state.dt, GRAVITY)
        self.given = thrust
        told = self.signals
        told["error"], told["acc"] = error, acc
        told["integral"], told["hover"] = down.integral, self.hover.share
        return AttitudeThrust(reference.attitude, thrust, reference.yaw_rate)

    def _partly(self, state: State, reference: Reference) -> tuple[float, float]:
        """The error of the climb (m/s, down), and what is fed forward, P and D (m/s², down)."""
        measured = float(state.vel[2])
        height = float(reference.pos[2] - state.pos[2])
        wanted = clamp(float(reference.vel[2]) + height * self.kp, -self.vel_max_up, self.vel_max_dn)
        error = wanted - measured
        slope = self.down.measure(measured, state.t, self.d_cutoff)
        self.signals["height"] = height
        return error, float(reference.acc[2]) + error * self.vel_kp - slope * self.vel_kd
