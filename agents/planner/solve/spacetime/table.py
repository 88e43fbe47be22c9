"""Who is where at which step: motions cut at equal steps of time, filed by place, and exact tests against them.

Everybody's motion is linear within a step, so that the least distance of two within one is that of a straight segment
to a point. The last step stands for all that come after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Ints, MovingObstacle, Problem, places_at
from agents.planner.solve.jit import jit

SPREAD = 9
"""cells, 3 x 3 at most, that one step of a motion is filed in"""
MOST_HEADS = 8_000_000
"""cells times steps: 130 MB; cells are larger where there would be more"""
GONE = 1e7
"""m: the place of those that left"""


class Table(NamedTuple):
    """Bodies are the problem's vehicles and, after them, its movers; A of both."""

    places: Floats
    """(A, K + 1, 3): at the beginning of each step"""
    apart: Floats
    """(A, A): m that two keep from each other, in the scaled metric"""
    reach: Floats
    """(A,): m around a body's step in which another's middle of a step may matter"""
    head: Ints
    """(cells, K): the first entry filed there, -1: none; an entry is body * 16 + the number of its cell"""
    following: Ints
    """(A, K, SPREAD): the entry after each"""
    stir: Ints
    """(cells, K): how many of those filed there move in that step or did in the one before"""
    grid: Floats
    """(3,): least x and y of the cells, their side"""
    shape: Ints
    """(2,): cells along x and y"""
    squeeze: Floats
    """(1,): by which differences of height are divided"""


@jit
def cells_of(table: Table, body: int, k: int) -> tuple[int, int, int, int]:
    """The first and last column and row of cells that a body's step is filed in; none where last < first."""
    p, q, reach, side = table.places[body, k], table.places[body, k + 1], table.reach[body], table.grid[2]
    low_x, high_x = min(p[0], q[0]) - reach, max(p[0], q[0]) + reach
    low_y, high_y = min(p[1], q[1]) - reach, max(p[1], q[1]) + reach
    i0 = max(0, int(np.floor((low_x - table.grid[0]) / side)))
    j0 = max(0, int(np.floor((low_y - table.grid[1]) / side)))
    i1 = min(table.shape[0] - 1, int(np.floor((high_x - table.grid[0]) / side)))
    j1 = min(table.shape[1] - 1, int(np.floor((high_y - table.grid[1]) / side)))
    return i0, j0, min(i1, i0 + 2), min(j1, j0 + 2)


@jit
def moves_at(table: Table, body: int, k: int) -> int:
    """1 where a body moves in step ``k`` or the one before, else 0."""
    a, b, c = table.places[body, max(0, k - 1)], table.places[body, k], table.places[body, k + 1]
    still = a[0] == b[0] == c[0] and a[1] == b[1] == c[1] and a[2] == b[2] == c[2]
    return 0 if still else 1


@jit
def put(table: Table, body: int) -> None:
    """File a body's whole motion."""
    for k in range(table.head.shape[1]):
        i0, j0, i1, j1 = cells_of(table, body, k)
        number, moves = 0, moves_at(table, body, k)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                cell = j * table.shape[0] + i
                table.following[body, k, number] = table.head[cell, k]
                table.head[cell, k] = body * 16 + number
                table.stir[cell, k] += moves
                number += 1


@jit
def take(table: Table, body: int) -> None:
    """Take a body's motion, filed before, out again."""
    for k in range(table.head.shape[1]):
        i0, j0, i1, j1 = cells_of(table, body, k)
        number, moves = 0, moves_at(table, body, k)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                cell, entry = j * table.shape[0] + i, body * 16 + number
                after, at = table.following[body, k, number], table.head[cell, k]
                if at == entry:
                    table.head[cell, k] = after
                else:
                    while table.following[at >> 4, k, at & 15] != entry:
                        at = table.following[at >> 4, k, at & 15]
                    table.following[at >> 4, k, at & 15] = after
                table.stir[cell, k] -= moves
                number += 1


