"""Tight places: what the discrete search finds alone.

Motions found, the processor's seconds, and the last arrival over the straight-line bound (at 0.8 of the speeds, so that
1.25 is as good as it gets on a straight way), checked by the exact separation.
"""

from __future__ import annotations

import time

import click
import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.problem import problem_of
from agents.planner.model.separation import all_pairs
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import world_of
from agents.planner.solve.bound import least_makespan
from agents.planner.solve.spacetime.deconflict import find
from tests.agents.planner.generate import CLASSES

SIZES = {
    "gate": (8, 32, 64),
    "gate_opposing": (8, 32, 64),
    "gates": (16, 32),
    "tunnel": (8, 16),
    "shuffle": (64, 128, 256),
    "forest": (64, 128),
    "fence": (32,),
    "fence_u": (32,),
    "crowd": (64,),
}


def found(name: str, n: int, seed: int, seconds: float) -> tuple[float, float] | None:
    """Seconds of the processor and last arrival over the bound; None: nothing, or what is too near."""
    scene = CLASSES[name](n, seed)
    problem, static = problem_of(scene), StaticMap(world_of(scene))
    paths = static.paths_for(problem)
    begun = time.process_time()
    motions = find(problem, static.world, paths, Deadline.after(seconds), np.random.default_rng(seed))
    spent = time.process_time() - begun
    if motions is None:
        return None
    near, _ = all_pairs(motions, problem.radius, [False] * n, problem.downwash, tolerance=0.001)
    return None if len(near) else (spent, max(motion[-1, 0] for motion in motions) / least_makespan(scene))


@click.command()
@click.option("--only", default="", help="Classes, with commas between them.")
@click.option("--seeds", default=1, show_default=True)
@click.option("--seconds", default=20.0, show_default=True, help="Budget of each search.")
def main(only: str, seeds: int, seconds: float) -> None:
    """Print the table."""
    found("gate", 8, 0, seconds)  # compiles
    print(f"{'class':16} {'N':>4} {'found':>7} {'s':>8} {'ratio':>7} {'worst':>7}")
    for name in only.split(",") if only else SIZES:
        for n in SIZES[name]:
            results = [one for seed in range(seeds) if (one := found(name, n, seed, seconds)) is not None]
            spent, ratios = [s for s, _ in results] or [np.nan], [r for _, r in results] or [np.nan]
            middle = f"{np.median(spent):8.2f} {np.median(ratios):7.2f} {max(ratios):7.2f}"
            print(f"{name:16} {n:4} {len(results):3}/{seeds:<3} {middle}", flush=True)


if __name__ == "__main__":
    main()
