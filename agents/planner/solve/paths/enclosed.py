"""Whether there is a way at all: a proof that there is none, or a way however crooked.

Space is cut into cells, and those near surfaces into eighths again. What a vehicle's centre cannot be in anywhere is
left out. A flood through all the rest from both ends either runs dry on one side: then there is no way; or it meets:
then the line through its cells is tested, and where it is not clear cells are cut again. Cells are kept in a table of
those looked at, so that a large scene costs no more memory than what is flooded. (Approximate cell decomposition with
refinement along channels: D. Zhu and J.-C. Latombe, "New heuristic algorithms for efficient hierarchical path
planning", 1991.)
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.geometry import clearance, outside, polygon_side, segment_clear
from agents.planner.model.problem import Floats, Ints, Path
from agents.planner.model.world import World
from agents.planner.solve.heap import pop, push
from agents.planner.solve.jit import jit

Bytes = NDArray[np.uint8]
FREE, MIXED, BLOCKED = 1, 2, 3
FLAT = 1e-9
BITS = 18
"""of a cell's place along each axis"""
MET, GAVE_UP = 0, -1
MOST_CELLS = 1_000_000
"""of one flood"""
CELLS_PER_SECOND = 400_000
MOST_EVEN = 120_000
"""up to which cells are cut everywhere near surfaces, and only along the line after that; so too from half the radius
on, where every wall is seen to be one"""


class Cells(NamedTuple):
    """How space is cut: a table of cells by hashing with open addressing."""

    low: Floats
    """(3,): least x, y, z"""
    size: Floats
    """(3,): m, of the largest cells; a height of next to nothing: a map of one height, cut into quarters"""
    counts: Ints
    """(3,): of the largest cells"""
    depth: int
    """how often cells near surfaces are cut everywhere"""
    keys: Ints
    """level + 1 and place of a cell; 0: none"""
    found: Bytes
    """FREE, MIXED or BLOCKED; plus 4 where the flood from the start was, 8 where that from the goal was; plus 16 where
    it is cut though it is as small as ``depth`` asks"""
    parents: Ints
    """the key of the cell from which the flood came; 0: it holds the end"""


@jit
def slot_of(keys: Ints, key: int) -> int:
    """Where a key is in the table, or the empty place where it belongs."""
    at = (key * 0x2545F4914F6CDD1D >> 24) & (len(keys) - 1)
    while keys[at] != 0 and keys[at] != key:
        at = (at + 1) & (len(keys) - 1)
    return int(at)


@jit
def grown(keys: Ints, found: Bytes, parents: Ints) -> tuple[Ints, Bytes, Ints]:
    """The same table, twice as large."""
    more, of = np.zeros(2 * len(keys), dtype=np.int64), np.zeros(2 * len(keys), dtype=np.uint8)
    by = np.zeros(2 * len(keys), dtype=np.int64)
    for n in range(len(keys)):
        if keys[n] != 0:
            at = slot_of(more, keys[n])
            more[at], of[at], by[at] = keys[n], found[n], parents[n]
    return more, of, by


@jit
def middle_of(low: Floats, size: Floats, key: int) -> tuple[float, float, float, float]:
    """A cell's middle, and its share of the largest cells' size."""
    scale, most = 0.5 ** ((key >> 3 * BITS) - 1), (1 << BITS) - 1
    x = low[0] + ((key & most) + 0.5) * size[0] * scale
    y = low[1] + ((key >> BITS & most) + 0.5) * size[1] * scale
    z = low[2] + ((key >> 2 * BITS & most) + 0.5) * size[2] * scale
    return x, y, z, scale


@jit
def classify(world: World, radius: float, low: Floats, size: Floats, key: int) -> int:
    """What is known of a whole cell by its middle: distances change by no more than the way from there."""
    x, y, z, scale = middle_of(low, size, key)
    reach = 0.5 * scale * math.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
    beyond = outside(world, x, y, z)
    if beyond > reach:
        return BLOCKED
    near = clearance(world, x, y, z)
    if near + reach < radius:
        return BLOCKED
    if near - reach < radius or beyond > 0.0:
        return MIXED
    if len(world.fence) > 0 and polygon_side(world.fence, 0, len(world.fence), x, y)[0] > -reach:
        return MIXED
    return FREE


