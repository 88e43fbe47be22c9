"""A regular lattice of places through the free space of one class of vehicles, and times to a goal over it.

The lattice's cells are cubes in the scaled metric: higher than wide by the downwash factor. 26 neighbours, or 8 where
it is flat (rovers). Every edge was tested exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.planner.model.geometry import away, segment_clear
from agents.planner.model.problem import Floats, Ints
from agents.planner.model.world import World
from agents.planner.solve.jit import jit

MOVES = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)], dtype=np.int64
)
"""(26, 3): the m-th is the opposite of the (25 - m)-th"""
FAR = 1 << 40
"""steps: the goal cannot be reached"""


class Lattice(NamedTuple):
    """Node n = (k * ny + j) * nx + i lies at origin + (i, j, k) * pitch."""

    origin: Floats
    """(3,)"""
    pitch: Floats
    """(3,)"""
    shape: Ints
    """(3,): nx, ny, nz"""
    edges: Ints
    """(nodes,): bit m: move m is free from here"""


@jit
def free_edges(world: World, radius: float, origin: Floats, pitch: Floats, shape: Ints, moves: Ints) -> Ints:
    """Bits of the moves that are free from each node for a vehicle of this radius."""
    nx, ny, nz = shape
    count = nx * ny * nz
    diagonal = math.sqrt(pitch[0] ** 2 + pitch[1] ** 2 + (pitch[2] ** 2 if nz > 1 else 0.0))
    out, p, q = np.empty(3), np.empty(3), np.empty(3)
    state = np.zeros(count, dtype=np.int8)  # 0: no place, 1: free, 2: free as far as the longest edge goes
    fenced = len(world.fence) > 0
    for n in range(count):
        x, y, z = (
            origin[0] + n % nx * pitch[0],
            origin[1] + n // nx % ny * pitch[1],
            origin[2] + n // (nx * ny) * pitch[2],
        )
        if away(world, x, y, z, radius + diagonal, out) <= 0.0:
            state[n] = 1 if fenced else 2
        elif away(world, x, y, z, radius, out) <= 0.0:
            state[n] = 1
    edges = np.zeros(count, dtype=np.int64)
    for n in range(count):
        if state[n] == 0:
            continue
        i, j, k = n % nx, n // nx % ny, n // (nx * ny)
        p[0], p[1], p[2] = origin[0] + i * pitch[0], origin[1] + j * pitch[1], origin[2] + k * pitch[2]
        for m in range(13):
            a, b, c = i + moves[m, 0], j + moves[m, 1], k + moves[m, 2]
            if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz:
                continue
            other = (c * ny + b) * nx + a
            if state[other] == 0:
                continue
            if state[n] != 2 and state[other] != 2:
                q[0], q[1], q[2] = origin[0] + a * pitch[0], origin[1] + b * pitch[1], origin[2] + c * pitch[2]
                if not segment_clear(world, p, q, radius):
                    continue
            edges[n] |= 1 << m
            edges[other] |= 1 << (25 - m)
    return edges


@jit
def times_to(lattice: Lattice, moves: Ints, steps: Ints, seeds: Ints, values: Ints) -> Ints:
    """Fewest steps from each node to a goal, given those from the seeds; FAR: no way. (Dial 1969.)

    ``steps`` (26,): how many each move takes.
    """
    nx, ny, _ = lattice.shape
    count, most = len(lattice.edges), values.max() + 1
    least_of = np.full(count, FAR, dtype=np.int64)
    ring = max(most, steps.max() + 1)
    first = np.full(ring, -1, dtype=np.int64)
    capacity = 4 * count + len(seeds)
    node, following, waiting, used, released = (
        np.empty(capacity, dtype=np.int64),
        np.empty(capacity, dtype=np.int64),
        0,
        0,
        -1,
    )
    for s in range(len(seeds)):
        if values[s] < least_of[seeds[s]]:
            least_of[seeds[s]] = values[s]
            node[used], following[used] = seeds[s], first[values[s]]
            first[values[s]] = used
            used, waiting = used + 1, waiting + 1
    now = 0
    while waiting > 0:
        slot = now % ring
        while first[slot] >= 0:
            entry = first[slot]
            first[slot] = following[entry]
            waiting -= 1
            n = node[entry]
            following[entry], released = released, entry
            if least_of[n] != now:
                continue
            i, j, k = n % nx, n // nx % ny, n // (nx * ny)
            for m in range(26):
                if lattice.edges[n] >> m & 1 == 0:
                    continue
                other = ((k + moves[m, 2]) * ny + j + moves[m, 1]) * nx + i + moves[m, 0]
                value = now + steps[25 - m]
                if value < least_of[other]:
                    least_of[other] = value
                    if released >= 0:
                        entry = released
                        released = following[entry]
                    elif used < capacity:
                        entry = used
                        used += 1
                    else:
                        continue
                    to = value % ring
                    node[entry], following[entry] = other, first[to]
                    first[to] = entry
                    waiting += 1
        now += 1
    return least_of


def lattice_of(world: World, radius: float, pitch: Floats, low: Floats, high: Floats, through: Floats) -> Lattice:
    """The lattice with a node at ``through`` (3,), in the box from ``low`` to ``high``; flat where these have one z."""
    below = np.maximum(0.0, np.floor((through - low) / pitch + 1e-9))
    above = np.maximum(0.0, np.floor((high - through) / pitch + 1e-9))
    origin = np.ascontiguousarray(through - below * pitch)
    shape = (below + above + 1.0).astype(np.int64)
    return Lattice(origin, pitch, shape, free_edges(world, radius, origin, pitch, shape, MOVES))


def anchor(world: World, radius: float, pitch: Floats, places: Floats) -> Floats:
    """(3,): where a node should be so that most lanes lead through the narrowest gap at ``places`` (n, 3).

    Along each axis, the gap is what is free between the boxes around two obstacles, on either side of a place; the
    median of the places where there is none.
    """
    middle = np.median(places, axis=0)
    low, high = world.solids[:, :3] - radius, world.solids[:, 3:6] + radius
    if not len(low):
        return middle
    for axis in range(3):
        aside = [other for other in range(3) if other != axis]
        faces = ((places[:, None, aside] > low[None, :, aside]) & (places[:, None, aside] < high[None, :, aside])).all(
            2
        )
        at = places[:, None, axis]
        above = np.where(faces & (low[None, :, axis] >= at - 1e-6), low[None, :, axis], np.inf).min(axis=1)
        below = np.where(faces & (high[None, :, axis] <= at + 1e-6), high[None, :, axis], -np.inf).max(axis=1)
        width = above - below
        one = int(np.argmin(np.where(width > 0.0, width, np.inf)))
        if 0.0 < width[one] < np.inf:
            lanes = math.floor(width[one] / pitch[axis])
            middle[axis] = (above[one] + below[one] - lanes * pitch[axis]) / 2.0
    return middle


def nodes_about(lattice: Lattice, place: Floats, cells: float = 1.5) -> tuple[Ints, Floats]:
    """The free nodes within ``cells`` pitches of a place along each axis, and where they are (n, 3)."""
    at = (place - lattice.origin) / lattice.pitch
    ranges = []
    for axis in range(3):
        low = max(0, math.ceil(at[axis] - cells))
        high = min(int(lattice.shape[axis]) - 1, math.floor(at[axis] + cells))
        ranges.append(np.arange(low, high + 1))
    i, j, k = (grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij"))
    nodes = (k * lattice.shape[1] + j) * lattice.shape[0] + i
    nodes = nodes[lattice.edges[nodes] != 0]
    return nodes.astype(np.int64), where(lattice, nodes)


def where(lattice: Lattice, nodes: Ints) -> Floats:
    """(n, 3): the nodes' places."""
    nx, ny = int(lattice.shape[0]), int(lattice.shape[1])
    index = np.stack([nodes % nx, nodes // nx % ny, nodes // (nx * ny)], axis=1)
    return np.asarray(lattice.origin + index * lattice.pitch, dtype=np.float64)
