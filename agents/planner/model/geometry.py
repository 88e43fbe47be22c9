"""Exact distances and tests of points and straight segments against the static world, for numba.

ENU metres. Each obstacle is a footprint raised from a floor to a ceiling, so that its distance is put together from
one over the ground and one in height. No-fly polygons and the fence may be any simple polygon, convex or not.
"""

from __future__ import annotations

import math

import numpy as np

from agents.planner.model.problem import Floats
from agents.planner.model.world import World, world_of
from agents.planner.solve.jit import jit

__all__ = ["World", "away", "outside", "segment_clear", "world_of"]

TOUCH = 1e-9
"""m by which a segment may come nearer than asked, or lie outside: what rounding adds"""
Around = tuple[float, float, float, float]

# Points.


@jit
def polygon_side(corners: Floats, first: int, count: int, x: float, y: float) -> tuple[float, float, float]:
    """Signed distance to a polygon's rim (negative inside) and the point of the rim that is nearest."""
    best, near_x, near_y, inside = np.inf, 0.0, 0.0, False
    ax, ay = corners[first + count - 1]
    for k in range(first, first + count):
        bx, by = corners[k]
        ex, ey = bx - ax, by - ay
        share = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, 1e-300)))
        cx, cy = ax + share * ex, ay + share * ey
        gap = (x - cx) ** 2 + (y - cy) ** 2
        if gap < best:
            best, near_x, near_y = gap, cx, cy
        if (ay > y) != (by > y) and x < ax + (y - ay) * ex / ey:
            inside = not inside
        ax, ay = bx, by
    distance = math.sqrt(best)
    return (-distance if inside else distance), near_x, near_y


@jit
def footprint(s: Floats, corners: Floats, x: float, y: float) -> tuple[float, float, float]:
    """Signed distance over the ground to the footprint of a row of ``solids``, and the unit vector away from it."""
    if s[6] == 0.0:
        ex = max(s[0] - x, x - s[3])
        ey = max(s[1] - y, y - s[4])
        to_x = -1.0 if s[0] - x > x - s[3] else 1.0
        to_y = -1.0 if s[1] - y > y - s[4] else 1.0
        if ex > 0.0 and ey > 0.0:
            side = math.sqrt(ex * ex + ey * ey)
            return side, to_x * ex / side, to_y * ey / side
        return (ex, to_x, 0.0) if ex > ey else (ey, 0.0, to_y)
    if s[6] == 1.0:
        dx, dy, size = x - (s[0] + s[3]) / 2.0, y - (s[1] + s[4]) / 2.0, (s[3] - s[0]) / 2.0
        far = math.sqrt(dx * dx + dy * dy)
        return (far - size, dx / far, dy / far) if far > 1e-12 else (-size, 1.0, 0.0)
    side, near_x, near_y = polygon_side(corners, int(s[7]), int(s[8]), x, y)
    if abs(side) < 1e-12:
        return side, 1.0, 0.0
    return side, (x - near_x) / side, (y - near_y) / side


@jit
def signed_distance(s: Floats, corners: Floats, ground: float, x: float, y: float, z: float) -> Around:
    """Signed distance to a row of ``solids`` (negative inside) and the unit vector by which it grows fastest.

    From inside, down is no way out of what starts at or below ``ground``: a house is left sideways or upwards.
    """
    side, ux, uy = footprint(s, corners, x, y)
    below, above = s[2] - z, z - s[5]
    height, uz = (below, -1.0) if below > above else (above, 1.0)
    if height <= 0.0:
        if below > above and s[2] <= ground:
            height, uz = above, 1.0
        if side > 0.0 or side >= height:
            return side, ux, uy, 0.0
        return height, 0.0, 0.0, uz
    if side <= 0.0:
        return height, 0.0, 0.0, uz
    far = math.sqrt(side * side + height * height)
    return far, ux * side / far, uy * side / far, uz * height / far


