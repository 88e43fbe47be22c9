"""Any-angle search over a lattice of points: Lazy Theta* (Nash, Koenig, Tovey: "Lazy Theta*", AAAI 2010) in numba.

A point's parent need not be its neighbour: it is whatever point before it is in sight, so that ways are not bent to the
lattice's directions. Sight is the exact test of the straight segment, asked only when a point is expanded. What is
minimised is time at the vehicle's speeds, not length: climbing may be slow.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.geometry import away, segment_clear
from agents.planner.model.problem import Floats, Ints, Path
from agents.planner.model.world import World
from agents.planner.solve.jit import jit
from agents.planner.solve.paths.lattice import Lattice

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int32]
UNKNOWN, FREE, TAKEN = 0, 1, 2
OPEN, SURE, CLOSED = 0, 1, 2
"""what a point's mark is over three times the turn; sure: it sees its parent"""
START = -1
"""the parent of points that see the start"""


class Room(NamedTuple):
    """What a search leaves and works in: an array of each kind with one place for each point of the lattice."""

    state: Bytes
    """UNKNOWN, FREE or TAKEN, kept from search to search for the same world and radius"""
    cost: Floats
    """s from the start"""
    parent: Indices
    mark: Indices
    turn: int
    """counts the searches, from 1, so that nothing need be cleared: marks of earlier turns are lower"""


@jit
def duration(dx: float, dy: float, dz: float, rates: Floats) -> float:
    """s along a straight line at full speed; ``rates``: m/s along any direction, upwards, downwards."""
    level = math.sqrt(dx * dx + dy * dy + dz * dz) / rates[0]
    return float(max(level, dz / rates[1] if dz > 0.0 else -dz / rates[2]))


@jit
def place(xs: Floats, ys: Floats, zs: Floats, at: int, out: Floats) -> None:
    """The coordinates of a point of the lattice by its number."""
    nx, ny = len(xs), len(ys)
    out[0], out[1], out[2] = xs[at % nx], ys[at // nx % ny], zs[at // (nx * ny)]


@jit
def rejoin(world: World, lines: Lattice, room: Room, at: int, radius: float, rates: Floats) -> bool:
    """Give a point whose parent is out of sight the best parent among the neighbours that were expanded."""
    xs, ys, zs = lines.x, lines.y, lines.z
    nx, ny, nz = len(xs), len(ys), len(zs)
    i, j, k, here, there = at % nx, at // nx % ny, at // (nx * ny), np.empty(3), np.empty(3)
    place(xs, ys, zs, at, here)
    best = np.inf
    for step in range(27):
        a, b, c = i + step % 3 - 1, j + step // 3 % 3 - 1, k + step // 9 - 1
        if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz or step == 13:
            continue
        by = (c * ny + b) * nx + a
        if room.mark[by] == 3 * room.turn + CLOSED:
            place(xs, ys, zs, by, there)
            total = room.cost[by] + duration(here[0] - there[0], here[1] - there[1], here[2] - there[2], rates)
            if total < best and segment_clear(world, there, here, radius):
                best = room.cost[at] = total
                room.parent[at] = by
    return best < np.inf


@jit
def way_to(lines: Lattice, parent: Indices, at: int, start: Floats, goal: Floats) -> Path:
    """From the start along the parents of a point to it, and on to the goal."""
    count, by = 2, at
    while by != START:
        count, by = count + 1, parent[by]
    way = np.empty((count, 3))
    for axis in range(3):  # one by one: for the assignment of an array numba compiles what words an error of shapes
        way[0, axis], way[count - 1, axis] = start[axis], goal[axis]
    for row in range(count - 2, 0, -1):
        place(lines.x, lines.y, lines.z, at, way[row])
        at = parent[at]
    return way


@jit
def search(
    world: World,
    lines: Lattice,
    room: Room,
    start: Floats,
    goal: Floats,
    first: Ints,
    last: Ints,
    radius: float,
    rates: Floats,
    weight: float,
    most: int,
) -> tuple[Path, int]:
    """A way from start to goal, (K, 3) with both, and how many points were expanded; no rows: none was found.

    ``first`` and ``last``: numbers of the points to look at from the start and the goal. ``weight``: of the heuristic.
    ``most``: expansions after which to give up.
    """
    xs, ys, zs, state, cost, parent, mark = lines.x, lines.y, lines.z, room.state, room.cost, room.parent, room.mark
    nx, ny, nz = len(xs), len(ys), len(zs)
    opened, sure, closed = 3 * room.turn + OPEN, 3 * room.turn + SURE, 3 * room.turn + CLOSED
    end, expanded, before_end, end_cost = nx * ny * nz, 0, START, np.inf
    here, there, way = np.empty(3), np.empty(3), np.empty(3)
    waiting = [(np.inf, end)]
    for at in first:
        place(xs, ys, zs, at, here)
        if segment_clear(world, start, here, radius):
            cost[at], parent[at], mark[at] = (
                duration(here[0] - start[0], here[1] - start[1], here[2] - start[2], rates),
                START,
                sure,
            )
            left = duration(goal[0] - here[0], goal[1] - here[1], goal[2] - here[2], rates)
            heapq.heappush(waiting, (cost[at] + weight * left, at))
    while expanded < most:
        _, at = heapq.heappop(waiting)
        if at == end:
            break
        if mark[at] == closed:
            continue
        place(xs, ys, zs, at, here)
        left = duration(goal[0] - here[0], goal[1] - here[1], goal[2] - here[2], rates)
        if mark[at] == opened:
            mark[at], up, old = sure, parent[at], cost[at]
            if up == START:
                there[0], there[1], there[2] = start[0], start[1], start[2]
            else:
                place(xs, ys, zs, up, there)
            if not segment_clear(world, there, here, radius):
                if not rejoin(world, lines, room, at, radius, rates):
                    mark[at] = opened - 1  # not reached after all
                    continue
                if cost[at] > old and cost[at] + weight * left > waiting[0][0]:
                    heapq.heappush(waiting, (cost[at] + weight * left, at))  # not its turn yet
                    continue
        mark[at] = closed
        expanded += 1
        for one in last:
            if one == at and cost[at] + left < end_cost and segment_clear(world, here, goal, radius):
                before_end, end_cost = at, cost[at] + left
                heapq.heappush(waiting, (end_cost, end))
        up, before = parent[at], 0.0
        if up == START:
            there[0], there[1], there[2] = start[0], start[1], start[2]
        else:
            place(xs, ys, zs, up, there)
            before = cost[up]
        i, j, k = at % nx, at // nx % ny, at // (nx * ny)
        for step in range(27):
            a, b, c = i + step % 3 - 1, j + step // 3 % 3 - 1, k + step // 9 - 1
            if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz or step == 13:
                continue
            to = (c * ny + b) * nx + a
            if mark[to] == closed or state[to] == TAKEN:
                continue
            x, y, z = xs[a], ys[b], zs[c]
            if state[to] == UNKNOWN:
                free = away(world, x, y, z, radius, way) <= 0.0
                state[to] = FREE if free else TAKEN
                if not free:
                    continue
            total = before + duration(x - there[0], y - there[1], z - there[2], rates)
            if mark[to] < opened or total < cost[to]:
                cost[to], parent[to], mark[to] = total, up, opened
                left = duration(goal[0] - x, goal[1] - y, goal[2] - z, rates)
                heapq.heappush(waiting, (total + weight * left, to))
    if before_end == START:
        return np.empty((0, 3)), expanded
    return way_to(lines, parent, before_end, start, goal), expanded
