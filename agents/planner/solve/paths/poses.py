"""A plane's way among obstacles: A* over poses on a lattice of places, headings and heights, then shortened.

Steps are straight lines and arcs of the turn radius, level, climbing or descending (hybrid A* after Dolgov and others,
2008). From the poses reached, a Dubins way straight to the goal is tried. What is found is shortened by Dubins ways
between its poses.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from agents.planner.model.geometry import away
from agents.planner.model.problem import Floats, Ints
from agents.planner.model.world import World
from agents.planner.solve.jit import jit
from agents.planner.solve.paths.dubins import POINT_WORDS, WORDS, advance, between, shortest_to_point, to_point
from agents.planner.solve.paths.flight import Wings, way_clear

HEADINGS = 18
EAGER = 1.5
"""how much more the rest of the way counts than what is behind: a way a little longer, found much sooner"""
MOST_STATES = 8_000_000
MOST_POPPED = 20_000
"""poses looked at; five times as many for the tightest turn, for a plane that finds no way even so has none"""
TRIES = 100
"""pairs of poses between which a shorter way is looked for"""


@jit
def _search(
    world: World,
    posts: Floats,
    squash: float,
    pose: Floats,
    goal: Floats,
    radius: float,
    turn: float,
    up: float,
    down: float,
    grid: Floats,
    most: int,
) -> Floats:
    """Legs to the goal; no rows: none found. ``grid``: least x, y, z, sides of a cell over the ground and in height,
    cells along x, y and z. ``up``, ``down``: m of height a m over the ground.
    """
    nx, ny, nz = int(grid[5]), int(grid[6]), int(grid[7])
    field = _field(world, grid, goal)
    seen = np.zeros(nx * ny * nz * HEADINGS, dtype=np.bool_)
    step = turn * 2.0 * math.pi / HEADINGS
    poses, came = np.empty((1024, 5)), np.empty((1024, 2), dtype=np.int64)
    poses[0, :4], poses[0, 4], came[0] = pose, 0.0, -1
    count, popped = 1, 0
    leg, legs = np.empty((1, 3)), np.empty((2, 3))
    flat = np.empty((2, 2))
    heap = [(0.0, 0)]
    while len(heap) > 0 and popped < most:
        _, k = heapq.heappop(heap)
        x, y, z, heading, cost = poses[k]
        cell = _cell(grid, nx, ny, nz, x, y, z, heading)
        if seen[cell]:
            continue
        seen[cell] = True
        popped += 1
        rise = goal[2] - z
        away = math.hypot(goal[0] - x, goal[1] - y)
        if popped % 4 == 1 or away < 4.0 * turn:
            best = np.inf
            for word in range(POINT_WORDS):
                length = to_point(x, y, heading, goal[0], goal[1], turn, word, flat)
                if length >= best or rise > up * length or -rise > down * length:
                    continue
                for n in range(2):
                    legs[n, 0], legs[n, 1], legs[n, 2] = flat[n, 0], flat[n, 1], rise * flat[n, 1] / length
                if way_clear(world, posts, squash, poses[k, :4], legs, radius):
                    best, last = length, legs.copy()
            if best < np.inf:
                return _legs_to(came, k, turn, step, up, down, last)
        for move in range(9):
            bend, climb = move % 3 - 1, (move // 3 + 1) % 3 - 1  # level ones first
            high = step * (up if climb > 0 else down) * climb
            leg[0, 0], leg[0, 1], leg[0, 2] = bend / turn, step, high
            px, py, ph = advance(x, y, heading, leg[0, 0], step)
            cell = _cell(grid, nx, ny, nz, px, py, z + high, ph)
            if cell < 0 or seen[cell] or not way_clear(world, posts, squash, poses[k, :4], leg, radius):
                continue
            if count == len(poses):
                poses = np.concatenate((poses, np.empty_like(poses)))
                came = np.concatenate((came, np.empty_like(came)))
            paid = cost + step * (1.0 + 0.05 * abs(bend) + 0.05 * abs(climb))
            poses[count, 0], poses[count, 1], poses[count, 2] = px, py, z + high
            poses[count, 3], poses[count, 4] = ph, paid
            came[count, 0], came[count, 1] = k, move
            rest = goal[2] - z - high
            left = max(shortest_to_point(px, py, ph, goal[0], goal[1], turn), rest / up, -rest / down)
            left = max(left, field[_at(grid, nx, px, py)])
            if left == np.inf:
                continue
            heapq.heappush(heap, (paid + EAGER * left, count))
            count += 1
    return np.empty((0, 3))


@jit
def _at(grid: Floats, nx: int, x: float, y: float) -> int:
    column, row = math.floor((x - grid[0]) / grid[3]), math.floor((y - grid[1]) / grid[3])
    return int(row * nx + column)


@jit
def _field(world: World, grid: Floats, goal: Floats) -> Floats:
    """No more than the metres over the ground to the goal from each cell, around what is too high to fly over."""
    nx, ny, nz, side = int(grid[5]), int(grid[6]), int(grid[7]), grid[3]
    blocked, out = np.ones(nx * ny, dtype=np.bool_), np.empty(3)
    for n in range(nx * ny):
        for part in range(5 * nz):  # the middle of the cell at all heights, and then four places around it
            corner = part // nz - 1
            x = grid[0] + (n % nx + 0.5 + (0.0 if corner < 0 else 0.35 * (2 * (corner % 2) - 1))) * side
            y = grid[1] + (n // nx + 0.5 + (0.0 if corner < 0 else 0.35 * (2 * (corner // 2) - 1))) * side
            if away(world, x, y, grid[2] + (part % nz + 0.5) * grid[4], 0.0, out) <= 0.0:
                blocked[n] = False
                break
    field = np.full(nx * ny, np.inf)
    start = _at(grid, nx, goal[0], goal[1])
    field[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        far, n = heapq.heappop(heap)
        if far > field[n]:
            continue
        for move in range(9):
            i, j = n % nx + move % 3 - 1, n // nx + move // 3 - 1
            if move == 4 or i < 0 or j < 0 or i >= nx or j >= ny or blocked[j * nx + i]:
                continue
            further = far + side * math.hypot(move % 3 - 1.0, move // 3 - 1.0)
            if further < field[j * nx + i]:
                field[j * nx + i] = further
                heapq.heappush(heap, (further, j * nx + i))
    for n in range(nx * ny):  # along the grid it is up to 8 % longer, and both may be anywhere in their cells
        field[n] = max(0.0, 0.92 * field[n] - 1.5 * side)
    return field


@jit
def _cell(grid: Floats, nx: int, ny: int, nz: int, x: float, y: float, z: float, heading: float) -> int:
    """The number of the state's cell; -1 beyond the grid."""
    i, j = math.floor((x - grid[0]) / grid[3]), math.floor((y - grid[1]) / grid[3])
    k = math.floor((z - grid[2]) / grid[4])
    if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
        return -1
    h = round(heading / (2.0 * math.pi) * HEADINGS) % HEADINGS
    return int(((k * ny + j) * nx + i) * HEADINGS + h)


