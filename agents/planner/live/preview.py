"""What would be flown for a goal, from where everybody is now; nothing is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from agents.planner.goals.steps import FleetView, Fly, Orders, PlanTo, Step, VehicleView
from agents.planner.live.accuracy import Accuracies
from agents.planner.live.frames import ned, vector
from agents.planner.live.plan import MOST_APART, Margins, Planned, Planner
from agents.planner.live.publisher import thin
from agents.planner.live.scenes import moved
from agents.planner.live.tally import Tally
from zmav.errors import Refused
from zmav.wire import Vector, swarm


async def preview(
    planner: Planner, goal: swarm.Goal, view: FleetView, tally: Tally, margins: Margins
) -> dict[str, Any]:
    """Steps with their makespan, clearance and tracks (NED), and the ``seconds`` that each takes with what is around
    it; raises the typed error of what cannot be. ``tally`` counts it all. ``margins``: what it would be planned with;
    none: the settings' own.
    """
    steps: list[dict[str, Any]] = []
    for step in await planner.steps(goal, view):
        plans, view = await _step(planner, step, view, margins)
        flown: list[Planned | None] = [*plans] or [None]
        for planned in flown:
            row: dict[str, Any] = {"step": type(step).__name__, "text": step.text, "vehicles": list(step.vehicles)}
            row["above_ground"] = None if planned is None else planned.above_ground
            row["seconds"] = round(tally.add(step, planned.motions if planned else None), 1)
            if planned is not None:
                tracks = {name: thin(motion) for name, motion in planned.motions.items()}
                row |= {"makespan": planned.makespan, "clearance": planned.clearance, "tracks": tracks}
                if planned.before:
                    row["text"] = f"first they draw apart: {planned.before}"
            steps.append(row)
        if isinstance(step, Fly) and step.figures:
            steps[-1]["figures"] = {name: dict(figures) for name, figures in step.figures.items()}
    clearances = [row["clearance"] for row in steps if row.get("clearance") is not None]
    heights = [row["above_ground"] for row in steps if row["above_ground"] is not None]
    return {
        "makespan": sum(row.get("makespan", 0.0) for row in steps),
        "seconds": round(tally.seconds, 1),
        "clearance": min(clearances, default=None),
        "above_ground": min(heights, default=None),
        "steps": steps,
    }


async def _step(planner: Planner, step: Step, view: FleetView, margins: Margins) -> tuple[list[Planned], FleetView]:
    """What is flown for one step, one after another, and the fleet as it will be after it."""
    plans: list[Planned] = []
    if isinstance(step, PlanTo):
        plans, view = await _to(planner, step, view, margins)
    elif isinstance(step, Fly):
        prepared, objection = await planner.check(step, view, margins)
        if prepared is not None:
            return [prepared], moved(view, _ends(prepared))
        for instead in step.instead:
            more, view = await _to(planner, instead, view, margins)
            plans += more
        if not plans:
            raise Refused(f"{step.text or 'what was prepared'}: {objection}; there is no other way")
    elif isinstance(step, Orders):
        view = _after(step, view)
    return plans, view


async def _to(planner: Planner, step: PlanTo, view: FleetView, margins: Margins) -> tuple[list[Planned], FleetView]:
    """As it would be flown: where they begin too near to each other they draw apart first."""
    plans: list[Planned] = []
    while not plans or plans[-1].before:
        if len(plans) > MOST_APART:
            raise Refused("they would draw apart again and again, and still rest too near to each other")
        plans.append(await planner.next_to(step, view, margins))
        view = moved(view, _ends(plans[-1]))
    return plans, view


def _ends(planned: Planned) -> dict[str, Vector]:
    return {name: ned(vector(motion[-1, 1:])) for name, motion in planned.motions.items()}


def _after(step: Orders, view: FleetView) -> FleetView:
    """Up by what they are ordered to climb to, or down."""
    for order in step.orders:
        seen = view.vehicles[order.vehicle]
        north, east, _ = seen.pos_ned
        floor = seen.floor
        if order.verb == "takeoff":
            place = (north, east, floor - float(order.args.get("alt_rel", 0.0)))
            view = moved(view, {order.vehicle: place}, airborne=True)
        else:
            view = moved(view, {order.vehicle: (north, east, floor)}, airborne=False)
    return view


def positions(views: Sequence[VehicleView], known: Accuracies) -> dict[str, Any]:
    """How well these know where they are (m, one standard deviation), by what that is told, and how far apart any two
    are kept for it.
    """
    errors = {view.name: known.error(view.name) for view in views}
    by = {view.name: known.word(view.name) for view in views}
    apart = sum(sorted(view.body.radius for view in views)[-2:]) if len(views) > 1 else None
    least, most = min(errors.values()), max(errors.values())
    span = f"±{most:g} m" if most - least < 0.01 else f"±{least:g} to ±{most:g} m"
    text = f"positions {span} ({', '.join(sorted(set(by.values())))})"
    tight = most > 0.0 and not any(view.room for view in views)
    text += f": {apart:.1f} m apart" if apart is not None else ""
    return {"errors": errors, "by": by, "apart": apart, "text": text + (", and no room made for that" if tight else "")}
