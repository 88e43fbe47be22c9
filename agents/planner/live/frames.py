"""Between the frame of the wire (NED about the fleet's origin) and that of the solver (ENU): x east, y north, z up."""

from __future__ import annotations

import math

from agents.planner.model.problem import Floats
from zmav.wire import Vector


def enu(ned: Vector) -> Vector:
    """m (or m/s) north, east, down -> east, north, up; its own inverse, but say which way you mean."""
    north, east, down = ned
    return (east, north, -down)


def ned(enu: Vector) -> Vector:
    """m (or m/s) east, north, up -> north, east, down."""
    east, north, up = enu
    return (north, east, -up)


def enu_array(ned: Floats) -> Floats:
    """(..., 3) NED -> (..., 3) ENU, a new array in C order; its own inverse, too."""
    out = ned[..., [1, 0, 2]].copy()
    out[..., 2] *= -1.0
    return out


def vector(place: Floats) -> Vector:
    """(3,) as three numbers."""
    x, y, z = map(float, place)
    return (x, y, z)


def course_of(heading: float) -> float:
    """rad clockwise from north -> rad counter-clockwise from east, in (-pi, pi]; and back: it is its own inverse."""
    return math.remainder(math.pi / 2.0 - heading, math.tau)