@jit
def _legs_to(came: Ints, k: int, turn: float, step: float, up: float, down: float, last: Floats) -> Floats:
    """The legs of the steps that led to pose ``k``, and the last ones."""
    steps = 0
    n = k
    while came[n, 0] >= 0:
        n, steps = came[n, 0], steps + 1
    legs = np.empty((steps + len(last), 3))
    legs[steps:] = last
    while came[k, 0] >= 0:
        steps -= 1
        bend, climb = came[k, 1] % 3 - 1, (came[k, 1] // 3 + 1) % 3 - 1
        legs[steps, 0], legs[steps, 1] = bend / turn, step
        legs[steps, 2] = step * (up if climb > 0 else down) * climb
        k = came[k, 0]
    return legs


def find(
    world: World,
    posts: Floats,
    squash: float,
    pose: Floats,
    goal: Floats,
    wings: Wings,
    turn: float,
    rng: np.random.Generator,
) -> Floats | None:
    """Legs (K, 3) from a pose (x, y, z, heading) to a place, any heading there, turning with radius ``turn`` and clear
    of everything; None where there are none, as far as this lattice can tell.
    """
    up, down = 0.9 * wings.slope(1.0), 0.9 * wings.slope(-1.0)
    step = turn * 2.0 * math.pi / HEADINGS
    low, high = world.bounds[:3], world.bounds[3:]
    side, layer = 0.5 * step, max(0.95 * step * min(up, down), 1.0)
    while True:
        cells = np.ceil((high - low) / (side, side, layer)) + 1.0
        if np.prod(cells) * HEADINGS <= MOST_STATES:
            break
        side, layer = 1.3 * side, 1.3 * layer
    grid = np.array([*low, side, layer, *cells])
    legs = _search(
        world,
        posts,
        squash,
        pose,
        goal,
        wings.radius,
        turn,
        up,
        down,
        grid,
        (5 if turn <= 1.001 * wings.tightest else 1) * MOST_POPPED,
    )
    if len(legs) == 0:
        return None
    return shorten(world, posts, squash, pose, legs, wings, turn, rng)


def poses_of(pose: Floats, legs: Floats) -> Floats:
    """(K + 1, 4): the poses between legs, first and last included."""
    poses = np.empty((len(legs) + 1, 4))
    poses[0] = pose
    for k, (curvature, length, rise) in enumerate(legs):
        x, y, z, heading = poses[k]
        poses[k + 1, [0, 1, 3]] = advance(x, y, heading, curvature, length)
        poses[k + 1, 2] = z + rise
    return poses


def shorten(
    world: World,
    posts: Floats,
    squash: float,
    pose: Floats,
    legs: Floats,
    wings: Wings,
    turn: float,
    rng: np.random.Generator,
) -> Floats:
    """A way no longer than this one with the same ends (the last heading is free), as clear."""
    for attempt in range(TRIES):
        poses = poses_of(pose, legs)
        count = len(legs)
        i = attempt if attempt < count else int(rng.integers(count))
        to_end = attempt < count or count - i < 2 or rng.random() < 0.3
        j = count if to_end else int(rng.integers(i + 1, count))
        old = legs[i:j, 1].sum()
        for word in range(POINT_WORDS if j == count else WORDS):
            new = join(poses[i], poses[j], turn, word, free=j == count)
            if new is None or new[:, 1].sum() > old - 0.1 or not gentle(new, wings):
                continue
            if way_clear(world, posts, squash, poses[i], new, wings.radius):
                legs = np.concatenate((legs[:i], new, legs[j:]))
                break
    return legs


def join(start: Floats, end: Floats, turn: float, word: int, *, free: bool) -> Floats | None:
    """The legs of one word between poses (``free``: whatever the heading at the end), the rise spread evenly."""
    flat = np.empty((2, 2)) if free else np.empty((3, 2))
    if free:
        length = to_point(start[0], start[1], start[3], end[0], end[1], turn, word, flat)
    else:
        length = between(start[0], start[1], start[3], end[0], end[1], end[3], turn, word, flat)
    if not math.isfinite(length):
        return None
    flat = flat[flat[:, 1] > 1e-6]
    rise = (end[2] - start[2]) * flat[:, 1] / max(length, 1e-9)
    return np.ascontiguousarray(np.column_stack((flat, rise)))


def gentle(legs: Floats, wings: Wings) -> bool:
    """Whether no leg climbs or descends more than the plane can at its least speed."""
    slopes = legs[:, 2] / np.maximum(legs[:, 1], 1e-9)
    return bool(np.all(slopes <= 0.95 * wings.slope(1.0)) and np.all(slopes >= -0.95 * wings.slope(-1.0)))
