"""The verifier's own geometry: straight pieces against boxes, cylinders, prisms and the fence.

Nothing here is shared with the geometry that the search uses. The distance from a point on a straight line to a convex
body is a convex function of the place on the line, so that its least value is found by sections to the last digit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Motion
from agents.planner.model.scene import Box, Cylinder, Scene
from agents.planner.solve.jit import jit

GOLDEN = 0.6180339887498949
CHUNK = 16
"""pieces that share one box in the rough comparison"""


class Solids(NamedTuple):
    """What a centre keeps its radius from: rows of a box, a cylinder or a prism, and the corners of all prisms."""

    rows: Floats
    """(O, 8): kind (0 box, 1 cylinder, 2 prism), floor, ceiling, then x0, y0, x1, y1 | x, y, radius, - | first corner,
    count, -, -; the last column is unused"""
    boxes: Floats
    """(O, 6): low and high corner of each"""
    corners: Floats
    """(V, 2)"""


def solids_of(scene: Scene) -> Solids:
    """The scene's obstacles, in its order."""
    rows, boxes = [], []
    corners: list[tuple[float, float]] = []
    for each in scene.obstacles:
        if isinstance(each, Box):
            rows.append([0.0, each.min[2], each.max[2], *each.min[:2], *each.max[:2], 0.0])
            boxes.append([*each.min, *each.max])
        elif isinstance(each, Cylinder):
            (x, y), r = each.center, each.radius
            rows.append([1.0, each.floor, each.ceiling, x, y, r, 0.0, 0.0])
            boxes.append([x - r, y - r, each.floor, x + r, y + r, each.ceiling])
        else:
            rows.append([2.0, each.floor, each.ceiling, float(len(corners)), float(len(each.polygon)), 0.0, 0.0, 0.0])
            xs, ys = [x for x, _ in each.polygon], [y for _, y in each.polygon]
            boxes.append([min(xs), min(ys), each.floor, max(xs), max(ys), each.ceiling])
            corners.extend(each.polygon)
    return Solids(
        np.array(rows, dtype=np.float64).reshape(-1, 8),
        np.array(boxes, dtype=np.float64).reshape(-1, 6),
        np.array(corners, dtype=np.float64).reshape(-1, 2),
    )


@jit
def in_polygon(corners: Floats, x: float, y: float) -> bool:
    """Whether a point is inside a polygon, its rim left open (even-odd rule)."""
    inside, n = False, corners.shape[0]
    for k in range(n):
        ax, ay = corners[k]
        bx, by = corners[k - 1]
        if (ay > y) != (by > y) and x < ax + (y - ay) * (bx - ax) / (by - ay):
            inside = not inside
    return inside


@jit
def to_side(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    """The distance of a point from the straight line between two others."""
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    u = 0.0
    if square > 0.0:
        u = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / square))
    return float(np.hypot(x - ax - u * ex, y - ay - u * ey))


@jit
def _reach(kind: int, a: float, b: float, c: float, d: float, low: float, high: float, p: Floats, u: float) -> float:
    """The distance from a convex solid of the place at the share ``u`` of the piece ``p`` (6,).

    ``kind``: 0 box, 1 cylinder, 2 the upright wall between (a, b) and (c, d).
    """
    x, y, z = p[0] + u * (p[3] - p[0]), p[1] + u * (p[4] - p[1]), p[2] + u * (p[5] - p[2])
    if kind == 0:
        flat = np.hypot(max(0.0, a - x, x - c), max(0.0, b - y, y - d))
    elif kind == 1:
        flat = max(0.0, np.hypot(x - a, y - b) - c)
    else:
        flat = to_side(a, b, c, d, x, y)
    return float(np.hypot(flat, max(0.0, low - z, z - high)))


