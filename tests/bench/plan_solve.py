"""Plans of every class of scene against the number of vehicles: success, time, and makespan over its bound.

Each scene is planned in one process with its kernels compiled; ``cold`` has a new map, ``warm`` the map of the first
run. ``ratio``: makespan over the longest straight way flown with full speed and acceleration. A plan counts when an
independent checker passes it.
"""

from __future__ import annotations

import statistics
import time

import click
import msgspec
import numpy as np

from agents.planner.model.errors import PlanError
from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan
from agents.planner.model.problem import problem_of
from agents.planner.model.scene import Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.solve.pipeline import solve
from agents.planner.solve.refine.knots import durations
from tests.agents.planner.checker import check
from tests.agents.planner.generate import CLASSES, as_json

SIZES = {
    "swap_circle": (8, 16, 32, 64, 128, 200, 400),
    "swap_sphere": (8, 32, 128),
    "swap_field": (16, 64, 128, 256),
    "shuffle": (16, 64, 128),
    "crowd": (20, 60),
    "formation": (16, 64, 256),
    "formation_sphere": (64, 256),
    "formation_labelled": (16, 64, 256),
    "formation_vee": (9, 64),
    "forest": (16, 64, 128),
    "gate": (8, 16, 40),
    "gate_opposing": (8, 16, 40),
    "gates": (8, 20),
    "windows": (6, 8, 12, 16, 24, 40),
    "tunnel": (8, 16),
    "city": (10, 20, 50, 100),
    "fence": (10, 40),
    "fence_u": (10, 40),
    "fence_layers": (10, 40),
    "mixed": (12, 30),
}


def bound(scene: Scene) -> float:
    """s that the slowest to its goal needs in a straight line; unlabelled: at the earliest to any of them."""
    problem = problem_of(scene, list(range(len(scene.goals or []))) if scene.assignment == "unlabelled" else None)
    if scene.assignment == "unlabelled":
        from agents.planner.solve.assign import bottleneck, costs

        return bottleneck(costs(scene, world_of(Scene(vehicles=[], bounds=scene.bounds)), problem.goal)[0])
    return float(durations(problem, [np.array(ends) for ends in zip(problem.start, problem.goal, strict=True)]).max())


def measure(scene: Scene, seconds: float | None) -> tuple[Plan | PlanError, float, float]:
    """The plan, and seconds of the processor cold and warm."""
    world = world_of(scene)
    begun = time.process_time()
    static = StaticMap(world)
    try:
        plan = solve(scene, static=static, seconds=seconds)
    except PlanError as e:
        return e, time.process_time() - begun, 0.0
    cold = time.process_time() - begun
    begun = time.process_time()
    solve(scene, static=static, seconds=seconds)
    return plan, cold, time.process_time() - begun


@click.command()
@click.option("--only", default="", help="Classes, with commas between them.")
@click.option("--sizes", default="", help="Numbers of vehicles, instead of each class's own.")
@click.option("--seeds", default=1, show_default=True)
@click.option("--seconds", type=float, default=None, help="Budget of each plan.")
def main(only: str, sizes: str, seeds: int, seconds: float | None) -> None:
    """Print the table."""
    solve(CLASSES["city"](4))  # compiles
    solve(CLASSES["mixed"](6))
    print(f"{'class':20} {'N':>4} {'solved':>7} {'cold s':>8} {'warm s':>8} {'ratio':>7} {'worst':>7}")
    for name in only.split(",") if only else SIZES:
        for n in [int(s) for s in sizes.split(",")] if sizes else SIZES[name]:
            colds, warms, ratios, notes = [], [], [], []
            for seed in range(seeds):
                scene = CLASSES[name](n, seed)
                plan, cold, warm = measure(scene, seconds)
                colds.append(cold)
                if isinstance(plan, PlanError):
                    notes.append(f"{seed}: {plan.kind} {plan.ids[:4]}")
                    continue
                faults = check(as_json(scene), msgspec.to_builtins(plan))
                if faults:
                    notes.append(f"{seed}: {sorted(faults)[:2]}")
                    continue
                warms.append(warm)
                ratios.append(plan.makespan / bound(scene))
            warm_text = (
                f"{statistics.median(warms):8.2f} {statistics.median(ratios):7.3f} {max(ratios):7.3f}" if warms else ""
            )
            print(
                f"{name:20} {n:4} {len(warms):3}/{seeds:<3} {statistics.median(colds):8.2f} {warm_text}",
                *notes,
                flush=True,
            )


if __name__ == "__main__":
    main()
