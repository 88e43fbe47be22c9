"""EV2: the cascade nonlinear controller of the MAS paper's second validation, from positions to torques.

Outer loop by feedback linearisation (:mod:`agents.controllers.linearising`), inner loop by command-filtered
backstepping (:mod:`agents.controllers.backstepping`); the equations stand there.

The paper's page is not at hand: what is given of it are these equations and "nine nonlinear integrators". They are
counted here as three of the position's error, three of the filter (Ω_ref) and three of its compensating signal (ε);
what only estimates or leads (p'', the rotors' lag, p_ref''') is not counted. Decided here, besides limits and windup:

- Φ_ref' comes from the outer loop's own equations and is not filtered.
- Roll and pitch are those that point the thrust at the heading that the vehicle has, not at the one that it is to have:
  otherwise it is pushed aside while it turns.
- Newtons of full thrust are found at hand-over from what the autopilot hovers with, as battery and air change them;
  torques are scaled alike.
- Of the rotors' lag, which the equations leave out, torques are rid by a lead of (1 + ``rotor_tau`` s) / (1 +
  ``lead_tau`` s): by the linear model of one axis in hover, cycle and hold included, it bears 38 ms of further delay,
  and 21 ms without the lead (phase margins 40 and 20 degrees).
- At hand-over the reference begins at the vehicle's own motion and comes to the given one within seconds (``ease``):
  p_e^{I,0} then is what the wind needs, and not what errors of the autopilot's own following would ask for at once.
- The filters begin at hand-over with the vehicle's rates and no error kept account of (Ω_ref = Ω, ε = 0).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from agents.controllers.backstepping import Backstepping, Inner, Vec, add, angle_rates, less, scaled
from agents.controllers.controller import Controller, parameter
from agents.controllers.linearising import GRAVITY, Aim, Linearising, Outer
from agents.controllers.loops.parts import down_axis
from agents.controllers.types import Output, Reference, State, TorqueThrust, Trim, plain
from zmav.rotation import euler

SETTLE_S = 1.0  # over so long the autopilot's thrust is set against the weight
SCALE = (0.6, 1.4)  # of the full thrust that is told by the parameter
LEAST_LIFT = 0.15  # of full thrust: below it nothing hovers by it
TURN_SHARE = 0.6  # of the torque that there is, for the filter's own turning
LONGEST_S = 0.04  # of a cycle: after a gap the filters do not leap


class Ev2(Controller):
    """Level ``position``, gives ``torque``: nothing is left to the autopilot but its mixer. Follows position, velocity,
    acceleration, yaw and rate of yaw of its reference. The defaults are the hexarotor's of 3.2 kg.
    """

    level = "position"
    gives = "torque"

    mass = parameter(3.2, 0.2, 30.0, "kg", "of the vehicle with what it carries")
    inertia_x = parameter(0.043, 1e-4, 5.0, "kg m²", "about the forward axis")
    inertia_y = parameter(0.040, 1e-4, 5.0, "kg m²", "about the right axis")
    inertia_z = parameter(0.069, 1e-4, 5.0, "kg m²", "about the down axis")
    thrust_full = parameter(62.1, 1.0, 1000.0, "N", "of all rotors at full thrust, the battery fresh")
    torque_roll = parameter(6.98, 0.01, 200.0, "N m", "of a normalised torque of one")
    torque_pitch = parameter(6.98, 0.01, 200.0, "N m", "of a normalised torque of one")
    torque_yaw = parameter(0.994, 0.01, 200.0, "N m", "of a normalised torque of one")
    rotor_tau = parameter(0.035, 0.0, 0.3, "s", "lag of the rotors")
    lead_tau = parameter(0.012, 0.002, 0.3, "s", "lag that is left of it; no less than rotor_tau: no lead")

    kp_xy = parameter(9.0, 0.0, 30.0, "1/s²", "K_P, level")
    kp_z = parameter(9.0, 0.0, 30.0, "1/s²", "K_P of the height")
    kd_xy = parameter(5.0, 0.1, 15.0, "1/s", "K_D, level")
    kd_z = parameter(5.0, 0.1, 15.0, "1/s", "K_D of the height")
    ki_xy = parameter(5.0, 0.0, 20.0, "1/s³", "K_I, level")
    ki_z = parameter(5.0, 0.0, 20.0, "1/s³", "K_I of the height")

    gamma1_tilt = parameter(4.5, 0.0, 30.0, "1/s", "Γ1 of roll and pitch")
    gamma1_yaw = parameter(2.5, 0.0, 15.0, "1/s", "Γ1 of yaw")
    gamma2_tilt = parameter(0.77, 0.0, 30.0, "N m s", "Γ2 about the forward and right axes")
    gamma2_yaw = parameter(0.55, 0.0, 30.0, "N m s", "Γ2 about the down axis")
    filter_tilt = parameter(18.0, 1.0, 200.0, "1/s", "Γ̄ about the forward and right axes")
    filter_yaw = parameter(10.0, 1.0, 200.0, "1/s", "Γ̄ about the down axis")

    ease = parameter(1.5, 0.3, 10.0, "1/s", "how soon the errors at hand-over are taken up")
    speed_max = parameter(5.0, 0.5, 30.0, "m/s", "beside the reference's, that an error of position asks for")
    integral_max = parameter(5.0, 0.0, 20.0, "m/s²", "that an integral grows to")
    lean_max = parameter(45.0, 5.0, 70.0, "deg", "that is asked for")
    thrust_low = parameter(0.08, 0.01, 0.5, "", "least thrust, of the full")
    thrust_high = parameter(0.95, 0.3, 1.0, "", "most thrust, of the full")
    rate_max = parameter(4.0, 0.5, 20.0, "rad/s", "asked for about the forward and right axes")
    rate_max_yaw = parameter(1.5, 0.1, 10.0, "rad/s", "asked for about the down axis")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self.outer, self.inner = Linearising(), Backstepping()
        self.full = self.thrust_full
        """N of full thrust, as found at hand-over"""
        self.behind: Vec | None = None
        """N m, the torque as it was ``lead_tau`` ago; None: none has been given"""
        self._lift = self._fall = 0.0
        self._seen: float | None = None

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        """The first update gives the trim's thrust and aims at its tilt, whatever the errors are then."""
        since = 0.0 if self._seen is None else state.t - self._seen
        since = since if 0.0 < since < SETTLE_S else 0.0
        self._seen = state.t
        self._weigh(state, trim.thrust, since)
        error, slip = plain(reference.pos - state.pos), plain(reference.vel - state.vel)
        acc, vel, axis, asked = (
            plain(reference.acc),
            plain(state.vel),
            down_axis(state.q.tolist()),
            down_axis(trim.attitude.tolist()),
        )
        thrust = trim.thrust * self.full / self.mass
        self.outer.reset(self._outer_gains(), error, slip, acc, vel, axis, asked, thrust, since)
        self.inner.reset(plain(state.rates))
        self.behind = None

    def update(self, state: State, reference: Reference) -> Output:
        dt = min(max(state.dt, 1e-4), LONGEST_S)
        error, slip = plain(reference.pos - state.pos), plain(reference.vel - state.vel)
        acc, vel, axis = plain(reference.acc), plain(state.vel), down_axis(state.q.tolist())
        angles, rates = euler(state.q.tolist()), plain(state.rates)
        turn = angle_rates(angles, rates)[2]
        aim = self.outer.step(self._outer_gains(), error, slip, acc, vel, angles[2], turn, axis, dt)
        wanted = (aim.roll, aim.pitch, reference.yaw)
        slopes = (aim.roll_slope, aim.pitch_slope, reference.yaw_rate)
        torque = self.inner.step(self._inner_gains(), angles, rates, wanted, slopes, dt)
        self._tell(error, slip, wanted, slopes, torque, aim)
        return self._normalised(self._led(torque, dt), aim.thrust)

    def _led(self, torque: Vec, dt: float) -> Vec:
        """What has the rotors give ``torque`` sooner than they would by themselves."""
        behind = torque if self.behind is None else self.behind
        ahead = less(torque, behind)
        self.behind = add(behind, scaled(1.0 - math.exp(-dt / self.lead_tau), ahead))
        return add(torque, scaled(max(self.rotor_tau / self.lead_tau - 1.0, 0.0), ahead))

    # ---- the vehicle's units

    def _weigh(self, state: State, thrust: float, since: float) -> None:
        """Newtons of full thrust, from what holds the vehicle up while the autopilot flies it; ``since``: the s since
        the last look, 0: there was none.
        """
        down, lift = float(state.vel[2]), max(thrust, 0.0) * down_axis(state.q.tolist())[2]
        if since <= 0.0:
            self._lift, self._fall = lift, down
        share = 1.0 - math.exp(-since / SETTLE_S)
        self._lift += (lift - self._lift) * share
        self._fall += (down - self._fall) * share
        # How far the speed is from its mean is its derivative, as slow as the mean of the thrust is.
        weight = self.mass * (GRAVITY - (down - self._fall) / SETTLE_S)
        full = weight / self._lift if self._lift > LEAST_LIFT else self.thrust_full
        self.full = min(max(full, SCALE[0] * self.thrust_full), SCALE[1] * self.thrust_full)

    def _normalised(self, torque: Vec, thrust: float) -> TorqueThrust:
        scale = self.thrust_full / self.full
        shares = (
            torque[0] * scale / self.torque_roll,
            torque[1] * scale / self.torque_pitch,
            torque[2] * scale / self.torque_yaw,
        )
        return TorqueThrust(np.array([min(max(each, -1.0), 1.0) for each in shares]), thrust * self.mass / self.full)

    # ---- gains

    def _outer_gains(self) -> Outer:
        full = self.full / self.mass
        return Outer(
            kp=(self.kp_xy, self.kp_xy, self.kp_z),
            kd=(self.kd_xy, self.kd_xy, self.kd_z),
            ki=(self.ki_xy, self.ki_xy, self.ki_z),
            speed_max=self.speed_max,
            integral_max=self.integral_max,
            lean_max=math.radians(self.lean_max),
            least=self.thrust_low * full,
            most=self.thrust_high * full,
            rotor_tau=self.rotor_tau,
            ease=self.ease,
        )

    def _inner_gains(self) -> Inner:
        inertia = (self.inertia_x, self.inertia_y, self.inertia_z)
        share = TURN_SHARE * self.full / self.thrust_full
        turn_max = (
            share * self.torque_roll / self.inertia_x,
            share * self.torque_pitch / self.inertia_y,
            share * self.torque_yaw / self.inertia_z,
        )
        return Inner(
            gamma1=(self.gamma1_tilt, self.gamma1_tilt, self.gamma1_yaw),
            gamma2=(self.gamma2_tilt, self.gamma2_tilt, self.gamma2_yaw),
            gamma_bar=(self.filter_tilt, self.filter_tilt, self.filter_yaw),
            inertia=inertia,
            rate_max=(self.rate_max, self.rate_max, self.rate_max_yaw),
            turn_max=turn_max,
        )

    def _tell(self, error: Vec, slip: Vec, wanted: Vec, slopes: Vec, torque: Vec, aim: Aim) -> None:
        loop = self.inner
        rows = {
            "pos_error": error,
            "vel_error": slip,
            "integral": self.outer.integral,
            "angle_ref": wanted,
            "angle_slope": slopes,
            "z1": loop.z1,
            "z1_bar": loop.z1_bar,
            "z2": loop.z2,
            "omega_d": loop.omega_d,
            "omega_ref": loop.omega_ref,
            "epsilon": loop.epsilon,
            "torque_nm": torque,
        }
        told = self.signals
        for name, (x, y, z) in rows.items():
            told[f"{name}.x"], told[f"{name}.y"], told[f"{name}.z"] = x, y, z
        told["thrust_n"] = aim.thrust * self.mass
        told["lyapunov"] = loop.lyapunov