@jit
def column_of(bins: Floats, axis: int, at: float) -> int:
    """The column (axis 0) or row (1) of bins that a coordinate lies in; those on the rim reach to infinity."""
    return int(max(0.0, min(bins[4 + axis] - 1.0, (at - bins[axis]) * bins[2 + axis])))


@jit
def rim(b: Floats, fence: Floats, fence_z: Floats, x: float, y: float, z: float) -> Around:
    """How far a point is outside bounds or fence, whichever is more, and the unit vector back (0: inside)."""
    dx = max(b[0] - x, 0.0) - max(x - b[3], 0.0)
    dy = max(b[1] - y, 0.0) - max(y - b[4], 0.0)
    dz = max(b[2] - z, 0.0) - max(z - b[5], 0.0)
    most = math.sqrt(dx * dx + dy * dy + dz * dz)
    if len(fence) > 0:
        side, near_x, near_y = polygon_side(fence, 0, len(fence), x, y)
        fx, fy = (near_x - x, near_y - y) if side > 0.0 else (0.0, 0.0)
        fz = max(fence_z[0] - z, 0.0) - max(z - fence_z[1], 0.0)
        far = math.sqrt(fx * fx + fy * fy + fz * fz)
        if far > most:
            most, dx, dy, dz = far, fx, fy, fz
    if most <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return most, dx / most, dy / most, dz / most


@jit
def outside(world: World, x: float, y: float, z: float) -> float:
    """Metres by which a point is outside bounds or fence; 0 inside."""
    return rim(world.bounds, world.fence, world.fence_z, x, y, z)[0]


@jit
def away(world: World, x: float, y: float, z: float, radius: float, out: Floats) -> float:
    """How deep a point violates what it violates most, and in ``out`` (3,) the unit vector of the shortest way out.

    0: it is ``radius`` from every obstacle, and inside bounds and fence; ``out`` is then 0 too. In a polygon's notch
    the way is that off the nearest wall only.
    """
    depth, ux, uy, uz = rim(world.bounds, world.fence, world.fence_z, x, y, z)
    bins, start, items, solids = world.bins, world.bin_start, world.bin_items, world.solids
    i0, i1 = column_of(bins, 0, x - radius), column_of(bins, 0, x + radius)
    for j in range(column_of(bins, 1, y - radius), column_of(bins, 1, y + radius) + 1):
        row = j * int(bins[4])
        for n in range(start[row + i0], start[row + i1 + 1]):
            s = solids[items[n]]
            if max(s[0] - x, x - s[3], s[1] - y, y - s[4], s[2] - z, z - s[5]) >= radius:
                continue
            far, vx, vy, vz = signed_distance(s, world.corners, world.bounds[2] + radius, x, y, z)
            if radius - far > depth:
                depth, ux, uy, uz = radius - far, vx, vy, vz
    out[0], out[1], out[2] = ux, uy, uz
    return depth


# Segments.


@jit
def gap_to_box(p: Around, q: Around, low: Around, high: Around) -> float:
    """Least squared distance from a segment to a box with sides along the axes; the fourth numbers are not used.

    Along the segment the squared distance is convex and a parabola between the places where it passes the planes of
    the box's faces, so that those places are halved down to one parabola, whose lowest point is known.
    """
    least, most = 0.0, 1.0
    slope_least, slope_most = box_slope(p, q, low, high, 0.0), box_slope(p, q, low, high, 1.0)
    if slope_least >= 0.0:
        return box_gap(p, q, low, high, 0.0)
    if slope_most <= 0.0:
        return box_gap(p, q, low, high, 1.0)
    for axis in range(3):
        step = q[axis] - p[axis]
        if step == 0.0:
            continue
        for plane in (low[axis], high[axis]):
            share = (plane - p[axis]) / step
            if least < share < most:
                slope = box_slope(p, q, low, high, share)
                if slope <= 0.0:
                    least, slope_least = share, slope
                else:
                    most, slope_most = share, slope
    share = least - slope_least * (most - least) / (slope_most - slope_least)
    return box_gap(p, q, low, high, share)


