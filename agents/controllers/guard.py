"""The envelope: what a controller may do to the vehicle before the autopilot has it back."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from agents.controllers.types import (
    Acceleration,
    AttitudeThrust,
    Output,
    RatesThrust,
    Reference,
    State,
    TorqueThrust,
    Velocity,
)

ERROR_LASTS = 0.3
"""s for which a reference may be missed by more than is allowed: a step is no fault"""
MOST: dict[type[Output], tuple[str, float]] = {
    Velocity: ("vel", 30.0),
    Acceleration: ("acc", 30.0),
    RatesThrust: ("rates", 20.0),
    TorqueThrust: ("torque", 1.0),
}
"""the vector of an output, and what is no sane part of it: m/s, m/s², rad/s, of the full torque"""


class Guard:
    """Looks at each cycle of one engagement. ``limits``: by the names of :mod:`agents.controllers.settings`."""

    def __init__(self, limits: Mapping[str, float]) -> None:
        self._limits = limits
        self._start = np.zeros(3)
        self._height = 0.0
        self._missed_since: float | None = None

    def begin(self, state: State, height: float) -> None:
        """``height``: m above home, now."""
        self._start, self._height = state.pos.copy(), height
        self._missed_since = None

    def check(self, state: State, reference: Reference) -> str | None:
        """Why the autopilot must have it back; None: it need not."""
        tilt, most_rate = (math.radians(self._limits[name]) for name in ("guard_tilt_deg", "guard_rate_dps"))
        w, x, y, z = (float(each) for each in state.q)
        down = 1.0 - 2.0 * (x * x + y * y)
        if not math.isfinite(w + z + down) or not np.isfinite(state.pos).all() or not np.isfinite(state.vel).all():
            return "the autopilot's estimate is not finite"
        if abs(w * w + x * x + y * y + z * z - 1.0) > 0.05:
            return f"the autopilot's attitude is no rotation: ({w:.3g}, {x:.3g}, {y:.3g}, {z:.3g})"
        if down < math.cos(tilt):
            return f"tilt {math.degrees(math.acos(max(down, -1.0))):.0f}° is beyond {math.degrees(tilt):.0f}°"
        rate = float(np.abs(state.rates).max())
        if not rate <= most_rate:
            return f"it turns at {math.degrees(rate):.0f}°/s, beyond {math.degrees(most_rate):.0f}°/s"
        return self._place(state) or self._following(state, reference)

    def _place(self, state: State) -> str | None:
        low, high, radius = (self._limits[f"guard_{name}"] for name in ("low", "high", "radius"))
        height = self._height - float(state.pos[2] - self._start[2])
        if not low <= height <= high:
            return f"{height:.1f} m above home is not within {low:g} to {high:g} m"
        away = math.hypot(*(state.pos[:2] - self._start[:2]))
        if away > radius:
            return f"{away:.0f} m from where it took over is beyond {radius:g} m"
        return None

    def _following(self, state: State, reference: Reference) -> str | None:
        if reference.level == "position":
            error, most, unit = math.dist(state.pos, reference.pos), self._limits["guard_error"], "m"
        elif reference.level == "attitude":
            turn = 2.0 * math.acos(min(abs(float(np.dot(state.q, reference.attitude))), 1.0))
            error, most, unit = math.degrees(turn), self._limits["guard_error_deg"], "°"
        else:
            return None
        if error <= most:
            self._missed_since = None
            return None
        if self._missed_since is None:
            self._missed_since = state.t
        if state.t - self._missed_since < ERROR_LASTS:
            return None
        return f"it is {error:.1f} {unit} off its reference for {ERROR_LASTS:g} s; at most {most:g} {unit} are allowed"


def fit(output: Output) -> tuple[str | None, bool]:
    """Why it cannot be flown at all (None: it can), and whether a thrust, a rate or a torque had to be brought into its
    range, which is done in place.
    """
    numbers = [part for value in vars(output).values() if value is not None for part in np.ravel(value)]
    if not all(math.isfinite(part) for part in numbers):
        return f"the controller's output is not finite: {output}", False
    clipped = False
    if isinstance(output, AttitudeThrust):
        length = float(np.linalg.norm(output.attitude))
        if abs(length - 1.0) > 0.01:
            return f"the controller's attitude is no rotation: a quaternion of length {length:.3g}", False
    else:
        name, most = MOST[type(output)]
        vector = getattr(output, name)
        clipped = bool(np.abs(vector).max() > most)
        if clipped and isinstance(output, Velocity | Acceleration):
            return f"the controller's output is no sane one: {output}", False
        np.clip(vector, -most, most, out=vector)
    if isinstance(output, AttitudeThrust | RatesThrust | TorqueThrust):
        thrust = min(max(float(output.thrust), 0.0), 1.0)
        clipped = clipped or thrust != output.thrust
        output.thrust = thrust
    return None, clipped