@jit
def _least(
    kind: int, a: float, b: float, c: float, d: float, low: float, high: float, p: Floats
) -> tuple[float, float]:
    """The least distance of a piece from a convex solid, and the share of the piece where it is."""
    left, right = 0.0, 1.0
    u, v = 1.0 - GOLDEN, GOLDEN
    at_u, at_v = _reach(kind, a, b, c, d, low, high, p, u), _reach(kind, a, b, c, d, low, high, p, v)
    length = np.hypot(np.hypot(p[3] - p[0], p[4] - p[1]), p[5] - p[2])
    for _ in range(80):
        if (right - left) * length <= 1e-7:
            break
        if at_u <= at_v:
            right, v, at_v = v, u, at_u
            u = right - GOLDEN * (right - left)
            at_u = _reach(kind, a, b, c, d, low, high, p, u)
        else:
            left, u, at_u = u, v, at_v
            v = left + GOLDEN * (right - left)
            at_v = _reach(kind, a, b, c, d, low, high, p, v)
    best, where = (at_u, u) if at_u <= at_v else (at_v, v)
    for share in (0.0, 1.0):
        value = _reach(kind, a, b, c, d, low, high, p, share)
        if value < best:
            best, where = value, share
    return best, where


@jit
def from_solid(row: Floats, corners: Floats, p: Floats) -> tuple[float, float]:
    """The least distance of the straight piece ``p`` (6,: both ends) from one solid, and the share where it is."""
    kind, low, high = int(row[0]), row[1], row[2]
    if kind != 2:
        return _least(kind, row[3], row[4], row[5], row[6], low, high, p)
    polygon = corners[int(row[3]) : int(row[3]) + int(row[4])]
    best, where = np.inf, 0.0
    for k in range(polygon.shape[0]):
        value, share = _least(2, polygon[k - 1, 0], polygon[k - 1, 1], polygon[k, 0], polygon[k, 1], low, high, p)
        if value < best:
            best, where = value, share
    # Over or under the polygon, or in it: there the height alone counts, which is extreme at the ends and zero between
    # floor and ceiling.
    rise = p[5] - p[2]
    for k in range(4):
        share = float(k)
        if k >= 2:
            if rise == 0.0:
                break
            share = ((low if k == 2 else high) - p[2]) / rise
        if not 0.0 <= share <= 1.0:
            continue
        if in_polygon(polygon, p[0] + share * (p[3] - p[0]), p[1] + share * (p[4] - p[1])):
            z = p[2] + share * rise
            value = max(0.0, low - z, z - high)
            if value < best:
                best, where = value, share
    return best, where


@jit
def _apart(box: Floats, low: Floats, high: Floats) -> float:
    """The distance of two boxes."""
    dx = max(0.0, box[0] - high[0], low[0] - box[3])
    dy = max(0.0, box[1] - high[1], low[1] - box[4])
    dz = max(0.0, box[2] - high[2], low[2] - box[5])
    return float(np.sqrt(dx * dx + dy * dy + dz * dz))


@jit
def from_solids(motion: Motion, rows: Floats, boxes: Floats, corners: Floats, enough: float) -> tuple[float, int, int]:
    """The least distance of a motion from the nearest solid, if it is below ``enough``: distance, solid, piece.

    -1 for both where nothing is so near. A motion of one sample is one piece.
    """
    best, which, piece = enough, -1, -1
    p, low, high = np.empty(6), np.empty(3), np.empty(3)
    last = max(1, motion.shape[0] - 1)
    for first in range(0, last, CHUNK):
        stop = min(first + CHUNK, motion.shape[0] - 1)
        for axis in range(3):
            low[axis] = motion[first : stop + 1, 1 + axis].min()
            high[axis] = motion[first : stop + 1, 1 + axis].max()
        for k in range(rows.shape[0]):
            if _apart(boxes[k], low, high) >= best:
                continue
            for i in range(first, max(stop, first + 1)):
                j = min(i + 1, motion.shape[0] - 1)
                p[:3], p[3:] = motion[i, 1:], motion[j, 1:]
                if _apart(boxes[k], np.minimum(p[:3], p[3:]), np.maximum(p[:3], p[3:])) >= best:
                    continue
                value, _ = from_solid(rows[k], corners, p)
                if value < best:
                    best, which, piece = value, k, i
    return best, which, piece


