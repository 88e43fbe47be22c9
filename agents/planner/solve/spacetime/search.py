"""One vehicle's earliest way among reserved motions: safe-interval path planning, hard or soft.

Phillips and Likhachev, SIPP, ICRA 2011; soft as in Li et al., MAPF-LNS2, AAAI 2022: what cannot be passed is paid for.
A state is a place and a run of steps during which one may, or may not, wait there; within a run the earliest arrival
is as good as any later one that does not cost less.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Ints
from agents.planner.solve.jit import jit
from agents.planner.solve.spacetime.lattice import FAR, Lattice
from agents.planner.solve.spacetime.table import Table, cell_at, trouble

FOREVER = 1 << 40
BLOCKED = 1e8
"""a weight of this much or more is never paid"""
STAY = 60
"""steps that are paid for at most when the goal is not free for good"""


class Roads(NamedTuple):
    """One vehicle's own places beside the lattice: its start (first), its path's vertices, its goal (last).

    They are numbered from the count of the lattice's nodes on.
    """

    places: Floats
    """(E, 3)"""
    begins: Ints
    """(E + 1,): where each place's list of neighbours starts"""
    to: Ints
    """neighbours, of both kinds"""
    steps: Ints
    """steps to each"""
    entry_node: Ints
    """lattice nodes from which one gets to places of its own, ascending"""
    entry_to: Ints
    entry_steps: Ints
    ahead: Ints
    """(nodes + E,): fewest steps to the goal"""


@jit
def spot(lattice: Lattice, roads: Roads, n: int) -> tuple[float, float, float]:
    """Where a place is."""
    count = len(lattice.edges)
    if n >= count:
        p = roads.places[n - count]
        return p[0], p[1], p[2]
    nx, ny, _ = lattice.shape
    origin, pitch = lattice.origin, lattice.pitch
    return origin[0] + n % nx * pitch[0], origin[1] + n // nx % ny * pitch[1], origin[2] + n // (nx * ny) * pitch[2]


@jit
def toll(
    table: Table,
    weight: Floats,
    body: int,
    leave: int,
    steps: int,
    p: tuple[float, float, float],
    q: tuple[float, float, float],
    limit: float,
) -> float:
    """What a straight move costs that leaves at step ``leave``; no more is looked at above ``limit``."""
    total = 0.0
    ax, ay, az = p
    for s in range(steps):
        share = (s + 1.0) / steps
        bx, by, bz = p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])
        total += trouble(table, weight, body, leave + s, ax, ay, az, bx, by, bz)
        if total > limit:
            break
        ax, ay, az = bx, by, bz
    return total


@jit
def neighbours(lattice: Lattice, moves: Ints, steps: Ints, roads: Roads, n: int, to: Ints, takes: Ints) -> int:
    """Write where one gets from place ``n`` and in how many steps; returns how many there are."""
    count, found = len(lattice.edges), 0
    if n >= count:
        for e in range(roads.begins[n - count], roads.begins[n - count + 1]):
            to[found], takes[found] = roads.to[e], roads.steps[e]
            found += 1
        return found
    nx, ny, _ = lattice.shape
    for m in range(26):
        if lattice.edges[n] >> m & 1:
            to[found], takes[found] = n + (moves[m, 2] * ny + moves[m, 1]) * nx + moves[m, 0], steps[m]
            found += 1
    e = int(np.searchsorted(roads.entry_node, n))
    while e < len(roads.entry_node) and roads.entry_node[e] == n:
        to[found], takes[found] = roads.entry_to[e], roads.entry_steps[e]
        found, e = found + 1, e + 1
    return found


