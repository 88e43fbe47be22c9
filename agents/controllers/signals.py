"""The signals that every controller has, by the names under which they are streamed.

``is.*`` is what the autopilot's estimator says, ``ref.*`` what is asked for, ``out.*`` what goes to the autopilot.
x, y, z, vx, vy, vz are NED about the fleet's origin; roll, pitch, yaw radians; p, q, r rad/s about the body's axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.controllers.types import LEVELS, Array, Output, Reference, State


def cycle_signals(state: State, reference: Reference, output: Output) -> dict[str, float]:
    """The signals that every controller has: what is, what is asked for from outside, and what goes out."""
    values: dict[str, float] = {}
    _spread(values, "is.", ("x", "y", "z"), state.pos)
    _spread(values, "is.", ("vx", "vy", "vz"), state.vel)
    _spread(values, "is.", ("roll", "pitch", "yaw"), state.euler)
    _spread(values, "is.", ("p", "q", "r"), state.rates)
    if reference.level in ("position", "altitude"):
        _spread(values, "ref.", ("x", "y", "z"), reference.pos)
    if reference.level in ("position", "velocity"):
        _spread(values, "ref.", ("vx", "vy", "vz"), reference.vel)
        values["ref.yaw"] = reference.yaw
    for name, value in vars(output).items():
        if isinstance(value, np.ndarray):
            _spread(values, f"out.{name}.", "wxyz" if len(value) == 4 else "xyz", value)
        elif value is not None:
            values[f"out.{name}"] = float(value)
    if state.motors is not None:
        values["motors.low"], values["motors.high"] = float(state.motors.min()), float(state.motors.max())
    return values


def _spread(values: dict[str, float], start: str, ends: Any, vector: Array) -> None:
    for end, value in zip(ends, vector, strict=True):
        values[start + end] = float(value)


def inner_signals(reference: Reference) -> dict[str, float]:
    """Attitude and rates that the loops above a controller ask for, as far in as they reach."""
    values: dict[str, float] = {}
    reach = LEVELS.index(reference.level)
    if reach >= LEVELS.index("altitude"):
        _spread(values, "ref.", ("roll", "pitch", "yaw"), State(q=reference.attitude).euler)
    if reach >= LEVELS.index("rates"):
        _spread(values, "ref.", ("p", "q", "r"), reference.rates)
    return values
