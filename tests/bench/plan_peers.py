"""The planner beside what a user would pick today, on the same scenes in one run: pymapf and pyrvo.

    python tests/bench/plan_peers.py [8 16 32 64 128] [--seeds 3]

Copters stand on a lattice of 3 m in one plane, among pillars, and change places at random. pymapf (PIBT, LaCAM,
CBS) moves points from cell to cell; its steps are flown from rest to rest, which is what holds the acceleration. pyrvo
(ORCA) steers discs at 10 Hz; its velocities are followed as fast as the acceleration allows. Ours has the same plane,
and a few metres above and below. Everyone is judged by the same separation: of points in motion, at every instant.
"""

from __future__ import annotations

import argparse
import itertools
import math
import random
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import pymapf
import pyrvo
from rich.console import Console
from rich.table import Table

from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Floats
from agents.planner.model.scene import Bounds, Cylinder, Obstacle, Scene, Vehicle
from agents.planner.model.separation import closest
from agents.planner.solve.pipeline import solve

CELL, RADIUS, SPEED, ACCEL, HEIGHT = 3.0, 1.0, 5.0, 2.5, 20.0
STEP = 2.0 * math.sqrt(CELL / ACCEL)
"""s from rest to rest over one cell"""
PATIENCE = 10.0
"""s that a search may take"""
Cells = list[tuple[int, int]]
Found = list[Floats] | None


