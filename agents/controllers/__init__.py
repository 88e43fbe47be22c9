"""Controllers that take over a part of the autopilot's cascade, and what they are written with."""

from agents.controllers.controller import Controller, parameter
from agents.controllers.types import (
    Acceleration,
    Array,
    AttitudeThrust,
    Level,
    Output,
    RatesThrust,
    Reference,
    State,
    TorqueThrust,
    Trim,
    Velocity,
)

__all__ = [
    "Acceleration",
    "Array",
    "AttitudeThrust",
    "Controller",
    "Level",
    "Output",
    "RatesThrust",
    "Reference",
    "State",
    "TorqueThrust",
    "Trim",
    "Velocity",
    "parameter",
]
