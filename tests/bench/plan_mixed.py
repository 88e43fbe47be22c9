"""Copters, rovers and planes together, and planes alone: how long a verified plan takes, and how good it is.

    python -m tests.bench.plan_mixed [--seeds 3]

For each size: verified plans among the scenes, the median and the longest time to one, the makespan over the
straight-line bound, and the part of the time that the planes take.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from agents.planner.model.errors import PlanError
from agents.planner.model.problem import PLANE, problem_of
from agents.planner.model.scene import Scene
from agents.planner.model.world import world_of
from agents.planner.solve.pipeline import solve
from agents.planner.solve.planes import plan_planes
from tests.agents.planner import generate

SIZES = ((12, 2, 4), (24, 4, 8), (40, 8, 10), (60, 10, 10))
"""vehicles, of them planes, of them rovers"""


def planes_alone(scene: Scene) -> float:
    """Seconds for the planes of a scene."""
    problem, world = problem_of(scene), world_of(scene)
    start = time.perf_counter()
    plan_planes(problem, world, np.flatnonzero(problem.kind == PLANE).tolist(), np.random.default_rng(0))
    return time.perf_counter() - start


def row(n: int, planes: int, rovers: int, seeds: int) -> str:
    times, shares, ratios, failed = [], [], [], []
    for seed in range(seeds):
        scene = generate.mixed(n, seed, planes=planes, rovers=rovers)
        start = time.perf_counter()
        try:
            plan = solve(scene)
        except PlanError as e:
            failed.append(f"{seed}: {e.kind} {', '.join(e.ids[:4])}")
        else:
            bound = (scene.lower_bound or {}).get("makespan", float("nan"))
            ratios.append(plan.makespan / bound)
        times.append(time.perf_counter() - start)
        shares.append(planes_alone(scene))
    best = f"{statistics.median(ratios):5.2f} {max(ratios):5.2f}" if ratios else "    -     -"
    figures = f"{statistics.median(times):7.2f} {max(times):7.2f}   {best}   {statistics.median(shares):7.3f}"
    return f"{n:4d} {planes:4d} {rovers:4d}   {seeds - len(failed)}/{seeds}   {figures}   {'; '.join(failed)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=2)
    seeds = parser.parse_args().seeds
    solve(generate.mixed(6, 99))  # whatever must be compiled
    print("   N planes rovers  ok    median s  max s   ratio   max   planes s")
    for sizes in SIZES:
        print(row(*sizes, seeds), flush=True)


if __name__ == "__main__":
    main()