@jit
def runs_at(
    table: Table,
    weight: Floats,
    body: int,
    p: tuple[float, float, float],
    begin: int,
    last: int,
    span: Ints,
    cost: Floats,
) -> int:
    """The runs of steps from ``begin`` on at a place, and how many they are.

    Into ``span``: first step, end, earliest arrival looked at, earliest one known; into ``cost``: of a step's wait, and
    what was paid up to the earliest arrival known.
    """
    count, cell, final = 0, cell_at(table, p[0], p[1]), table.head.shape[1] - 1
    for k in range(begin, last + 1):
        now = min(k, final)
        if k > begin and (cell < 0 or table.stir[cell, now] + table.stir[cell, now - 1] == 0):
            continue
        price = trouble(table, weight, body, k, p[0], p[1], p[2], p[0], p[1], p[2])
        if count > 0 and (cost[count - 1, 0] > 0.0) == (price > 0.0):
            cost[count - 1, 0] = max(cost[count - 1, 0], price)
            continue
        if count > 0:
            span[count - 1, 1] = k
        span[count, 0], span[count, 2], span[count, 3] = k, FOREVER, FOREVER
        cost[count, 0], cost[count, 1] = price, np.inf
        count += 1
    span[count - 1, 1] = FOREVER
    return count


@jit
def search(
    table: Table,
    weight: Floats,
    limit: float,
    body: int,
    lattice: Lattice,
    moves: Ints,
    steps: Ints,
    roads: Roads,
    begin: int,
    last: int,
    most: int,
    greed: float,
    pace: float,
    detour: int,
    before: int,
) -> Ints:
    """The way of a body from its start at step ``begin`` to its goal: rows (place, arrival, steps of the move).

    ``last``: nobody else moves from this step on. ``limit``: what may be paid, 0: nothing. ``steps`` (26,): of the
    lattice's moves; ``most`` states are looked at, no more; ``greed``: by how much what is ahead counts more than what
    is behind; ``pace``: m a step; places are left out on whose ways, waits aside, more than ``detour`` steps are spent;
    ``before``: the goal is reached by then. No rows: no way was found. In one piece, because its lists grow on the way.
    """
    count, places = len(lattice.edges), len(lattice.edges) + len(roads.places)
    goal = places - 1
    first = np.full(places, -1, dtype=np.int64)
    span, cost = np.empty((4096, 4), dtype=np.int64), np.empty((4096, 2))
    label, paid, labels = np.empty((4096, 5), dtype=np.int64), np.empty(4096), 1
    waiting = [(0.0, 0)]
    to, takes = np.empty(len(roads.to) + 64, dtype=np.int64), np.empty(len(roads.to) + 64, dtype=np.int64)
    room, popped, home = last - begin + 2, 0, spot(lattice, roads, count)
    # label: place, run, arrival, steps of the move to it, label before
    label[0, 0], label[0, 1], label[0, 2], label[0, 3], label[0, 4] = count, 0, begin, 0, -1
    paid[0] = 0.0
    first[count] = 0
    used = runs_at(table, weight, body, home, begin, last, span, cost) if room < 4096 else 0
    while len(waiting) > 0 and popped < most and room < 4096:
        _, one = heapq.heappop(waiting)
        n, run, arrival = label[one, 0], label[one, 1], label[one, 2]
        if n < 0:
            return unwound(label, label[one, 4])
        if arrival >= span[run, 2]:
            continue
        span[run, 2] = arrival
        popped += 1
        end, price, spent = span[run, 1], cost[run, 0], paid[one]
        p = spot(lattice, roads, n)
        found = neighbours(lattice, moves, steps, roads, n, to, takes)
        if labels + 41 * found + 64 > len(label):
            label = np.concatenate((label, np.empty((len(label) + 41 * found + 64, 5), dtype=np.int64)))
            paid = np.concatenate((paid, np.empty(len(label) - len(paid))))
        if n == goal:
            stay = 0.0 if price == 0.0 else price * min(end - arrival, STAY)
            later = run
            while span[later, 1] != FOREVER:
                later += 1
                stay += 0.0 if cost[later, 0] == 0.0 else cost[later, 0] * min(span[later, 1] - span[later, 0], STAY)
            if stay <= limit:
                label[labels, 0], label[labels, 4] = -1, one
                heapq.heappush(waiting, (spent + stay, labels))
                labels += 1
        if limit > 0.0 and end != FOREVER and price < BLOCKED:
            label[labels, 0], label[labels, 1], label[labels, 2], label[labels, 3] = n, run + 1, end, 0
            label[labels, 4], paid[labels] = one, spent + (end - arrival) * (1.0 + price)
            heapq.heappush(waiting, (paid[labels] + greed * roads.ahead[n], labels))
            labels += 1
        for e in range(found):
            other, takes_e = to[e], takes[e]
            ahead = roads.ahead[other]
            if ahead >= FAR or arrival + takes_e + ahead >= before:
                continue
            q = spot(lattice, roads, other)
            away = ((q[0] - home[0]) ** 2 + (q[1] - home[1]) ** 2 + (q[2] - home[2]) ** 2) ** 0.5
            if away / pace + ahead > detour:
                continue
            if first[other] < 0:
                if used + room > len(span):
                    span = np.concatenate((span, np.empty((len(span) + room, 4), dtype=np.int64)))
                    cost = np.concatenate((cost, np.empty((len(span) - len(cost), 2))))
                first[other] = used
                used += runs_at(table, weight, body, q, begin, last, span[used:], cost[used:])
            # The earliest free passage into each run in which one may wait.
            at, opened = first[other], 0
            while price == 0.0 and opened < 40:
                low, high = max(span[at, 0], arrival + takes_e), min(span[at, 1], end + takes_e)
                known = low >= span[at, 3] and spent + low - arrival >= cost[at, 1]
                if cost[at, 0] == 0.0 and low <= high and not known and span[at, 2] > low:
                    leave, until = low - takes_e, min(high - takes_e, max(last, low - takes_e))
                    while leave <= until and toll(table, weight, body, leave, takes_e, p, q, 0.0) > 0.0:
                        leave += 1
                    charge = spent + leave + takes_e - arrival
                    if leave <= until and (leave + takes_e < span[at, 3] or charge < cost[at, 1]):
                        if leave + takes_e < span[at, 3]:
                            span[at, 3], cost[at, 1] = leave + takes_e, charge
                        label[labels, 0], label[labels, 1], label[labels, 2] = other, at, leave + takes_e
                        label[labels, 3], label[labels, 4] = takes_e, one
                        paid[labels] = charge
                        heapq.heappush(waiting, (paid[labels] + greed * ahead, labels))
                        labels, opened = labels + 1, opened + 1
                if span[at, 1] == FOREVER or span[at + 1, 0] > end + takes_e:
                    break
                at += 1
            # At once, for its price.
            if limit > 0.0 or price > 0.0:
                at = first[other]
                while span[at, 1] <= arrival + takes_e:
                    at += 1
                if span[at, 2] > arrival + takes_e:
                    charge = toll(table, weight, body, arrival, takes_e, p, q, limit)
                    if charge <= limit and (charge > 0.0 or price > 0.0 or cost[at, 0] > 0.0):
                        label[labels, 0], label[labels, 1], label[labels, 2] = other, at, arrival + takes_e
                        label[labels, 3], label[labels, 4] = takes_e, one
                        paid[labels] = spent + takes_e + charge
                        heapq.heappush(waiting, (paid[labels] + greed * ahead, labels))
                        labels += 1
    return np.empty((0, 3), dtype=np.int64)