@jit
def key_at(cells: Cells, level: int, point: Floats) -> int:
    """The key of the cell of a level that a point lies in."""
    key = level + 1
    for axis in range(2, -1, -1):
        place = (point[axis] - cells.low[axis]) / cells.size[axis] * 2.0**level
        key = key << BITS | int(max(0.0, min(cells.counts[axis] * 2.0**level - 1.0, place)))
    return key


@jit
def beside(count: Ints, key: int, direction: int) -> int:
    """The key of the cell of the same level on one of six sides; 0: there is none."""
    axis, forward = direction // 2, direction % 2
    shift, level = BITS * axis, (key >> 3 * BITS) - 1
    place = key >> shift & (1 << BITS) - 1
    if place == 0 if forward == 0 else place + 1 >= count[axis] << level:
        return 0
    return key + (1 << shift) if forward else key - (1 << shift)


@jit
def parent_of(key: int, up: int) -> int:
    """The cell ``up`` levels above that holds a cell."""
    most = (1 << BITS) - 1
    i, j, k = (key & most) >> up, (key >> BITS & most) >> up, (key >> 2 * BITS & most) >> up
    return (((key >> 3 * BITS) - up << BITS | k) << BITS | j) << BITS | i


@jit
def child_of(key: int, n: int) -> int:
    """The ``n``-th of the eight cells that a cell is cut into; bit 0 of ``n`` is x, bit 1 y, bit 2 z."""
    most = (1 << BITS) - 1
    i = (key & most) << 1 | (n & 1)
    j = (key >> BITS & most) << 1 | (n >> 1 & 1)
    k = (key >> 2 * BITS & most) << 1 | (n >> 2 & 1)
    return (((key >> 3 * BITS) + 1 << BITS | k) << BITS | j) << BITS | i


@jit
def wider(order: Floats, queue: Ints) -> tuple[Floats, Ints]:
    """Both sides' heaps with twice the room."""
    count = order.shape[1]
    more, of = np.empty((2, 2 * count)), np.empty((2, 2 * count), dtype=np.int64)
    for side in range(2):
        for n in range(count):
            more[side, n], of[side, n] = order[side, n], queue[side, n]
    return more, of


@jit
def chain(keys: Ints, parents: Ints, side: int, cell: int, key: int) -> Ints:
    """The cells from start to goal where the flood of a side came from ``cell`` to ``key``, one of the other's."""
    near, far = (cell, key) if side == 0 else (key, cell)
    split, count, at = 0, 0, near
    while at != 0:
        split, at = split + 1, parents[slot_of(keys, at)]
    at = far
    while at != 0:
        count, at = count + 1, parents[slot_of(keys, at)]
    path = np.empty(split + count, dtype=np.int64)
    at = near
    for n in range(split - 1, -1, -1):
        path[n], at = at, parents[slot_of(keys, at)]
    at = far
    for n in range(split, split + count):
        path[n], at = at, parents[slot_of(keys, at)]
    return path


@jit
def leaf_at(world: World, radius: float, cells: Cells, keys: Ints, found: Bytes, point: Floats) -> int:
    """The key of the cell that holds a point and is not cut."""
    level = 0
    while True:
        key = key_at(cells, level, point)
        slot = slot_of(keys, key)
        kind = int(found[slot]) if keys[slot] != 0 else classify(world, radius, cells.low, cells.size, key)
        if kind & 3 != MIXED or (level >= cells.depth and not kind & 16):
            return key
        level += 1


@jit
def cut(cells: Cells, keys: Ints) -> None:
    """Mark cells to be cut."""
    for key in keys:
        cells.found[slot_of(cells.keys, key)] |= 16


