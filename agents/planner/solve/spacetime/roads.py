"""What one vehicle may move on: its own path's vertices and the lattice of its class, with times in whole steps."""

from __future__ import annotations

import itertools

import numpy as np

from agents.planner.model.geometry import segment_clear
from agents.planner.model.problem import Floats, Ints, Path
from agents.planner.model.world import World
from agents.planner.solve.jit import jit
from agents.planner.solve.spacetime.lattice import FAR, MOVES, Lattice, nodes_about, times_to
from agents.planner.solve.spacetime.search import Roads

ROOM = 1.06
"""times the sum of two radii: so far apart are lanes beside each other"""
CHUNK = 6
"""steps: a path is cut into moves of about this many, between which a vehicle may wait or leave the path"""


@jit
def reachable(world: World, radius: float, place: Floats, places: Floats) -> Ints:
    """1 for each of (n, 3) places to which the straight line is clear, else 0."""
    out = np.zeros(len(places), dtype=np.int64)
    for n in range(len(places)):
        if segment_clear(world, place, places[n], radius):
            out[n] = 1
    return out


def durations(vectors: Floats, speed: float, climb: float, descend: float, step: float) -> Ints:
    """(n,) steps, rounded up and at least one, that straight moves (n, 3) take."""
    level = np.linalg.norm(vectors, axis=1) / speed
    up = np.maximum(vectors[:, 2] / climb, -vectors[:, 2] / descend)
    steps: Ints = np.maximum(1, np.ceil(np.maximum(level, up) / step - 1e-9)).astype(np.int64)
    return steps


def chopped(path: Path, speed: float, climb: float, descend: float, step: float) -> tuple[Floats, Ints]:
    """A path's vertices, more of them on long pieces, and the steps of each piece: whole times, evenly used."""
    taken = durations(np.diff(path, axis=0), speed, climb, descend, step)
    vertices, steps = [path[0]], []
    for n, whole in enumerate(taken.tolist()):
        pieces = max(1, round(whole / CHUNK))
        marks = [whole * k // pieces for k in range(pieces + 1)]
        for a, b in itertools.pairwise(marks):
            steps.append(b - a)
            vertices.append(path[n + 1] if b == whole else path[n] + (path[n + 1] - path[n]) * (b / whole))
    return np.array(vertices), np.array(steps, dtype=np.int64)


def no_lattice() -> Lattice:
    """A lattice without nodes: the path alone."""
    empty = np.empty(0, dtype=np.int64)
    return Lattice(np.zeros(3), np.ones(3), np.ones(3, dtype=np.int64), empty)


def roads_of(
    world: World, lattice: Lattice, path: Path, radius: float, speed: float, climb: float, descend: float, step: float
) -> Roads:
    """The roads of a vehicle along its path and over its lattice (FAR ahead: no way from there)."""
    places, along = chopped(path, speed, climb, descend, step)
    nodes, own = len(lattice.edges), len(places)
    back = durations(-np.diff(places, axis=0), speed, climb, descend, step)
    lists: list[list[tuple[int, int]]] = [[] for _ in range(own)]
    for n in range(own - 1):
        lists[n].append((nodes + n + 1, int(along[n])))
        lists[n + 1].append((nodes + n, max(int(back[n]), int(along[n]))))
    entries: list[tuple[int, int, int]] = []
    if nodes:
        for n, place in enumerate(places):
            near, spots = nodes_about(lattice, place)
            apart = np.linalg.norm(spots - place, axis=1) > 1e-6
            near, spots = near[apart], np.ascontiguousarray(spots[apart])
            clear = reachable(world, radius, place, spots) == 1
            near, spots = near[clear], spots[clear]
            out = durations(spots - place, speed, climb, descend, step)
            into = durations(place - spots, speed, climb, descend, step)
            lists[n] += zip(near.tolist(), out.tolist(), strict=True)
            entries += zip(near.tolist(), [n + nodes] * len(near), into.tolist(), strict=True)
    entries.sort()
    begins = np.concatenate(([0], np.cumsum([len(one) for one in lists]))).astype(np.int64)
    flat = np.array([pair for one in lists for pair in one], dtype=np.int64).reshape(-1, 2)
    entry = np.array(entries, dtype=np.int64).reshape(-1, 3)
    ahead = np.full(nodes + own, FAR, dtype=np.int64)
    ahead[nodes:] = np.concatenate((np.cumsum(along[::-1])[::-1], [0]))
    if len(entry):
        moves = durations(MOVES * lattice.pitch, speed, climb, descend, step)
        values = ahead[entry[:, 1]] + entry[:, 2]
        ahead[:nodes] = times_to(lattice, MOVES, moves, np.ascontiguousarray(entry[:, 0]), values)
    return Roads(
        places=np.ascontiguousarray(places),
        begins=begins,
        to=np.ascontiguousarray(flat[:, 0]),
        steps=np.ascontiguousarray(flat[:, 1]),
        entry_node=np.ascontiguousarray(entry[:, 0]),
        entry_to=np.ascontiguousarray(entry[:, 1]),
        entry_steps=np.ascontiguousarray(entry[:, 2]),
        ahead=ahead,
    )


def pitch_for(radius: float, downwash: float, extent: Floats, most: float) -> Floats:
    """(3,): a little more than two radii over the ground, as much in the scaled metric in height.

    It is more where there would be more than ``most`` nodes in ``extent``.
    """
    pitch = 2.0 * radius * ROOM * np.array([1.0, 1.0, downwash])
    nodes = float(np.prod(np.maximum(extent / pitch, 1.0)))
    return np.asarray(pitch * max(1.0, (nodes / most) ** (1.0 / (3 if extent[2] > 0.0 else 2))))
