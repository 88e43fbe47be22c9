"""Tight places: what the discrete search finds alone, and one vehicle's repair among all others.

First table: motions found, the processor's seconds, and the last arrival over the straight-line bound (at 0.8 of the
speeds, so that 1.25 is as good as it gets on a straight way), checked by the exact separation. Second: seconds of the
processor until one vehicle that has stopped on its way, where it may stand for a second, has a new motion among the
others', which are as they were.
"""

from __future__ import annotations

import time
from dataclasses import replace

import click
import numpy as np

from agents.planner.model.problem import Motion, Problem, problem_of
from agents.planner.model.separation import all_pairs
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import world_of
from agents.planner.solve.bound import least_makespan
from agents.planner.solve.spacetime import find, repair
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
    motions = find(problem, static.world, paths, seconds, np.random.default_rng(seed))
    spent = time.process_time() - begun
    if motions is None:
        return None
    near, _ = all_pairs(motions, problem.radius, [False] * n, problem.downwash, tolerance=0.001)
    return None if len(near) else (spent, max(motion[-1, 0] for motion in motions) / least_makespan(scene))


def repairs(name: str, n: int, times: int) -> list[float]:
    """Seconds of the processor of each repair; inf: none was found."""
    scene = CLASSES[name](n, 0)
    problem, static = problem_of(scene), StaticMap(world_of(scene))
    rng = np.random.default_rng(0)
    motions = find(problem, static.world, static.paths_for(problem), 30.0, rng)
    spent: list[float] = []
    while motions is not None and len(spent) < times:
        i = int(rng.integers(n))
        when = float(rng.uniform(0.2, 0.8)) * float(motions[i][-1, 0])
        moved, halted = stopped(problem, motions, i, when)
        if not may_stand(problem, halted, i, when):
            continue
        begun = time.process_time()
        path = static.path(moved.start[i], moved.goal[i], float(problem.radius[i]))
        if path is None:
            raise click.ClickException(f"{name}: no way from {moved.start[i]}")
        again = repair(moved, static.world, halted, [i], [path], 2.0, rng, begin=when)
        spent.append(time.process_time() - begun if again is not None else np.inf)
    return spent


def stopped(problem: Problem, motions: list[Motion], i: int, when: float) -> tuple[Problem, list[Motion]]:
    """The problem and motions when vehicle ``i`` stands where it is at ``when``."""
    place = [np.interp(when, motions[i][:, 0], motions[i][:, axis]) for axis in (1, 2, 3)]
    start = problem.start.copy()
    start[i] = place
    halted = list(motions)
    halted[i] = np.array([[0.0, *place]])
    return replace(problem, start=start), halted


def may_stand(problem: Problem, motions: list[Motion], i: int, when: float) -> bool:
    """Whether no other comes too near to where vehicle ``i`` stands within a second."""
    times = when + np.arange(0.0, 1.0, 0.02)
    scale = np.array([1.0, 1.0, 1.0 / problem.downwash])
    for j, motion in enumerate(motions):
        places = np.stack([np.interp(times, motion[:, 0], motion[:, axis]) for axis in (1, 2, 3)], axis=1)
        gap = np.linalg.norm((places - motions[i][0, 1:]) * scale, axis=1).min()
        if j != i and gap < problem.radius[i] + problem.radius[j]:
            return False
    return True


@click.command()
@click.option("--only", default="", help="Classes, with commas between them.")
@click.option("--seeds", default=1, show_default=True)
@click.option("--seconds", default=20.0, show_default=True, help="Budget of each search.")
@click.option(
    "--repairs", "times", default=60, show_default=True, help="Of one vehicle, in each of three scenes of 20."
)
def main(only: str, seeds: int, seconds: float, times: int) -> None:
    """Print both tables."""
    found("gate", 8, 0, seconds)  # compiles
    print(f"{'class':16} {'N':>4} {'found':>7} {'s':>8} {'ratio':>7} {'worst':>7}")
    for name in only.split(",") if only else SIZES:
        for n in SIZES[name]:
            results = [one for seed in range(seeds) if (one := found(name, n, seed, seconds)) is not None]
            spent, ratios = [s for s, _ in results] or [np.nan], [r for _, r in results] or [np.nan]
            middle = f"{np.median(spent):8.2f} {np.median(ratios):7.2f} {max(ratios):7.2f}"
            print(f"{name:16} {n:4} {len(results):3}/{seeds:<3} {middle}", flush=True)
    print(f"\n{'repair of one':16} {'N':>4} {'found':>7} {'p50 ms':>8} {'p99 ms':>8}")
    for name in ("swap_field", "gate_opposing", "city"):
        taken = np.array(repairs(name, 20, times))
        done = 1000.0 * taken[np.isfinite(taken)]
        middle = f"{np.percentile(done, 50):8.1f} {np.percentile(done, 99):8.1f}" if len(done) else ""
        print(f"{name:16} {20:4} {len(done):3}/{times:<3} {middle}", flush=True)


if __name__ == "__main__":
    main()