@jit
def flood(world: World, radius: float, cells: Cells, start: Floats, goal: Floats, most: int) -> tuple[int, Cells, Ints]:
    """Flood from both ends, each towards the other: 4 or 8 where that from the start or the goal ran dry, MET, or
    GAVE_UP after ``most`` cells; the table then; and where they met the keys of the cells from start to goal.
    """
    keys, found, parents, used = cells.keys.copy(), cells.found.copy(), cells.parents.copy(), 0
    for n in range(len(found)):
        found[n] &= 19  # where floods were before is nothing to this one
        used += 1 if keys[n] != 0 else 0
    order, queue, waiting = np.empty((2, 4096)), np.empty((2, 4096), dtype=np.int64), np.zeros(2, dtype=np.int64)
    ends, todo, nothing = np.empty((2, 3)), np.empty(512, dtype=np.int64), np.empty(0, dtype=np.int64)
    ends[0], ends[1] = start, goal
    side, direction, cell = 0, -1, 0
    low, size, count, depth = cells.low, cells.size, cells.counts, cells.depth
    flat = size[2] < 2.0 * FLAT
    while True:
        # What touches one face of the cell in hand; before that, once for each side, what holds its end.
        key = (
            leaf_at(world, radius, cells, keys, found, ends[side]) if direction < 0 else beside(count, cell, direction)
        )
        pending = 1 if key != 0 else 0
        todo[0] = key
        if pending and keys[slot_of(keys, key)] == 0:
            # Not looked at yet: it may lie in a larger cell that is of one kind.
            for up in range((key >> 3 * BITS) - 1, -1, -1):
                todo[0] = parent_of(key, up)
                slot = slot_of(keys, todo[0])
                if keys[slot] == 0:
                    keys[slot], found[slot] = todo[0], classify(world, radius, low, size, todo[0])
                    used += 1
                if found[slot] & 3 != MIXED or ((todo[0] >> 3 * BITS) - 1 >= depth and not found[slot] & 16):
                    break
        while pending:
            pending -= 1
            key = todo[pending]
            if 2 * used > len(keys) - 64:
                keys, found, parents = grown(keys, found, parents)
            slot = slot_of(keys, key)
            if keys[slot] == 0:
                keys[slot], found[slot] = key, classify(world, radius, low, size, key)
                used += 1
            if found[slot] & 3 == BLOCKED:
                continue
            if found[slot] & 3 == MIXED and ((key >> 3 * BITS) - 1 < depth or found[slot] & 16):
                for n in range(4 if flat else 8):  # only those on the face towards the cell in hand
                    if (n >> direction // 2 & 1) != direction % 2:
                        todo[pending] = child_of(key, n)
                        pending += 1
                continue
            if found[slot] & (8 >> side):
                return MET, Cells(low, size, count, depth, keys, found, parents), chain(keys, parents, side, cell, key)
            if not found[slot] & (4 << side):
                found[slot] |= 4 << side
                parents[slot] = cell if direction >= 0 else 0
                x, y, z, scale = middle_of(low, size, key)
                aim = ends[1 - side]
                if waiting[side] == order.shape[1]:
                    order, queue = wider(order, queue)
                far = math.sqrt((x - aim[0]) ** 2 + (y - aim[1]) ** 2 + (z - aim[2]) ** 2)
                if found[slot] & 3 == MIXED:
                    far += 4.0 * size[0] * scale  # what is free first
                push(order[side], queue[side], waiting[side], far, key)
                waiting[side] += 1
        direction += 1
        if direction == 0 and side == 0:
            side, direction = 1, -1
            continue
        if direction == 0 or direction == (4 if flat else 6):
            if used > most:
                return GAVE_UP, Cells(low, size, count, depth, keys, found, parents), nothing
            side, direction = 1 - side, 0
            if waiting[side] == 0:
                return 4 << side, Cells(low, size, count, depth, keys, found, parents), nothing
            cell = pop(order[side], queue[side], waiting[side])
            waiting[side] -= 1


@jit
def holds(world: World, radius: float, cells: Cells, flag: int, point: Floats) -> bool:
    """Whether the flood that left ``flag`` was where a point is."""
    slot = slot_of(cells.keys, leaf_at(world, radius, cells, cells.keys, cells.found, point))
    return bool(cells.keys[slot] != 0 and (cells.found[slot] & flag) > 0)


class Pocket(NamedTuple):
    """A part of space that nothing of a radius leaves or enters."""

    cells: Cells
    flag: int

    def holds(self, world: World, radius: float, point: Floats) -> bool:
        return bool(holds(world, radius, self.cells, self.flag, point))


def decide(
    world: World, radius: float, start: Floats, goal: Floats, seconds: float, height: float | None = None
) -> Pocket | Path | None:
    """Proof that start and goal, (3,) each, are separated for a radius, or a way; None: neither was found in time.

    ``height``: of what stays at it. Coarse cells first. The least have a side of a hundredth of the radius, so that of
    an opening that is too narrow by less than that nothing is proven.
    """
    cells, end = _uncut(world, radius, height), time.monotonic() + seconds
    most = min(MOST_CELLS, round(CELLS_PER_SECOND * seconds))
    while time.monotonic() < end:
        verdict, cells, keys = flood(world, radius, cells, start, goal, most)
        if verdict == GAVE_UP:
            return None
        if verdict != MET:
            return Pocket(cells, verdict)
        path = _line_through(cells, keys, start, goal)
        blocked = [n for n in range(len(path) - 1) if not segment_clear(world, path[n], path[n + 1], radius)]
        if not blocked:
            return path
        if cells.size.max() / 2.0**cells.depth > 0.51 * radius and np.count_nonzero(cells.keys) < MOST_EVEN:
            cells = cells._replace(depth=cells.depth + 1)
            continue
        if not _cut_near(world, cells, path, keys, blocked, radius):
            return None
    return None


def _uncut(world: World, radius: float, height: float | None) -> Cells:
    low, span = world.bounds[:3].copy(), np.maximum(world.bounds[3:] - world.bounds[:3], 1e-3)
    count = np.maximum(1, np.round(span / max(8.0 * radius, float(span.max()) / 64.0))).astype(np.int64)
    if height is not None:
        low[2], span[2], count[2] = height, FLAT, 1
    table = np.zeros(4096, dtype=np.int64), np.zeros(4096, dtype=np.uint8), np.zeros(4096, dtype=np.int64)
    return Cells(low, span / count, count, 0, *table)


def _corners(cells: Cells, keys: Ints) -> tuple[Floats, Floats]:
    """(K, 3) each: cells' least and greatest x, y, z."""
    scale = 0.5 ** ((keys >> 3 * BITS) - 1)[:, None]
    places = np.stack([keys >> BITS * axis & (1 << BITS) - 1 for axis in range(3)], axis=1)
    low = cells.low + places * cells.size * scale
    return low, low + cells.size * scale


def _line_through(cells: Cells, keys: Ints, start: Floats, goal: Floats) -> Path:
    """Through the middles of the faces that the cells share: leg n is in cell n."""
    low, high = _corners(cells, keys)
    faces = (np.maximum(low[:-1], low[1:]) + np.minimum(high[:-1], high[1:])) / 2.0
    return np.concatenate((start[None], faces, goal[None]))


def _cut_near(world: World, cells: Cells, path: Path, keys: Ints, legs: list[int], radius: float) -> bool:
    """Cut the cells that blocked legs are in, and all within half a radius of where it is narrowest, if they are mixed
    and not yet the least; whether there was one.
    """
    spare = [clearance(world, *((path[n] + path[n + 1]) / 2.0)) for n in legs]
    narrowest = legs[int(np.argmin(spare))]
    near = cells.keys[(cells.found & 16 == 0) & (cells.found & 12 != 0)]
    low, high = _corners(cells, near)
    away = np.maximum(np.maximum(low - path[narrowest], path[narrowest] - high), 0.0)
    near = near[np.linalg.norm(away, axis=1) < radius / 2.0]
    chosen = np.unique(np.concatenate((keys[legs], near)))
    kinds = np.array([cells.found[slot_of(cells.keys, int(key))] & 3 for key in chosen])
    large = cells.size.max() / 2.0 ** ((chosen >> 3 * BITS) - 1) > radius / 100.0
    chosen = chosen[large & (kinds == MIXED)]
    cut(cells, chosen)
    return len(chosen) > 0