@jit
def box_gap(p: Around, q: Around, low: Around, high: Around, share: float) -> float:
    """Squared distance to a box at a share of the segment's length."""
    total = 0.0
    for axis in range(3):
        at = p[axis] + share * (q[axis] - p[axis])
        total += max(low[axis] - at, at - high[axis], 0.0) ** 2
    return total


@jit
def box_slope(p: Around, q: Around, low: Around, high: Around, share: float) -> float:
    """Half of the derivative of :func:`box_gap`."""
    total = 0.0
    for axis in range(3):
        step = q[axis] - p[axis]
        at = p[axis] + share * step
        total += step * (max(at - high[axis], 0.0) - max(low[axis] - at, 0.0))
    return total


@jit
def misses_cylinder(s: Floats, p: Around, q: Around, radius: float) -> bool:
    """Whether a segment stays ``radius`` from a row of ``solids`` that is a cylinder."""
    x, y, size, floor, ceiling = (s[0] + s[3]) / 2.0, (s[1] + s[4]) / 2.0, (s[3] - s[0]) / 2.0, s[2], s[5]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    flat = dx * dx + dy * dy
    nearest = min(1.0, max(0.0, ((x - p[0]) * dx + (y - p[1]) * dy) / flat)) if flat > 0.0 else 0.0
    if math.hypot(p[0] + nearest * dx - x, p[1] + nearest * dy - y) >= size + radius:
        return True
    length, least, most = math.sqrt(flat + dz * dz), 0.0, 1.0
    for step in range(60):  # the distance is convex along the segment: halve towards its lowest point
        share = nearest if step == 0 else (least + most) / 2.0
        ax, ay, at = p[0] + share * dx - x, p[1] + share * dy - y, p[2] + share * dz
        far = math.sqrt(ax * ax + ay * ay)
        side = max(far - size, 0.0)
        height = max(at - ceiling, 0.0) - max(floor - at, 0.0)
        gap = math.sqrt(side * side + height * height)
        if gap < radius:
            return False
        slope = (ax * dx + ay * dy) / max(far, 1e-300) * side + dz * height
        if slope < 0.0:
            least = share
        else:
            most = share
        if gap - (most - least) * length >= radius or slope == 0.0:
            return True
    return True


@jit
def misses_prism(s: Floats, corners: Floats, p: Around, q: Around, radius: float) -> bool:
    """Whether a segment stays ``radius`` from a row of ``solids`` that is a prism.

    It does if both ends do, if it does so from each wall (a box without width, seen along the wall), and if it does
    not go through the prism from its top to its bottom.
    """
    first, count, floor, ceiling = int(s[7]), int(s[8]), s[2], s[5]
    for x, y, z, _ in (p, q):
        if signed_distance(s, corners, 0.0, x, y, z)[0] < radius:
            return False
    ax, ay = corners[first + count - 1]
    for n in range(first, first + count):
        bx, by = corners[n]
        length = math.hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        u = (ux * (p[0] - ax) + uy * (p[1] - ay), uy * (p[0] - ax) - ux * (p[1] - ay), p[2], 0.0)
        v = (ux * (q[0] - ax) + uy * (q[1] - ay), uy * (q[0] - ax) - ux * (q[1] - ay), q[2], 0.0)
        if gap_to_box(u, v, (0.0, 0.0, floor, 0.0), (length, 0.0, ceiling, 0.0)) < radius * radius:
            return False
        ax, ay = bx, by
    middle = (floor + ceiling) / 2.0
    if (p[2] - middle) * (q[2] - middle) >= 0.0:
        return True
    share = (middle - p[2]) / (q[2] - p[2])
    x, y = p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])
    return polygon_side(corners, first, count, x, y)[0] > 0.0