@jit
def unwound(label: Ints, one: int) -> Ints:
    """The rows from the first label to this one."""
    count, at = 0, one
    while at >= 0:
        count, at = count + 1, label[at, 4]
    rows, at = np.empty((count, 3), dtype=np.int64), one
    for row in range(count - 1, -1, -1):
        rows[row, 0], rows[row, 1], rows[row, 2] = label[at, 0], label[at, 2], label[at, 3]
        at = label[at, 4]
    return rows


@jit
def lay(rows: Ints, lattice: Lattice, roads: Roads, places: Floats) -> None:
    """Write the places at the beginning of each step, (K + 1, 3), of a way found by :func:`search`."""
    steps = len(places)
    x, y, z = spot(lattice, roads, rows[0, 0])
    now = 0
    for row in range(len(rows)):
        p = spot(lattice, roads, rows[row, 0])
        leave, takes = rows[row, 1] - rows[row, 2], rows[row, 2]
        while now <= min(leave, steps - 1):
            places[now, 0], places[now, 1], places[now, 2] = x, y, z
            now += 1
        for s in range(1, takes + 1):
            if now < steps:
                share = s / takes
                places[now, 0], places[now, 1], places[now, 2] = (
                    x + share * (p[0] - x),
                    y + share * (p[1] - y),
                    z + share * (p[2] - z),
                )
                now += 1
        x, y, z = p
    places[now:, 0], places[now:, 1], places[now:, 2] = x, y, z