@jit
def _beyond(corners: Floats, x: float, y: float) -> float:
    """How far a point is outside of a polygon; 0 inside."""
    if in_polygon(corners, x, y):
        return 0.0
    best = np.inf
    for k in range(corners.shape[0]):
        best = min(best, to_side(corners[k - 1, 0], corners[k - 1, 1], corners[k, 0], corners[k, 1], x, y))
    return float(best)


@jit
def out_of_fence(motion: Motion, corners: Floats) -> tuple[float, int]:
    """How far a motion gets out of a polygon at most (0: never), and in which piece.

    The polygon need not be convex: what lies between two samples inside may be outside. Such a stretch is looked at
    in steps of 2 mm (a piece in 20 000 at most), and what could be missed between them is added.
    """
    worst, piece = 0.0, -1
    for i in range(max(1, motion.shape[0] - 1)):
        j = min(i + 1, motion.shape[0] - 1)
        ax, ay, bx, by = motion[i, 1], motion[i, 2], motion[j, 1], motion[j, 2]
        # A side that the piece may cross, or an end outside: only then can anything of it be outside.
        near = not in_polygon(corners, ax, ay) or not in_polygon(corners, bx, by)
        for k in range(corners.shape[0]):
            if near:
                break
            px, py, qx, qy = corners[k - 1, 0], corners[k - 1, 1], corners[k, 0], corners[k, 1]
            one = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
            other = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
            three = (qx - px) * (ay - py) - (qy - py) * (ax - px)
            four = (qx - px) * (by - py) - (qy - py) * (bx - px)
            near = one * other <= 0.0 and three * four <= 0.0
        if not near:
            continue
        length = np.hypot(bx - ax, by - ay)
        steps = int(max(1.0, min(20000.0, np.ceil(length / 0.002))))
        for step in range(steps + 1):
            u = step / steps
            depth = _beyond(corners, ax + u * (bx - ax), ay + u * (by - ay))
            if depth > 0.0 and 0 < step < steps:
                depth += 0.5 * length / steps
            if depth > worst:
                worst, piece = depth, i
    return worst, piece


@jit
def limits(motion: Motion, rests: bool) -> Floats:
    """(6, 2): the greatest speed, climb, descent, acceleration and pause between samples on the way, the least speed;
    each with the index of its piece.

    Velocities are those of the pieces; an acceleration is the difference of two neighbours' over the time between
    their middles, of which a piece counts 0.1 s at most for its half: a change cannot hide in a long rest. ``rests``:
    the motion comes from rest and ends at rest.
    """
    out = np.zeros((6, 2))
    out[5, 0] = np.inf
    n = motion.shape[0] - 1
    ux = uy = uz = before = 0.0
    for i in range(n + 1 if n > 0 else 0):
        vx = vy = vz = half = 0.0
        if i < n:
            dt = motion[i + 1, 0] - motion[i, 0]
            half = min(0.5 * dt, 0.1)
            vx = (motion[i + 1, 1] - motion[i, 1]) / dt
            vy = (motion[i + 1, 2] - motion[i, 2]) / dt
            vz = (motion[i + 1, 3] - motion[i, 3]) / dt
            speed = np.sqrt(vx * vx + vy * vy + vz * vz)
            pause = dt if speed * dt > 1e-4 else 0.0
            for k, value in enumerate((speed, vz, -vz, 0.0, pause)):
                if value > out[k, 0]:
                    out[k, 0], out[k, 1] = value, i
            if speed < out[5, 0]:
                out[5, 0], out[5, 1] = speed, i
        if 0 < i < n or rests:
            change = np.sqrt((vx - ux) ** 2 + (vy - uy) ** 2 + (vz - uz) ** 2) / (half + before)
            if change > out[3, 0]:
                out[3, 0], out[3, 1] = change, min(i, n - 1)
        ux, uy, uz, before = vx, vy, vz, half
    return out
