"""The static world as arrays, and exact tests of points and straight segments against it, for numba.

ENU metres. Each obstacle is a footprint raised from a floor to a ceiling, so that its distance is put together from
one over the ground and one in height. A grid of bins over the ground lists the obstacles that stand in each bin; bins
on the rim reach to infinity. No-fly polygons and the fence may be any simple polygon, convex or not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.planner.jit import jit
from agents.planner.problem import Floats, Ints
from agents.planner.scene import Box, Corner, Cylinder, Scene

TOUCH = 1e-9
"""m by which a segment may come nearer than asked, or lie outside: what rounding adds"""
FINEST_BIN = 2.0
"""m"""
MOST_BINS = 128
"""on each side"""
Around = tuple[float, float, float, float]


class World(NamedTuple):
    """What stands still. Obstacles are numbered boxes first, then cylinders, then prisms."""

    bounds: Floats
    """(6,): least x, y, z, greatest x, y, z; the centre stays inside"""
    boxes: Floats
    """(B, 6): as the bounds"""
    cylinders: Floats
    """(C, 5): x, y, radius, floor, ceiling"""
    corners: Floats
    """(V, 2): of all prisms, one after another"""
    prisms: Floats
    """(P, 4): index of the first corner, how many, floor, ceiling"""
    fence: Floats
    """(F, 2): corners; no rows: no fence"""
    fence_z: Floats
    """(2,): floor, ceiling"""
    terrain: Floats
    """(4,): height at the origin, rise per metre x and y, clearance; a height of -inf: no terrain"""
    extents: Floats
    """(B + C + P, 6): the box around each obstacle"""
    bins: Floats
    """(4,): least x and y of the bins, bins per metre along x and y"""
    bin_count: Ints
    """(2,): along x and y"""
    bin_start: Ints
    """(bins + 1,): where each bin's list starts in ``bin_items``; x runs fastest"""
    bin_items: Ints
    """numbers of obstacles"""


def world_of(scene: Scene, terrain: Sequence[float] | None = None) -> World:
    """The arrays of a scene's obstacles, bounds and fence; ``terrain``: see :class:`World`."""
    boxes = [[*o.min, *o.max] for o in scene.obstacles if isinstance(o, Box)]
    cylinders = [[*o.center, o.radius, o.floor, o.ceiling] for o in scene.obstacles if isinstance(o, Cylinder)]
    corners: list[Corner] = []
    prisms: list[list[float]] = []
    for obstacle in scene.obstacles:
        if not isinstance(obstacle, Box | Cylinder):
            polygon = open_ring(obstacle.polygon)
            prisms.append([len(corners), len(polygon), obstacle.floor, obstacle.ceiling])
            corners += polygon
    fence = scene.geofence
    return index(
        World(
            bounds=np.array([*scene.bounds.min, *scene.bounds.max], dtype=np.float64),
            boxes=np.array(boxes, dtype=np.float64).reshape(-1, 6),
            cylinders=np.array(cylinders, dtype=np.float64).reshape(-1, 5),
            corners=np.array(corners, dtype=np.float64).reshape(-1, 2),
            prisms=np.array(prisms, dtype=np.float64).reshape(-1, 4),
            fence=np.array(open_ring(fence.polygon) if fence else [], dtype=np.float64).reshape(-1, 2),
            fence_z=np.array([fence.floor, fence.ceiling] if fence else [-np.inf, np.inf], dtype=np.float64),
            terrain=np.array(terrain or (-np.inf, 0.0, 0.0, 0.0), dtype=np.float64),
            extents=np.empty((0, 6)),
            bins=np.empty(4),
            bin_count=np.empty(2, dtype=np.int64),
            bin_start=np.empty(0, dtype=np.int64),
            bin_items=np.empty(0, dtype=np.int64),
        )
    )


def open_ring(polygon: Sequence[Corner]) -> list[Corner]:
    """The corners without repeats of the one before, and without the first said again at the end."""
    return [corner for i, corner in enumerate(polygon) if corner != polygon[i - 1]]


