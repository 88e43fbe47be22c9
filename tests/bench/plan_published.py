"""Our plans beside published figures, on scenes made after what the papers say of theirs.

Where starts, goals or obstacles stand is drawn by lot; theirs are not published, so rows are of a kind, not the same;
RSFC's scenes are not told at all and have RBP's room here. The times
are of other machines, and LSC's of one agent's replan: ours are for whole plans, verified.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Floats
from agents.planner.model.scene import Bounds, Cylinder, Obstacle, Scene, Vehicle
from agents.planner.solve import warm
from agents.planner.solve.bound import least_makespan
from agents.planner.solve.pipeline import solve

Ends = tuple[Floats, Floats]


def scattered(
    rng: np.random.Generator, low: Floats, high: Floats, count: int, apart: Floats, off: list[Cylinder], radius: float
) -> Floats:
    """(count, 3): random places, pairwise apart by 1 where x, y, z are measured in ``apart``; clear of cylinders."""
    found: list[Floats] = []
    for _ in range(200_000):
        if len(found) == count:
            return np.array(found).reshape(-1, 3)
        place = rng.uniform(low, high)
        near = found and min(np.linalg.norm((np.array(found) - place) / apart, axis=1)) < 1.0
        if not near and all(np.hypot(*(place[:2] - tree.center)) > tree.radius + radius for tree in off):
            found.append(place)
    raise ValueError(f"no room for {count}")


def scene_of(
    ends: Ends, trees: list[Cylinder], bounds: Bounds, radius: float, vmax: float, amax: float, downwash: float
) -> Scene:
    vehicles = [
        Vehicle(
            id=f"v{i:03}",
            type="copter",
            start=(a[0], a[1], a[2]),
            goal=(b[0], b[1], b[2]),
            radius=radius,
            vmax=vmax,
            amax=amax,
        )
        for i, (a, b) in enumerate(zip(ends[0].tolist(), ends[1].tolist(), strict=True))
    ]
    obstacles: list[Obstacle] = [*trees]
    return Scene(vehicles=vehicles, obstacles=obstacles, bounds=bounds, downwash=downwash, goal_tolerance=0.05)


def box(
    rng: np.random.Generator,
    count: int,
    size: tuple[float, float, float],
    trees: int,
    vmax: float,
    amax: float,
    downwash: float,
) -> Scene:
    """From random places to random places in a room, radius 0.15 m, among round trees of radius 0.3 m."""
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    middles = scattered(rng, low, high * [1, 1, 0], trees, np.array([1.2, 1.2, 1.0]), [], 0.0)
    stems = [Cylinder(center=(x, y), radius=0.3, floor=0.0, ceiling=size[2]) for x, y, _ in middles]
    apart = 0.31 * np.array([1.0, 1.0, downwash])
    ends = [scattered(rng, low, high, count, apart, stems, 0.16) for _ in range(2)]
    return scene_of((ends[0], ends[1]), stems, Bounds(min=tuple(low), max=tuple(high)), 0.15, vmax, amax, downwash)


def circle(
    rng: np.random.Generator, count: int, ring: float, trees: int, radius: float, vmax: float, amax: float
) -> Scene:
    """To the opposite point of a circle, 2 m high, among posts of radius 0.3 m within it."""
    angle = 2.0 * np.pi * np.arange(count) / count
    start = np.stack((ring * np.cos(angle), ring * np.sin(angle), np.full(count, 2.0)), axis=1)
    inner = ring / np.sqrt(2.0) - 1.0
    low, high = np.array([-inner, -inner, 0.0]), np.array([inner, inner, 0.0])
    middles = scattered(rng, low, high, trees, np.array([1.6, 1.6, 1.0]), [], 0.0)
    posts = [Cylinder(center=(x, y), radius=0.3, floor=0.0, ceiling=6.0) for x, y, _ in middles]
    wide = ring + 3.0
    bounds = Bounds(min=(-wide, -wide, 0.5), max=(wide, wide, 6.0))
    return scene_of((start, start * [-1, -1, 1]), posts, bounds, radius, vmax, amax, 1.0)


ROWS: dict[str, tuple[Callable[[np.random.Generator], Scene], str]] = {
    "LSC, 60": (lambda rng: box(rng, 60, (3.0, 3.0, 2.0), 0, 1.0, 2.0, 2.0), "15.5 ms an agent and replan"),
    "RBP, 64": (lambda rng: box(rng, 64, (10.0, 10.0, 2.5), 20, 1.7, 6.2, 2.0), "6.36 s (recalled)"),
    "RSFC, 16": (lambda rng: box(rng, 16, (10.0, 10.0, 2.5), 20, 1.7, 6.2, 2.0), "under 1 s"),
    "RSFC, 64": (lambda rng: box(rng, 64, (10.0, 10.0, 2.5), 0, 1.7, 6.2, 2.0), "under 1 min"),
    "RMADER, 10": (lambda rng: circle(rng, 10, 10.0, 0, 0.125, 10.0, 20.0), "100 % under delay"),
    "HDSM, 10": (lambda rng: circle(rng, 10, 22.0, 180, 0.125, 9.5, 20.0), "100 %"),
}


@click.command()
@click.option("--seeds", default=2, show_default=True)
@click.option("--seconds", default=15.0, show_default=True, help="Budget of each plan.")
def main(seeds: int, seconds: float) -> None:
    """Print the table."""
    warm.warm(planes=False)
    print(f"{'scene':12} {'solved':>7} {'CPU s':>7} {'ms a vehicle':>13} {'ratio':>6}  published")
    for name, (make, published) in ROWS.items():
        times, ratios, count = [], [], 0
        for seed in range(seeds):
            scene = make(np.random.default_rng(seed))
            count, begun = len(scene.vehicles), time.process_time()
            try:
                plan = solve(scene, seconds=seconds)
            except PlanError:
                continue
            times.append(time.process_time() - begun)
            ratios.append(plan.makespan / least_makespan(scene))
        took = statistics.median(times) if times else float("nan")
        ratio = statistics.median(ratios) if ratios else float("nan")
        print(
            f"{name:12} {len(times):3}/{seeds:<3} {took:7.2f} {1e3 * took / count:13.1f} {ratio:6.2f}  {published}",
            flush=True,
        )


if __name__ == "__main__":
    main()
