"""Ways with rounded corners, as points a small step apart. ENU metres."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from shapely import LineString

from agents.planner.model.problem import Floats, Path

STRAIGHT = 1e-3
"""rad: less is no corner"""

TIGHT = 0.05
"""m by which a corner is passed where there is no room"""
LEG_SHARE = 0.48
"""of a leg that the arc at one of its ends may take"""


def without_repeats(path: Path) -> Path:
    """The path without points that are those before them."""
    keep = np.ones(len(path), dtype=bool)
    keep[1:] = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-6
    return path[keep]


def rounded(path: Path, radius: float, step: float, cut: float = math.inf, area: Any = None) -> Path:
    """(M, 3): each corner an arc of ``radius`` metres, or of what its legs allow, which passes it at ``cut`` m at most.

    Points are at most ``step`` metres apart. An arc that would leave ``area`` (shapely, over the ground) is made small.
    """
    corners = without_repeats(path)
    if len(corners) < 2:
        return corners
    pieces = [corners[:1]]
    for before, at, after in zip(corners, corners[1:], corners[2:], strict=False):
        arc = _arc(before, at, after, radius, cut, step)
        if area is not None and len(arc) > 1 and not area.covers(LineString(arc[:, :2])):
            arc = _arc(before, at, after, radius, TIGHT, step)
        pieces.append(arc)
    return dense(np.concatenate([*pieces, corners[-1:]]), step)


def _arc(before: Floats, at: Floats, after: Floats, radius: float, cut: float, step: float) -> Path:
    """(K, 3) points of the arc that takes the corner's place, from tangent to tangent; the corner where it is none."""
    inward, outward = before - at, after - at
    lengths = np.linalg.norm(inward), np.linalg.norm(outward)
    u, v = inward / lengths[0], outward / lengths[1]
    angle = math.acos(float(np.clip(u @ v, -1.0, 1.0)))
    turn = math.pi - angle
    if turn < STRAIGHT or angle < STRAIGHT:
        return at[None]
    size = min(radius, cut / (1.0 / math.cos(turn / 2.0) - 1.0))
    reach = min(size * math.tan(turn / 2.0), LEG_SHARE * float(min(lengths)))
    size = reach / math.tan(turn / 2.0)
    if size < 1e-6:
        return at[None]
    bisector = (u + v) / np.linalg.norm(u + v)
    middle = at + bisector * math.hypot(size, reach)
    first, last = at + u * reach - middle, at + v * reach - middle
    parts = max(2, math.ceil(size * turn / step), math.ceil(turn / 0.1))
    angles = np.linspace(0.0, turn, parts + 1)[:, None]
    points: Path = middle + (np.sin(turn - angles) * first + np.sin(angles) * last) / math.sin(turn)
    return points


def lengths_of(path: Path) -> Floats:
    """(M,) metres from the path's beginning to each of its points."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))


def at_length(path: Path, where: Floats) -> Path:
    """(K, 3): the points so many metres from the beginning."""
    gone = lengths_of(path)
    return np.column_stack([np.interp(where, gone, path[:, axis]) for axis in range(3)])


def dense(path: Path, step: float) -> Path:
    """The same way with points evenly spread, at most ``step`` metres apart."""
    whole = float(lengths_of(path)[-1])
    if whole <= 0.0:
        return path[:1]
    return at_length(path, np.linspace(0.0, whole, max(2, math.ceil(whole / step) + 1)))
