"""EV1: PX4's cascade flown from the companion, whole or one loop of it at a time, in the order in which it is built up.

Coombes et al., "High-Level Modular Autopilot Solution for Fast Prototyping of UAS", validation EV1. What each step does
not replace stays with the autopilot; see :mod:`agents.controllers.loops` for the loops themselves.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agents.controllers.controller import parameter
from agents.controllers.loops import AltitudeLoop, AttitudeLoop, PositionLoop, RatesLoop, VelocityLoop
from agents.controllers.types import Reference, State, Trim, Velocity


class Ev1(RatesLoop):
    """All loops are ours, from the position to the torque; the autopilot only mixes."""


Ev1Rates = Ev1
"""by the name of the level that it takes over, as the others have it"""


class Ev1Attitude(AttitudeLoop):
    """The attitude's loop is ours, and the loops above it; rates and mixer stay with the autopilot."""


class Ev1Altitude(AltitudeLoop):
    """Height and climb are ours, and the loops above; attitude, rates and mixer stay with the autopilot."""


class Ev1Velocity(VelocityLoop):
    """The velocity's loop is ours, and the position's; attitude, rates and mixer stay with the autopilot."""


class Ev1Position(PositionLoop):
    """The position's loop is ours; from the velocity on all stays with the autopilot.

    A velocity setpoint carries no acceleration, so the reference's is put in as the velocity that makes the PI below
    ask for it: a / (kp + ki / s).
    """

    below_kp = parameter(1.8, 0.1, 6.0, "1/s", "of the autopilot's velocity loop, over the ground (MPC_XY_VEL_P_ACC)")
    below_ki = parameter(0.4, 0.0, 4.0, "1/s²", "of the same (MPC_XY_VEL_I_ACC)")
    below_kp_z = parameter(4.0, 0.1, 12.0, "1/s", "of the same, of the climb (MPC_Z_VEL_P_ACC)")
    below_ki_z = parameter(2.0, 0.0, 6.0, "1/s²", "of the same, of the climb (MPC_Z_VEL_I_ACC)")

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self._lasting = np.zeros(3)  # the part of the acceleration that the integrator below has taken over

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        self._lasting = np.zeros(3)

    def update(self, state: State, reference: Reference) -> Velocity:
        output = super().update(state, reference)
        kp = np.array((self.below_kp, self.below_kp, self.below_kp_z))
        ki = np.array((self.below_ki, self.below_ki, self.below_ki_z))
        self._lasting += (reference.acc - self._lasting) * (ki * state.dt / (kp + ki * state.dt))
        output.vel += (reference.acc - self._lasting) / kp
        return output