def scene_of(count: int, seed: int) -> tuple[Scene, list[list[int]], Cells, Cells]:
    """A square lattice a third full of copters, one cell in twelve a pillar; and the same as a grid."""
    rng = random.Random(seed)
    size = math.ceil(math.sqrt(3 * count)) + 2
    cells = [(r, c) for r in range(size) for c in range(size)]
    pillars = rng.sample(cells, k=size * size // 12)
    free = [cell for cell in cells if cell not in pillars and _degree(cell, size, pillars) > 2]
    starts = rng.sample(free, k=count)
    goals = starts[:]
    rng.shuffle(goals)
    grid = [[int((r, c) in pillars) for c in range(size)] for r in range(size)]
    vehicles = [
        Vehicle(
            id=f"v{i:03}", type="copter", start=place(start), goal=place(goal), radius=RADIUS, vmax=SPEED, amax=ACCEL
        )
        for i, (start, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    trees: list[Obstacle] = [Cylinder(center=place(cell)[:2], radius=0.4, floor=0.0, ceiling=60.0) for cell in pillars]
    far = CELL * size + 3.0
    bounds = Bounds(min=(-far / 4, -far / 4, HEIGHT - 12.0), max=(1.25 * far, 1.25 * far, HEIGHT + 12.0))
    return Scene(vehicles=vehicles, obstacles=trees, bounds=bounds, downwash=1.5), grid, starts, goals


def _degree(cell: tuple[int, int], size: int, pillars: Cells) -> int:
    r, c = cell
    around = [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
    return sum(0 <= x < size and 0 <= y < size and (x, y) not in pillars for x, y in around)


def place(cell: tuple[int, int]) -> tuple[float, float, float]:
    return CELL * cell[0], CELL * cell[1], HEIGHT


def ours(scene: Scene, grid: list[list[int]], starts: Cells, goals: Cells) -> Found:
    try:
        plan = solve(scene, seconds=PATIENCE * 3)
    except PlanError:
        return None
    return [np.array(plan.trajectories[v.id]) for v in scene.vehicles]


def mapf(name: str) -> Callable[[Scene, list[list[int]], Cells, Cells], Found]:
    def search(scene: Scene, grid: list[list[int]], starts: Cells, goals: Cells) -> Found:
        agents = [pymapf.Agent(v.id, start, goal) for v, start, goal in zip(scene.vehicles, starts, goals, strict=True)]
        problem = pymapf.MAPFProblem(pymapf.GridMap(grid), agents)
        solution = pymapf.solve(problem, name, time_limit=PATIENCE)
        if solution is None or not solution.is_valid():
            return None
        if any(solution.paths[a.name][-1] != a.goal for a in agents):
            return None
        return [np.array([(k * STEP, *place(cell)) for k, cell in enumerate(solution.paths[a.name])]) for a in agents]

    return search


def orca(scene: Scene, grid: list[list[int]], starts: Cells, goals: Cells) -> Found:
    """None where somebody has not arrived after ten times the straight way."""
    dt = 0.1
    sim = pyrvo.RVOSimulator(dt, 15.0, 10, 5.0, 3.0, RADIUS, SPEED)
    for cell in starts:
        sim.add_agent(place(cell)[:2])
    for tree in scene.obstacles:
        if isinstance(tree, Cylinder):
            (x, y), r = tree.center, tree.radius
            corners = [(x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r)]
            sim.add_obstacle(corners)
    sim.process_obstacles()
    pos = np.array([place(cell)[:2] for cell in starts])
    vel, goal = np.zeros_like(pos), np.array([place(cell)[:2] for cell in goals])
    tracks = [pos.copy()]
    steps = int(10 * (np.linalg.norm(goal - pos, axis=1).max() / SPEED + 2.0) / dt)
    for _ in range(steps):
        way = goal - pos
        away = np.linalg.norm(way, axis=1)
        if away.max() < 0.3:
            times = np.arange(len(tracks)) * dt
            return [
                np.column_stack([times, [t[i] for t in tracks], np.full(len(tracks), HEIGHT)]) for i in range(len(pos))
            ]
        speed = np.minimum(SPEED, np.sqrt(2.0 * ACCEL * away) * 0.8)
        wanted = way / np.maximum(away, 1e-9)[:, None] * speed[:, None]
        for i, w in enumerate(wanted):
            sim.set_agent_pref_velocity(i, tuple(w))
            sim.set_agent_position(i, tuple(pos[i]))
            sim.set_agent_velocity(i, tuple(vel[i]))
        sim.do_step()
        asked = np.array([(v.x, v.y) for v in map(sim.get_agent_velocity, range(len(pos)))])
        change = asked - vel
        size = np.maximum(np.linalg.norm(change, axis=1), 1e-9)
        vel = vel + change * np.minimum(1.0, ACCEL * dt / size)[:, None]
        pos = pos + vel * dt
        tracks.append(pos.copy())
    return None


SIDES = {
    "zmav": ours,
    "pymapf PIBT": mapf("pibt"),
    "pymapf LaCAM": mapf("lacam"),
    "pymapf CBS": mapf("cbs"),
    "pyrvo": orca,
}


def bound(scene: Scene) -> float:
    """s for the longest straight way from rest to rest."""
    longest = max(math.dist(v.start, v.goal or v.start) for v in scene.vehicles)
    return longest / SPEED + SPEED / ACCEL if longest > SPEED**2 / ACCEL else 2.0 * math.sqrt(longest / ACCEL)


def apart(motions: list[Floats]) -> float:
    """The least distance of any two, m, in the scene's metric."""
    return min(closest(a, b, 1 / 1.5, 0.0, math.inf)[0] for a, b in itertools.combinations(motions, 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("counts", nargs="*", type=int, default=[8, 16, 32, 64])
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    solve(scene_of(4, 0)[0])  # compiles what is not compiled yet
    table = Table("N", "planner", "solved", "time s", "makespan / bound", "least separation m", box=None)
    for count in args.counts:
        for name, side in SIDES.items():
            times, ratios, gaps, solved = [], [], [], 0
            for seed in range(args.seeds):
                scene, grid, starts, goals = scene_of(count, seed)
                begun = time.perf_counter()
                found = side(scene, grid, starts, goals)
                times.append(time.perf_counter() - begun)
                if found is not None:
                    solved += 1
                    ratios.append(max(m[-1, 0] for m in found) / bound(scene))
                    gaps.append(apart(found))
            ratio = f"{statistics.median(ratios):.2f}" if ratios else "-"
            gap = f"{min(gaps):.2f}" if gaps else "-"
            table.add_row(str(count), name, f"{solved}/{args.seeds}", f"{statistics.median(times):.3f}", ratio, gap)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
