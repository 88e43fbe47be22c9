"""The missions of LSC, as its authors published them, planned, verified, and printed beside their figures.

    git clone https://github.com/qwerty35/lsc_planner
    python tests/bench/plan_lsc.py --scenes lsc_planner        # or make bench ARGS='plan_lsc --scenes lsc_planner'

Without a folder there is nothing to plan, and nothing of theirs is in this one. Theirs is a planner that decides again
every 0.2 s on board of each agent: its time is an agent's for one such decision, ours is for the whole plan of all.
"""

from __future__ import annotations

import functools
import statistics
import sys
import time
from collections import defaultdict
from pathlib import Path

import click
import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from agents.planner.model.errors import PlanError
from agents.planner.model.scene import Scene
from agents.planner.solve import warm
from agents.planner.solve.bound import least_makespan
from agents.planner.solve.pipeline import solve
from tests.agents.planner import lsc
from tests.agents.planner.checker import check
from tests.agents.planner.generate import as_json

PUBLISHED = {
    "empty/60agents": "15.5 ms an agent and replan (i7 laptop)",
    "forest/20agents": "goals reached without deadlock",
    "office/20agents": "goals reached without deadlock",
}
"""of arXiv 2109.09041, its abstract"""


def missions(folder: Path) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.glob("missions/*/*/**/*.json"), key=lambda p: (p.parent, len(p.name), p.name)):
        found[str(path.parent.relative_to(folder / "missions"))].append(path)
    return dict(sorted(found.items()))


@click.command()
@click.option("--scenes", type=click.Path(exists=True, file_okay=False, path_type=Path), help="A clone of lsc_planner.")
@click.option("--only", default="", help="Groups that begin with this: forest, empty/60.")
@click.option("--most", type=click.IntRange(min=1), default=None, help="Of each group.  [default: all]")
@click.option("--seconds", default=30.0, show_default=True, help="Of the processor, for each plan.")
def main(scenes: Path | None, only: str, most: int | None, seconds: float) -> None:
    """Print a row for each group of missions, and every one that has no plan."""
    if scenes is None:
        print("no missions: --scenes FOLDER names a clone of github.com/qwerty35/lsc_planner")
        return
    warm.warm(planes=False)
    heads = ("CPU s", "worst", "makespan", "ratio", "length m")
    print(f"{'missions':20} {'solved':>7} {' '.join(f'{head:>8}' for head in heads)}  published")
    solved = count = 0
    for name, paths in missions(scenes).items():
        if not name.startswith(only):
            continue
        rows, lost = [], []
        for path in paths[:most]:
            scene = scene_of(path, scenes)
            used = time.process_time()
            try:
                plan = solve(scene, seconds=seconds)
            except PlanError as e:
                lost.append(f"  {path.name}: {e.kind}: {e.message}, {time.process_time() - used:.1f} s")
                continue
            used = time.process_time() - used
            if faults := check(as_json(scene), msgspec.to_builtins(plan)):
                lost.append(f"  {path.name}: the plan is wrong: {sorted(faults)[:3]}")
                continue
            legs = [np.diff(motion[:, 1:], axis=0) for motion in plan.motions().values()]
            length = sum(float(np.linalg.norm(leg, axis=1).sum()) for leg in legs)
            rows.append((used, plan.makespan, plan.makespan / least_makespan(scene), length))
        solved, count = solved + len(rows), count + len(rows) + len(lost)
        figures = ""
        if rows:
            used, makespan, ratio, length = (statistics.median(column) for column in zip(*rows, strict=True))
            worst = max(row[0] for row in rows)
            figures = f"{used:8.2f} {worst:8.2f} {makespan:8.2f} {ratio:8.2f} {length:8.1f}"
        print(f"{name:20} {len(rows):3}/{len(rows) + len(lost):<3} {figures:44}  {PUBLISHED.get(name, '')}", flush=True)
        for line in lost:
            print(line[:200], flush=True)
    print(f"{solved} of {count} missions have a plan that an independent checker passes")


def scene_of(path: Path, folder: Path) -> Scene:
    world = lsc.world_for(path, folder)
    return lsc.scene_of(path, None if world is None else cubes_of(world))


@functools.cache
def cubes_of(world: Path) -> lsc.Cubes:
    return lsc.taken(world.read_bytes())


if __name__ == "__main__":
    main()