def index(world: World) -> World:
    """The same world with ``extents`` and bins made anew from its obstacles."""
    extents = extents_of(world)
    low, high = world.bounds[:2], world.bounds[3:5]
    side = math.sqrt(float(np.prod(np.maximum(high - low, 1.0))) / max(1, len(extents)))
    size = max(FINEST_BIN, 0.8 * side)
    count = np.clip(np.ceil((high - low) / size), 1, MOST_BINS).astype(np.int64)
    scale = count / np.maximum(high - low, 1e-9)
    bins = np.array([low[0], low[1], scale[0], scale[1]])
    first = np.clip(np.floor((extents[:, 0:2] - low) * scale), 0, count - 1).astype(np.int64)
    last = np.clip(np.floor((extents[:, 3:5] - low) * scale), 0, count - 1).astype(np.int64)
    lists: list[list[int]] = [[] for _ in range(int(count[0] * count[1]))]
    for k, ((i0, j0), (i1, j1)) in enumerate(zip(first, last, strict=True)):
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                lists[j * int(count[0]) + i].append(k)
    starts = np.concatenate(([0], np.cumsum([len(one) for one in lists]))).astype(np.int64)
    items = np.array([k for one in lists for k in one], dtype=np.int64)
    return world._replace(extents=extents, bins=bins, bin_count=count, bin_start=starts, bin_items=items)


def extents_of(world: World) -> Floats:
    """(B + C + P, 6): the box around each obstacle."""
    x, y, r, floor, ceiling = world.cylinders.T
    round_ones = np.stack([x - r, y - r, floor, x + r, y + r, ceiling], axis=1)
    rows = []
    for first, count, low, high in world.prisms:
        corners = world.corners[int(first) : int(first + count)]
        rows.append([*corners.min(axis=0), low, *corners.max(axis=0), high])
    prisms = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return np.ascontiguousarray(np.concatenate([world.boxes, round_ones, prisms]))


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
def footprint(world: World, k: int, x: float, y: float) -> tuple[float, float, float]:
    """Signed distance over the ground to obstacle ``k``'s footprint, and the unit vector straight away from it."""
    boxes, rounds = len(world.boxes), len(world.cylinders)
    if k < boxes:
        b = world.boxes[k]
        ex = max(b[0] - x, x - b[3])
        ey = max(b[1] - y, y - b[4])
        to_x = -1.0 if b[0] - x > x - b[3] else 1.0
        to_y = -1.0 if b[1] - y > y - b[4] else 1.0
        if ex > 0.0 and ey > 0.0:
            side = math.sqrt(ex * ex + ey * ey)
            return side, to_x * ex / side, to_y * ey / side
        return (ex, to_x, 0.0) if ex > ey else (ey, 0.0, to_y)
    if k < boxes + rounds:
        c = world.cylinders[k - boxes]
        dx, dy = x - c[0], y - c[1]
        far = math.sqrt(dx * dx + dy * dy)
        return (far - c[2], dx / far, dy / far) if far > 1e-12 else (-c[2], 1.0, 0.0)
    p = world.prisms[k - boxes - rounds]
    side, near_x, near_y = polygon_side(world.corners, int(p[0]), int(p[1]), x, y)
    if abs(side) < 1e-12:
        return side, 1.0, 0.0
    return side, (x - near_x) / side, (y - near_y) / side


@jit
def signed_distance(world: World, k: int, x: float, y: float, z: float) -> Around:
    """Signed distance to obstacle ``k`` (negative inside) and the unit vector by which it grows fastest.

    From inside, the way down is none where the floor of the world is too near: a house is left sideways or upwards.
    """
    side, ux, uy = footprint(world, k, x, y)
    below, above = world.extents[k, 2] - z, z - world.extents[k, 5]
    height, uz = (below, -1.0) if below > above else (above, 1.0)
    if height <= 0.0:
        if below > above and world.extents[k, 2] <= world.bounds[2] + 1.0:
            height, uz = above, 1.0
        if side > 0.0 or side >= height:
            return side, ux, uy, 0.0
        return height, 0.0, 0.0, uz
    if side <= 0.0:
        return height, 0.0, 0.0, uz
    far = math.sqrt(side * side + height * height)
    return far, ux * side / far, uy * side / far, uz * height / far


