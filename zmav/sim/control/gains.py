"""Gains of the loops, one column per vehicle, so that the parameters of each tune its own controllers."""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array


class Gains:
    """(3, N) rows for north, east and down, or roll, pitch and yaw; (N,) where a number is of the whole vehicle.

    ``pos_p`` 1/s; ``vel_p`` 1/s, ``vel_i`` 1/s^2, ``vel_d``; ``angle_p`` 1/s; ``rate_max`` rad/s. What the rate loop's
    gains give is the cascade's own: an angular acceleration in rad/s^2, or a torque as a share of the highest.
    """

    def __init__(self, n: int, **rows: tuple[float, float, float]) -> None:
        def row(name: str) -> Array:
            return np.repeat(np.array(rows.get(name, (0.0, 0.0, 0.0)))[:, None], n, axis=1)

        self.pos_p = row("pos_p")
        self.vel_p, self.vel_i, self.vel_d = row("vel_p"), row("vel_i"), row("vel_d")
        self.angle_p = row("angle_p")
        self.rate_max = row("rate_max")
        self.rate_p, self.rate_i, self.rate_d, self.rate_ff = (
            row("rate_p"),
            row("rate_i"),
            row("rate_d"),
            row("rate_ff"),
        )
        self.rate_k = np.ones((3, n))
        self.rate_i_max = row("rate_i_max")
        self.yaw_weight = np.full(n, 1.0)
        self.hover = np.full(n, 0.5)  # share of the full thrust that is taken to carry the weight
        self.thrust_min, self.thrust_max = np.full(n, 0.0), np.full(n, 1.0)
        self.xy_margin = np.full(n, 0.3)  # of thrust, kept for moving over the ground where the height wants all
        self.curve = np.zeros(n)  # of the rotors, as the controller takes them: 0 linear, 1 quadratic
        self.changes = 0
        """counts up, so that who keeps products of gains sees that they are stale"""

    def tune(self, index: int, name: str, axes: tuple[int, ...], value: float) -> None:
        """Set one vehicle's gain ``name`` on some rows (() for a number of the whole vehicle)."""
        table: Array = getattr(self, name)
        if axes:
            table[list(axes), index] = value
        else:
            table[index] = value
        self.changes += 1


def arducopter_gains(n: int) -> Gains:
    """What flies as the simulated ArduCopter was measured to; its parameters' defaults scale to these."""
    return Gains(
        n,
        pos_p=(1.0, 1.0, 1.0),  # PSC_POSXY_P, PSC_POSZ_P
        vel_p=(2.0, 2.0, 5.0),  # PSC_VELXY_P, PSC_VELZ_P
        vel_i=(1.0, 1.0, 1.0),  # PSC_VELXY_I, PSC_ACCZ_I
        angle_p=(6.0, 6.0, 3.0),
        rate_max=(3.8, 3.8, 1.6),
        rate_p=(18.0, 18.0, 7.0),
        rate_i=(8.0, 8.0, 1.0),
        rate_i_max=(4.0, 4.0, 4.0),
    )


def px4_gains(n: int) -> Gains:
    """PX4's defaults (https://docs.px4.io/v1.16/en/advanced_config/parameter_reference.html, MPC_ and MC_)."""
    gains = Gains(
        n,
        pos_p=(0.95, 0.95, 1.0),  # MPC_XY_P, MPC_Z_P
        vel_p=(1.8, 1.8, 4.0),  # MPC_XY_VEL_P_ACC, MPC_Z_VEL_P_ACC
        vel_i=(0.4, 0.4, 2.0),
        vel_d=(0.2, 0.2, 0.0),
        angle_p=(6.5, 6.5, 2.8),  # MC_ROLL_P, MC_PITCH_P, MC_YAW_P
        rate_max=(3.84, 3.84, 3.49),  # MC_ROLLRATE_MAX and its like
        rate_p=(0.15, 0.15, 0.2),  # MC_ROLLRATE_P and its like
        rate_i=(0.2, 0.2, 0.1),
        rate_d=(0.003, 0.003, 0.0),
        rate_i_max=(0.3, 0.3, 0.3),  # MC_RR_INT_LIM and its like
    )
    gains.yaw_weight[:] = 0.4  # MC_YAW_WEIGHT
    gains.thrust_min[:] = 0.12  # MPC_THR_MIN
    return gains
