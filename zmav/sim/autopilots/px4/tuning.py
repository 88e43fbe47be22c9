"""PX4's controller parameters, and which gain of the simulated loops each one is.

https://docs.px4.io/v1.16/en/advanced_config/parameter_reference.html (MPC_, MC_, THR_MDL_FAC, CA_)
"""

from __future__ import annotations

import math

from zmav.sim.control.setpoints import SetpointHandle
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.protocol.params import ParamStore

_DEG = math.pi / 180.0
_XY, _Z = (0, 1), (2,)
_AXES = {"ROLL": (0,), "PITCH": (1,), "YAW": (2,)}
_RATE = {"P": "rate_p", "I": "rate_i", "D": "rate_d", "FF": "rate_ff", "K": "rate_k"}
GENERIC_HEXA_X = 6001  # SYS_AUTOSTART
_FLOAT, _INT = 9, 6  # MAV_PARAM_TYPE

# Parameter -> (gain, its rows, factor to SI).
GAINS: dict[str, tuple[str, tuple[int, ...], float]] = {
    "MPC_XY_P": ("pos_p", _XY, 1.0),
    "MPC_Z_P": ("pos_p", _Z, 1.0),
    "MPC_XY_VEL_P_ACC": ("vel_p", _XY, 1.0),
    "MPC_XY_VEL_I_ACC": ("vel_i", _XY, 1.0),
    "MPC_XY_VEL_D_ACC": ("vel_d", _XY, 1.0),
    "MPC_Z_VEL_P_ACC": ("vel_p", _Z, 1.0),
    "MPC_Z_VEL_I_ACC": ("vel_i", _Z, 1.0),
    "MPC_Z_VEL_D_ACC": ("vel_d", _Z, 1.0),
    "MPC_THR_MIN": ("thrust_min", (), 1.0),
    "MPC_THR_MAX": ("thrust_max", (), 1.0),
    "MPC_THR_XY_MARG": ("xy_margin", (), 1.0),
    "THR_MDL_FAC": ("curve", (), 1.0),
    "MC_YAW_WEIGHT": ("yaw_weight", (), 1.0),
    "MC_RR_INT_LIM": ("rate_i_max", (0,), 1.0),
    "MC_PR_INT_LIM": ("rate_i_max", (1,), 1.0),
    "MC_YR_INT_LIM": ("rate_i_max", (2,), 1.0),
    **{f"MC_{axis}_P": ("angle_p", rows, 1.0) for axis, rows in _AXES.items()},
    **{f"MC_{axis}RATE_MAX": ("rate_max", rows, _DEG) for axis, rows in _AXES.items()},
    **{f"MC_{axis}RATE_{letter}": (gain, rows, 1.0) for axis, rows in _AXES.items() for letter, gain in _RATE.items()},
}
HOVER = ("MPC_USE_HTE", "MPC_THR_HOVER")


class Tuning:
    """Keeps one vehicle's gains true to its parameters."""

    def __init__(self, params: ParamStore, setpoint: SetpointHandle, airframe: Airframe) -> None:
        self._params = params
        self._sp = setpoint
        self._airframe = airframe
        params.watch(lambda name, value: self.apply(name))
        for name in (*GAINS, HOVER[0]):
            self.apply(name)

    def apply(self, name: str) -> None:
        """A parameter may have changed."""
        if name in GAINS and name in self._params:
            gain, axes, factor = GAINS[name]
            self._sp.tune(gain, axes, self._params[name] * factor)
        elif name in HOVER:
            self._sp.tune("hover", (), self._hover())

    def _hover(self) -> float:
        """What the thrust estimator finds while it flies (MPC_USE_HTE), or what the parameter says."""
        frame = self._airframe
        if self._params["MPC_USE_HTE"]:
            return frame.hover_share
        return min(max(self._params["MPC_THR_HOVER"], 0.1), 0.8)


def rows_for(airframe: Airframe) -> tuple[tuple[str, float, int], ...]:
    """(name, value, MAV_PARAM_TYPE) of the parameters that differ on an airframe from those of PX4's own simulation
    (whose quadrotor needs none), those of further rotors included: as its configuration would set them.
    """
    if airframe.name != "hexa":
        return ()
    rows: list[tuple[str, float, int]] = [
        ("SYS_AUTOSTART", GENERIC_HEXA_X, _INT),
        ("MAV_TYPE", 13, _INT),
        ("CA_FAILURE_MODE", 1, _INT),
        ("CA_ROTOR_COUNT", len(airframe.rotors), _INT),
        ("THR_MDL_FAC", airframe.thrust_expo, _FLOAT),
        ("MPC_THR_HOVER", round(airframe.hover_share, 2), _FLOAT),
    ]
    for i, rotor in enumerate(airframe.rotors):
        rows += [
            (f"CA_ROTOR{i}_PX", round(rotor.forward_m, 4), _FLOAT),
            (f"CA_ROTOR{i}_PY", round(rotor.right_m, 4), _FLOAT),
            (f"CA_ROTOR{i}_KM", 0.05 * rotor.spin, _FLOAT),
            (f"PWM_MAIN_FUNC{i + 1}", 101 + i, _INT),
        ]
    return tuple(rows)