@jit
def bin_of(world: World, x: float, y: float) -> tuple[int, int]:
    """Column and row of the bin a place lies in; those on the rim reach to infinity."""
    i = int(max(0.0, min(world.bin_count[0] - 1.0, math.floor((x - world.bins[0]) * world.bins[2]))))
    j = int(max(0.0, min(world.bin_count[1] - 1.0, math.floor((y - world.bins[1]) * world.bins[3]))))
    return i, j


@jit
def clearance(world: World, x: float, y: float, z: float) -> float:
    """Metres to the nearest obstacle's surface, negative inside one; inf where there are none. Exact outside."""
    ci, cj = bin_of(world, x, y)
    columns, rows = world.bin_count
    best = np.inf
    for ring in range(max(columns, rows)):
        reach = np.inf
        if ci - ring > 0:
            reach = min(reach, x - world.bins[0] - (ci - ring) / world.bins[2])
        if ci + ring < columns - 1:
            reach = min(reach, world.bins[0] + (ci + ring + 1) / world.bins[2] - x)
        if cj - ring > 0:
            reach = min(reach, y - world.bins[1] - (cj - ring) / world.bins[3])
        if cj + ring < rows - 1:
            reach = min(reach, world.bins[1] + (cj + ring + 1) / world.bins[3] - y)
        for j in range(max(0, cj - ring), min(rows, cj + ring + 1)):
            whole = abs(j - cj) == ring
            i = ci - ring
            while i <= ci + ring:
                if 0 <= i < columns:
                    cell = j * columns + i
                    for n in range(world.bin_start[cell], world.bin_start[cell + 1]):
                        best = min(best, signed_distance(world, world.bin_items[n], x, y, z)[0])
                i += 1 if whole or ring == 0 else 2 * ring
        if best <= reach:
            break
    return float(best)


@jit
def rim(world: World, x: float, y: float, z: float) -> Around:
    """How far a point is outside bounds, fence or terrain, whichever is most, and the unit vector back (0: inside)."""
    b = world.bounds
    dx = max(b[0] - x, 0.0) - max(x - b[3], 0.0)
    dy = max(b[1] - y, 0.0) - max(y - b[4], 0.0)
    dz = max(b[2] - z, 0.0) - max(z - b[5], 0.0)
    most = math.sqrt(dx * dx + dy * dy + dz * dz)
    if len(world.fence) > 0:
        side, near_x, near_y = polygon_side(world.fence, 0, len(world.fence), x, y)
        fx, fy = (near_x - x, near_y - y) if side > 0.0 else (0.0, 0.0)
        fz = max(world.fence_z[0] - z, 0.0) - max(z - world.fence_z[1], 0.0)
        far = math.sqrt(fx * fx + fy * fy + fz * fz)
        if far > most:
            most, dx, dy, dz = far, fx, fy, fz
    t = world.terrain
    under = t[0] + t[1] * x + t[2] * y + t[3] - z
    if under > most:
        most, dx, dy, dz = under, 0.0, 0.0, under
    if most <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return most, dx / most, dy / most, dz / most


@jit
def outside(world: World, x: float, y: float, z: float) -> float:
    """Metres by which a point is outside bounds, fence or terrain; 0 inside."""
    return rim(world, x, y, z)[0]


@jit
def away(world: World, x: float, y: float, z: float, radius: float, out: Floats) -> float:
    """How deep a point violates what it violates most, and in ``out`` (3,) the unit vector of the shortest way out.

    0: it is ``radius`` from every obstacle, and inside bounds and fence; ``out`` is then 0 too. In a polygon's notch
    the way is that off the nearest wall only.
    """
    depth, ux, uy, uz = rim(world, x, y, z)
    i0, j0 = bin_of(world, x - radius, y - radius)
    i1, j1 = bin_of(world, x + radius, y + radius)
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            cell = j * world.bin_count[0] + i
            for n in range(world.bin_start[cell], world.bin_start[cell + 1]):
                far, vx, vy, vz = signed_distance(world, world.bin_items[n], x, y, z)
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
def misses_cylinder(world: World, k: int, p: Around, q: Around, radius: float) -> bool:
    """Whether a segment stays ``radius`` from obstacle ``k``, a cylinder."""
    x, y, size, floor, ceiling = world.cylinders[k - len(world.boxes)]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    flat = dx * dx + dy * dy
    least, most = 0.0, 1.0
    nearest = min(1.0, max(0.0, ((x - p[0]) * dx + (y - p[1]) * dy) / flat)) if flat > 0.0 else 0.0
    if math.hypot(p[0] + nearest * dx - x, p[1] + nearest * dy - y) >= size + radius:
        return True
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
        if gap - (most - least) * math.sqrt(flat + dz * dz) >= radius or slope == 0.0:
            return True
    return True


