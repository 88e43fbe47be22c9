"""Dubins ways to a place: the shortest for what turns no tighter than a radius, whatever the heading there.

A turn and a straight line, or two turns (X.-N. Bui and others, 1994, after L. E. Dubins, *On curves of minimal length
with a constraint on average curvature*, 1957).

A pose is x, y (m) and the heading (rad counter-clockwise from east). A way is legs, one a row: curvature (1/m, left is
positive, 0 is straight) and length (m).
"""

from __future__ import annotations

import math

import numpy as np

from agents.planner.model.problem import Floats
from agents.planner.solve.jit import jit

WORDS = 4
"""LS, RS, LR, RL"""
_TAU = 2.0 * math.pi


@jit
def advance(x: float, y: float, heading: float, curvature: float, length: float) -> tuple[float, float, float]:
    """The pose after a leg."""
    if abs(curvature) < 1e-9:
        return x + length * math.cos(heading), y + length * math.sin(heading), heading
    after = heading + curvature * length
    return (
        x + (math.sin(after) - math.sin(heading)) / curvature,
        y - (math.cos(after) - math.cos(heading)) / curvature,
        after,
    )


@jit
def _wrap(angle: float) -> float:
    """In [0, 2π); what rounding put just below a full turn is none."""
    angle = angle % _TAU
    return 0.0 if angle > _TAU - 1e-9 else angle


@jit
def to_point(x0: float, y0: float, h0: float, x1: float, y1: float, radius: float, word: int, legs: Floats) -> float:
    """Fill ``legs`` (2, 2) with the way of one of the four words to a place, whatever the heading there."""
    side = 1.0 if word in (0, 2) else -1.0
    # In a frame with the start at the origin, heading along x, the first turn to the left.
    dx, dy = x1 - x0, y1 - y0
    u = dx * math.cos(h0) + dy * math.sin(h0)
    v = side * (dy * math.cos(h0) - dx * math.sin(h0))
    if word < 2:
        square = u * u + (v - radius) ** 2 - radius * radius
        if square < -1e-9 * radius * radius:
            return np.inf  # within the circle
        straight = math.sqrt(max(square, 0.0))
        turn = _wrap(math.atan2(v - radius, u) + math.atan2(radius, straight))
        legs[0, 0], legs[0, 1] = side / radius, turn * radius
        legs[1, 0], legs[1, 1] = 0.0, straight
        return turn * radius + straight
    # The second circle touches the first and passes the place.
    far = math.hypot(u, v - radius)
    if far > 3.0 * radius or far < radius:
        return np.inf
    cosine = (5.0 * radius * radius - far * far) / (4.0 * radius * radius)
    apex = math.acos(min(max(cosine, -1.0), 1.0))  # at the second centre, between the first and the place
    sine = math.sin(apex) * radius / far
    lean = math.atan2(sine, (4.0 * radius * radius + far * far - radius * radius) / (4.0 * radius * far))
    turn = _wrap(math.atan2(v - radius, u) + lean + math.pi / 2.0)
    second = _TAU - apex
    legs[0, 0], legs[0, 1] = side / radius, turn * radius
    legs[1, 0], legs[1, 1] = -side / radius, second * radius
    return (turn + second) * radius
