"""What a controller is given and what it gives: the vehicle's state, the reference, and one output a level.

SI units and radians; positions and velocities NED, positions about the fleet's origin; body axes forward, right, down;
quaternions w, x, y, z from body to NED.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from zmav import rotation

Array = npt.NDArray[np.float64]
Level = Literal["position", "velocity", "altitude", "attitude", "rates"]
LEVELS: tuple[Level, ...] = ("position", "velocity", "altitude", "attitude", "rates")
"""from the outermost to the innermost"""
MOTORS = 8
"""whose saturation is told, at most"""


def plain(vector: Array) -> tuple[float, float, float]:
    """Three numbers as the wire has them."""
    x, y, z = vector.tolist()
    return x, y, z


def _zeros() -> Array:
    return np.zeros(3)


def _level() -> Array:
    return np.array([1.0, 0.0, 0.0, 0.0])


@dataclass
class State:
    """The vehicle by its autopilot's own estimator, at one cycle."""

    t: float = 0.0
    """UTC s at which the attitude was so, by the autopilot's clock"""
    dt: float = 0.004
    """s since the cycle before, by the autopilot's clock; 0.1 at most"""
    pos: Array = field(default_factory=_zeros)
    """(3,) m"""
    vel: Array = field(default_factory=_zeros)
    """(3,) m/s"""
    q: Array = field(default_factory=_level)
    """(4,)"""
    rates: Array = field(default_factory=_zeros)
    """(3,) rad/s about the body's axes"""
    motors: Array | None = None
    """(M,) what each motor is given now, 0 to 1; None: the autopilot does not say"""
    sticks: Array = field(default_factory=lambda: np.array([0.0, 0.0, math.nan, 0.0]))
    """(4,) the pilot's: roll (right), pitch (nose up), throttle (0 to 1; nan: his radio is not heard), yaw (clockwise);
    the others from -1 to 1"""

    @property
    def rotation(self) -> Array:
        """(3, 3) that turns body axes into NED."""
        q = self.q.tolist()
        # Its rows are what the world's axes are in the body's.
        return np.array([rotation.to_body(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])

    @property
    def euler(self) -> Array:
        """(3,) roll, pitch and yaw."""
        return np.array(rotation.euler(self.q.tolist()))

    @property
    def yaw(self) -> float:
        return rotation.heading(self.q.tolist())

    @property
    def saturated(self) -> bool | None:
        """Some motor is at the end of its range; None: not known."""
        return None if self.motors is None else bool((self.motors <= 0.01).any() or (self.motors >= 0.99).any())


@dataclass
class Reference:
    """What is to be followed. Given from ``level`` on inwards: of a reference of positions all parts hold, of one of
    attitudes only ``attitude``, ``yaw_rate`` and ``thrust``. The loops above a controller fill what it needs.
    """

    level: Level = "position"
    pos: Array = field(default_factory=_zeros)
    vel: Array = field(default_factory=_zeros)
    """beside a position: fed forward"""
    acc: Array = field(default_factory=_zeros)
    """m/s², fed forward"""
    yaw: float = 0.0
    yaw_rate: float = 0.0
    """fed forward"""
    attitude: Array = field(default_factory=_level)
    rates: Array = field(default_factory=_zeros)
    thrust: float = 0.0
    """0 to 1, of all motors together along the body's up axis"""


@dataclass
class Trim:
    """What the autopilot does by itself just before a controller takes over: where integrators begin."""

    thrust: float = 0.5
    """0 to 1"""
    attitude: Array = field(default_factory=_level)
    """that it asks for"""
    rates: Array = field(default_factory=_zeros)
    """that it asks for"""


@dataclass
class Velocity:
    """For the autopilot's velocity loop (m/s, NED)."""

    vel: Array
    yaw: float | None = None
    yaw_rate: float | None = None


@dataclass
class Acceleration:
    """For the autopilot's acceleration to attitude and thrust (m/s², NED, gravity not included)."""

    acc: Array
    yaw: float | None = None
    yaw_rate: float | None = None


@dataclass
class AttitudeThrust:
    """For the autopilot's attitude loop."""

    attitude: Array
    thrust: float
    yaw_rate: float = 0.0
    """fed forward, for the loops of our own: no autopilot takes it beside an attitude"""


@dataclass
class RatesThrust:
    """For the autopilot's rate loop (rad/s)."""

    rates: Array
    thrust: float


@dataclass
class TorqueThrust:
    """For the autopilot's mixer: torques from -1 to 1 as it normalises them, thrust from 0 to 1."""

    torque: Array
    thrust: float


Output = Velocity | Acceleration | AttitudeThrust | RatesThrust | TorqueThrust
OUTPUTS: dict[str, type[Output]] = {
    "velocity": Velocity,
    "acceleration": Acceleration,
    "attitude": AttitudeThrust,
    "rates": RatesThrust,
    "torque": TorqueThrust,
}
"""by the level of authority that a setpoint of it has"""
USUAL: dict[Level, str] = {
    "position": "velocity",
    "velocity": "acceleration",
    "altitude": "attitude",
    "attitude": "rates",
    "rates": "torque",
}
"""what a class gives that says nothing: the level below stays with the autopilot"""