@jit
def least(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """The squared distance from the origin to the segment from a to b."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    length = dx * dx + dy * dy + dz * dz
    share = 0.0
    if length > 0.0:
        share = min(1.0, max(0.0, -(ax * dx + ay * dy + az * dz) / length))
    x, y, z = ax + share * dx, ay + share * dy, az + share * dz
    return x * x + y * y + z * z


@jit
def cell_at(table: Table, x: float, y: float) -> int:
    """The cell a place lies in; -1: none."""
    i = int(np.floor((x - table.grid[0]) / table.grid[2]))
    j = int(np.floor((y - table.grid[1]) / table.grid[2]))
    if i < 0 or j < 0 or i >= table.shape[0] or j >= table.shape[1]:
        return -1
    return j * int(table.shape[0]) + i


@jit
def trouble(
    table: Table,
    weight: Floats,
    body: int,
    k: int,
    px: float,
    py: float,
    pz: float,
    qx: float,
    qy: float,
    qz: float,
) -> float:
    """The weights (A, A) of all that a body would come too near to on its way from p to q within step ``k``."""
    steps = table.head.shape[1]
    k = min(k, steps - 1)
    cell = cell_at(table, (px + qx) / 2.0, (py + qy) / 2.0)
    if cell < 0:
        return 0.0
    entry, total, squeeze = table.head[cell, k], 0.0, table.squeeze[0]
    while entry >= 0:
        other = entry >> 4
        gap = table.apart[body, other]
        p, q = table.places[other, k], table.places[other, k + 1]
        az, bz = (pz - p[2]) / squeeze, (qz - q[2]) / squeeze
        near = other != body and min(az, bz) < gap and max(az, bz) > -gap
        if near and least(px - p[0], py - p[1], az, qx - q[0], qy - q[1], bz) < gap * gap:
            total += weight[body, other]
        entry = table.following[other, k, entry & 15]
    return total


@jit
def troubles(table: Table, body: int, out: Ints) -> int:
    """Count in ``out`` (A,) the steps in which a body is too near to each other one; returns the sum."""
    steps = table.head.shape[1]
    out[:] = 0
    total, squeeze = 0, table.squeeze[0]
    for k in range(steps):
        a, b = table.places[body, k], table.places[body, k + 1]
        cell = cell_at(table, (a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0)
        if cell < 0:
            continue
        entry = table.head[cell, k]
        while entry >= 0:
            other = entry >> 4
            entry = table.following[other, k, entry & 15]
            if other == body:
                continue
            p, q, gap = table.places[other, k], table.places[other, k + 1], table.apart[body, other]
            az, bz = (a[2] - p[2]) / squeeze, (b[2] - q[2]) / squeeze
            if least(a[0] - p[0], a[1] - p[1], az, b[0] - q[0], b[1] - q[1], bz) < gap * gap:
                out[other] += 1
                total += 1
    return total


def empty_table(problem: Problem, step: float, steps: int, area: Floats, fastest: float, margin: float) -> Table:
    """A table with the movers filed and the vehicles not, of ``steps`` steps of ``step`` seconds.

    ``area`` (4,): least and greatest x and y where they will move;
    ``fastest``: m/s of any of them; ``margin``: share of the radii kept on top of these, as far as starts and goals
    leave room for it.
    """
    movers = problem.movers
    count = len(problem) + len(movers)
    places = np.empty((count, steps + 1, 3))
    slack = np.zeros(count)
    for n, mover in enumerate(movers, len(problem)):
        places[n], slack[n] = stepped(mover, step, steps)
    apart = distances(problem, places[len(problem) :, [0, -1]], slack, margin)
    reach = apart.max(axis=1, initial=0.0) + fastest * step / 2.0 + 1e-6
    jumps = np.linalg.norm(np.diff(places[len(problem) :, :, :2], axis=1), axis=2)
    travel = max(fastest * step, float(jumps[jumps < GONE / 2].max(initial=0.0)))
    side = travel / 2.0 + float(reach.max()) + 1e-6
    side = max(side, float(np.sqrt(np.prod(area[2:] - area[:2]) * steps / MOST_HEADS)))
    shape = np.maximum(1, np.ceil((area[2:] - area[:2]) / side)).astype(np.int64)
    table = Table(
        places=places,
        apart=apart,
        reach=reach,
        head=np.full((int(shape.prod()), steps), -1, dtype=np.int64),
        following=np.full((count, steps, SPREAD), -1, dtype=np.int64),
        stir=np.zeros((int(shape.prod()), steps), dtype=np.int64),
        grid=np.array([area[0], area[1], side]),
        shape=shape,
        squeeze=np.array([problem.downwash]),
    )
    for n in range(len(problem), count):
        put(table, n)
    return table


def distances(problem: Problem, movers: Floats, strays: Floats, margin: float) -> Floats:
    """(A, A): what two keep from each other: their radii, how far movers stray, and the margin, less where they begin
    or end nearer than that.

    ``movers`` (M, 2, 3): where each is when the vehicles start, and at last; ``strays`` (A,).
    """
    radii = np.concatenate([problem.radius, [mover.radius for mover in problem.movers]])
    least_of = radii[:, None] + radii[None, :]
    wanted = least_of * (1.0 + margin) + strays[:, None] + strays[None, :]
    for which, ends in enumerate((problem.start, problem.goal)):
        scaled = np.concatenate([ends, movers[:, which]]) / np.array([1.0, 1.0, problem.downwash])
        gaps = np.linalg.norm(scaled[:, None] - scaled[None, :], axis=2)
        wanted = np.minimum(wanted, gaps)
    return np.ascontiguousarray(np.maximum(wanted, least_of) - 1e-6)


def stepped(mover: MovingObstacle, step: float, steps: int) -> tuple[Floats, float]:
    """A mover's places at the beginning of each step, and by how much its motion strays from straight lines between."""
    times: Floats = np.arange(steps + 1, dtype=np.float64) * step
    motion = mover.motion
    places = places_at(motion, times)
    inner = motion[(motion[:, 0] > 0.0) & (motion[:, 0] < times[-1])]
    index = np.minimum((inner[:, 0] / step).astype(np.int64), steps - 1)
    share = (inner[:, 0] / step - index)[:, None]
    straight = places[index] * (1.0 - share) + places[index + 1] * share
    strays = float(np.linalg.norm(straight - inner[:, 1:], axis=1).max(initial=0.0))
    if mover.leaves:
        places[times > motion[-1, 0] + step] = GONE
    return places, strays