@jit
def misses_prism(world: World, k: int, p: Around, q: Around, radius: float) -> bool:
    """Whether a segment stays ``radius`` from obstacle ``k``, a prism.

    It does if both ends do, if it does so from each wall (a box without width, seen along the wall), and if it does
    not go through the prism from its top to its bottom.
    """
    first, count, floor, ceiling = world.prisms[k - len(world.boxes) - len(world.cylinders)]
    for x, y, z, _ in (p, q):
        if signed_distance(world, k, x, y, z)[0] < radius:
            return False
    ax, ay = world.corners[int(first + count) - 1]
    for n in range(int(first), int(first + count)):
        bx, by = world.corners[n]
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
    return polygon_side(world.corners, int(first), int(count), x, y)[0] > 0.0


@jit
def within_fence(world: World, p: Around, q: Around) -> bool:
    """Whether a whole segment, between its ends too, lies in the fence's polygon: touching the rim is inside."""
    fence, dx, dy = world.fence, q[0] - p[0], q[1] - p[1]
    count, share = len(world.fence), 0.0
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
def segment_clear(world: World, start: Floats, end: Floats, radius: float) -> bool:
    """Whether the straight line from ``start`` to ``end``, (3,) each, keeps ``radius`` from every obstacle and stays
    inside bounds, fence and terrain with its centre. Exact at every point, not sampled.
    """
    p = (start[0], start[1], start[2], 0.0)
    q = (end[0], end[1], end[2], 0.0)
    if rim(world, p[0], p[1], p[2])[0] > TOUCH or rim(world, q[0], q[1], q[2])[0] > TOUCH:
        return False
    if len(world.fence) > 0 and not within_fence(world, p, q):
        return False
    keep = max(radius - TOUCH, TOUCH)
    boxes, rounds = len(world.boxes), len(world.cylinders)
    low_x, low_y, low_z = min(p[0], q[0]) - keep, min(p[1], q[1]) - keep, min(p[2], q[2]) - keep
    high_x, high_y, high_z = max(p[0], q[0]) + keep, max(p[1], q[1]) + keep, max(p[2], q[2]) + keep
    _, j0 = bin_of(world, low_x, low_y)
    _, j1 = bin_of(world, high_x, high_y)
    rows = world.bin_count[1]
    for j in range(j0, j1 + 1):
        # Which columns of this row of bins the line passes, widened by what it keeps.
        south = -np.inf if j == 0 else world.bins[1] + j / world.bins[3] - keep
        north = np.inf if j == rows - 1 else world.bins[1] + (j + 1) / world.bins[3] + keep
        west, east = low_x, high_x
        if p[1] != q[1]:
            a, b = (south - p[1]) / (q[1] - p[1]), (north - p[1]) / (q[1] - p[1])
            first, last = max(0.0, min(a, b)), min(1.0, max(a, b))
            one, other = p[0] + first * (q[0] - p[0]), p[0] + last * (q[0] - p[0])
            west, east = min(one, other) - keep, max(one, other) + keep
        i0, _ = bin_of(world, west, low_y)
        i1, _ = bin_of(world, east, low_y)
        for cell in range(j * world.bin_count[0] + i0, j * world.bin_count[0] + i1 + 1):
            for n in range(world.bin_start[cell], world.bin_start[cell + 1]):
                k = world.bin_items[n]
                e = world.extents[k]
                if e[0] > high_x or e[1] > high_y or e[2] > high_z:
                    continue
                if e[3] < low_x or e[4] < low_y or e[5] < low_z:
                    continue
                if k < boxes:
                    if gap_to_box(p, q, (e[0], e[1], e[2], 0.0), (e[3], e[4], e[5], 0.0)) < keep * keep:
                        return False
                elif k < boxes + rounds:
                    if not misses_cylinder(world, k, p, q, keep):
                        return False
                elif not misses_prism(world, k, p, q, keep):
                    return False
    return True
