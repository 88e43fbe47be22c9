"""What ``zmav plan`` says of a plan: in one line for a person, as facts for a script."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from agents.planner.cli.stages import PREPARING
from agents.planner.model.plans import Plan
from agents.planner.model.scene import Scene
from agents.planner.solve.bound import least_makespan

if TYPE_CHECKING:
    from agents.planner.model.verify import Report  # with it comes numba, which a refusal need not wait for


@dataclass(frozen=True)
class Done:
    """One scene, planned for or refused."""

    name: str
    scene: Scene | None
    plan: Plan
    report: Report | None
    stages: dict[str, float]


def quality(scene: Scene, report: Report) -> dict[str, Any]:
    """How good a plan is: s, m and shares; None where there is nothing to measure."""
    bound, closest, near = least_makespan(scene), report.closest, report.obstacle_clearance
    return {
        "makespan": report.makespan,
        "over_bound": round(report.makespan / bound, 4) if bound else None,
        "clearance": None if closest is None else round(closest.clearance, 4),
        "closest": None if closest is None else [*closest.ids, round(closest.time, 3)],
        "obstacle_clearance": round(near, 4) if math.isfinite(near) else None,
    }


def facts(done: Done, target: Path | None) -> dict[str, Any]:
    """How planning went; ``stages`` are seconds."""
    found: dict[str, Any] = {"scene": done.name, "status": done.plan.status}
    found["vehicles"] = len(done.scene.vehicles) if done.scene else None
    if done.report is not None and done.scene is not None:
        found |= quality(done.scene, done.report)
    spent = done.plan.planning_time_s
    found["planning_time_s"] = None if spent is None else round(spent, 4)
    found["stages"] = {name: round(seconds, 4) for name, seconds in done.stages.items()}
    if done.plan.error is not None:
        found["error"] = msgspec.to_builtins(done.plan.error)
    found["output"] = None if target is None else str(target)
    return found


def headline(name: str, scene: Scene, report: Report) -> str:
    """What a plan is worth, in words."""
    found = quality(scene, report)
    over = f" ({found['over_bound']:.2f} × the bound)" if found["over_bound"] else ""
    words = [f"{name}: {len(scene.vehicles)} vehicles, makespan {found['makespan']:.1f} s{over}"]
    if found["closest"]:
        one, other, when = found["closest"]
        words.append(f"clearance {found['clearance']:.2f} m ({one}, {other} at {when:.1f} s)")
    if found["obstacle_clearance"] is not None:
        words.append(f"{found['obstacle_clearance']:.2f} m from obstacles")
    return ", ".join(words)


def summary(done: Done) -> str:
    """How planning went, in one line."""
    assert done.scene is not None and done.report is not None
    spent = {name: s for name, s in done.stages.items() if name not in PREPARING and s >= 0.005}
    before = sum(s for name, s in done.stages.items() if name in PREPARING)
    words = ", ".join(f"{name} {seconds:.2f}" for name, seconds in spent.items())
    planned = f"planned in {done.plan.planning_time_s or 0.0:.2f} s" + (f" ({words})" if words else "")
    if before >= 0.1:
        planned += f" after {before:.1f} s to get ready"
    return f"{headline(done.name, done.scene, done.report)}, {planned}"