@jit
def within_fence(fence: Floats, p: Around, q: Around) -> bool:
    """Whether a whole segment, between its ends too, lies in the fence's polygon: touching the rim is inside."""
    dx, dy = q[0] - p[0], q[1] - p[1]
    count, share = len(fence), 0.0
    while share < 1.0:
        following = 1.0
        ax, ay = fence[count - 1]
        for k in range(count):
            bx, by = fence[k]
            ex, ey = bx - ax, by - ay
            cross = dx * ey - dy * ex
            if cross != 0.0:
                along = ((ax - p[0]) * ey - (ay - p[1]) * ex) / cross
                across = ((ax - p[0]) * dy - (ay - p[1]) * dx) / cross
                if share + 1e-12 < along < following and -1e-12 <= across <= 1.0 + 1e-12:
                    following = along
            ax, ay = bx, by
        half = (share + following) / 2.0
        if polygon_side(fence, 0, count, p[0] + half * dx, p[1] + half * dy)[0] > TOUCH:
            return False
        share = following
    return True


@jit
def misses(s: Floats, corners: Floats, p: Around, q: Around, radius: float) -> bool:
    """Whether a segment stays ``radius`` from a row of ``solids``."""
    if max(p[0], q[0]) + radius < s[0] or max(p[1], q[1]) + radius < s[1] or max(p[2], q[2]) + radius < s[2]:
        return True
    if min(p[0], q[0]) - radius > s[3] or min(p[1], q[1]) - radius > s[4] or min(p[2], q[2]) - radius > s[5]:
        return True
    if s[6] == 0.0:
        return gap_to_box(p, q, (s[0], s[1], s[2], 0.0), (s[3], s[4], s[5], 0.0)) >= radius * radius
    if s[6] == 1.0:
        return misses_cylinder(s, p, q, radius)
    return misses_prism(s, corners, p, q, radius)


@jit
def segment_clear(world: World, start: Floats, end: Floats, radius: float) -> bool:
    """Whether the straight line from ``start`` to ``end``, (3,) each, keeps ``radius`` from every obstacle and stays
    inside bounds and fence with its centre. Exact at every point, not sampled.
    """
    p = (start[0], start[1], start[2], 0.0)
    q = (end[0], end[1], end[2], 0.0)
    fence, fence_z = world.fence, world.fence_z
    for x, y, z, _ in (p, q):
        if rim(world.bounds, fence, fence_z, x, y, z)[0] > TOUCH:
            return False
    if len(fence) > 0 and not within_fence(fence, p, q):
        return False
    keep = max(radius - TOUCH, TOUCH)
    bins, starts, items, solids, corners = world.bins, world.bin_start, world.bin_items, world.solids, world.corners
    columns, rows = int(bins[4]), int(bins[5])
    west, east = min(p[0], q[0]) - keep, max(p[0], q[0]) + keep
    for j in range(column_of(bins, 1, min(p[1], q[1]) - keep), column_of(bins, 1, max(p[1], q[1]) + keep) + 1):
        # Which columns of this row of bins the line passes, widened by what it keeps.
        if p[1] != q[1]:
            south = -np.inf if j == 0 else bins[1] + j / bins[3] - keep
            north = np.inf if j == rows - 1 else bins[1] + (j + 1) / bins[3] + keep
            a, b = (south - p[1]) / (q[1] - p[1]), (north - p[1]) / (q[1] - p[1])
            one = p[0] + max(0.0, min(a, b)) * (q[0] - p[0])
            other = p[0] + min(1.0, max(a, b)) * (q[0] - p[0])
            west, east = min(one, other) - keep, max(one, other) + keep
        first = j * columns + column_of(bins, 0, west)
        last = j * columns + column_of(bins, 0, east)
        for n in range(starts[first], starts[last + 1]):
            if not misses(solids[items[n]], corners, p, q, keep):
                return False
    return True
