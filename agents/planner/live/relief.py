"""Who runs low on the way: it goes home, and what it had to search is another's."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence

import msgspec
import numpy as np
import shapely

from agents.planner.goals.steps import FleetView, Step, for_the_rest
from agents.planner.live.context import Context
from agents.planner.live.energy import CALLED_BACK, check, told
from agents.planner.live.fleet import FRESH
from agents.planner.live.frames import ned
from agents.planner.live.tally import Tally
from agents.planner.model.problem import Floats, Motion, places_at
from zmav.errors import BadInput
from zmav.wire import Vector, swarm

STRAIGHT = 0.1
"""m by which a way that is handed on may leave the one that was planned"""
BACK_S = 0.5
"""s of the plan by which who takes over begins earlier, so that no ground is left out: a plan is eased so much"""
SHORTEST = 1.0
"""m: less is nothing to be handed on"""
FRESH_LEFT = 0.15
"""share of its battery, beyond its reserve, that who takes over has at least"""


def check_batteries(
    context: Context, entry: swarm.GoalEntry, names: tuple[str, ...], steps: Sequence[Step], view: FleetView
) -> None:
    """Say what a goal that comes down to these steps takes from each; raises :class:`~zmav.errors.Refused` where
    somebody could not come back from it.
    """
    tally = Tally(names, view)
    for step in steps:
        tally.add(for_the_rest(step, set(entry.goal.vehicles) - set(names)))
    needs = context.fleet.needs(tally, view)
    entry.landing = {name: round(need.left, 2) for name, need in needs.items() if need.left is not None}
    check(entry.goal, needs, context.settings.unknown_batteries)
    context.say("energy", "info", f"{entry.id}: about {tally.seconds:.0f} s; {told(needs)}", goal=entry.id)


def low_of(context: Context, goal: swarm.Goal, vehicles: Sequence[str]) -> dict[str, str]:
    """Who of these would, if it went home now, land with less than its reserve, and that in words. What brings home
    anyhow goes on.
    """
    view = context.fleet.view()
    names = [name for name in vehicles if name in view.vehicles and view.vehicles[name].airborne]
    found = dict[str, str]()
    for name, need in context.fleet.needs(Tally(names, view), view).items() if isinstance(goal, CALLED_BACK) else ():
        if need.now is not None and need.short:
            has, home = f"{100.0 * need.now:.0f} %", f"{100.0 * need.home:.0f} %"
            found[name] = f"{name} runs low: it has {has}, needs {home} for the way home, and is to keep its reserve"
    return found


def left_over(motion: Motion, moment: float) -> Motion:
    """What is left of a motion from that moment of it on."""
    begin = max(float(motion[0, 0]), min(moment, float(motion[-1, 0])) - BACK_S)
    if begin <= motion[0, 0]:
        return motion
    return np.vstack(([begin, *places_at(motion, begin)], motion[motion[:, 0] > begin]))


def way_of(motion: Motion) -> list[Vector]:
    """Its corners (NED); none where hardly anything is left."""
    places: Floats = motion[:, 1:4]
    if len(places) < 2 or float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()) < SHORTEST:
        return []
    line = shapely.simplify(shapely.linestrings(places[:, :2]), STRAIGHT)
    return [ned((float(x), float(y), float(places[0, 2]))) for x, y in shapely.get_coordinates(line)]


def relieve(context: Context, entry: swarm.GoalEntry, known: Mapping[str, str], lanes: Mapping[str, Motion]) -> None:
    """End the goal of some that run low (``known``, and who does by now): they go home, and of a search the others go
    on, with fresh ones in their places where there are some; else who is done first takes their parts after its own.
    Call it when all rest.
    """
    ledger, goal = context.ledger, entry.goal
    low = {**known, **low_of(context, goal, goal.vehicles)}
    verb = "return" if len(low) > 1 else "returns"
    ledger.end(entry, "cancelled", f"{'; '.join(low.values())}: {', '.join(low)} {verb}")
    added = [_add(context, _home(context, name), entry) for name in low]
    if isinstance(goal, swarm.Search) and (ways := _ways(context, goal, list(low), lanes)):
        fresh = [name for name in ways if name not in goal.vehicles]
        for name in fresh:
            if not _airborne(context, name):
                up = swarm.TakeOff(vehicles=[name], height=_height(context, goal, name))
                added.append(_add(context, up, entry))
        rest = msgspec.structs.replace(goal, vehicles=list(ways), lanes=list(ways.values()))
        added.append(_add(context, rest, entry))
        who = f"{', '.join(fresh)} {'take' if fresh[1:] else 'takes'}" if fresh else "the others take"
        entry.text += f", and {who} over ({', '.join(filter(None, added))})"
    context.say("energy", "warning", f"{entry.id}: {entry.text}", goal=entry.id, vehicles=list(low))
    context.wake()


def bring_home(context: Context, entry: swarm.GoalEntry) -> None:
    """What is left of a search is more than their batteries allow: who hovers for it goes home, and does not wait in
    nobody's goal until its autopilot has it land.
    """
    added = [_add(context, _home(context, name), entry) for name in entry.goal.vehicles if _airborne(context, name)]
    if added:
        text = f"{entry.id}: who is in the air for it goes home ({', '.join(filter(None, added))})"
        context.say("energy", "warning", text, goal=entry.id)
        context.wake()


def _home(context: Context, name: str) -> swarm.Goal:
    """Home; down where it is, where nobody knows its home."""
    seen = context.fleet.seen(name)
    if seen is not None and seen.view.home_ned is None:
        return swarm.Land(vehicles=[name])
    return swarm.Return(vehicles=[name])


def _add(context: Context, goal: swarm.Goal, entry: swarm.GoalEntry) -> str:
    """After what its vehicles do by then; its id, or nothing where the book is full."""
    try:
        return context.ledger.add(goal, "queue", time.time(), context.charge.term, entry.by).id
    except BadInput as e:
        context.say("energy", "error", f"{entry.id}: {e.message}", goal=entry.id)
        return ""


def _ways(
    context: Context, goal: swarm.Search, low: Sequence[str], lanes: Mapping[str, Motion]
) -> dict[str, list[Vector]]:
    """What is left of a search, by who flies it from now on."""
    found = {name: way for name, motion in lanes.items() if name not in low and (way := way_of(motion))}
    others = [name for name in lanes if name not in low]
    soonest = min(others, key=lambda name: float(lanes[name][-1, 0] - lanes[name][0, 0]), default="")
    for name in (name for name in low if name in lanes):
        if not (lost := way_of(lanes[name])):
            continue
        if taker := _fresh(context, {*goal.vehicles, *found}) or soonest:
            found[taker] = [*found.get(taker, []), *lost]
        else:
            context.say("energy", "warning", f"nobody is there to search on for {name}: its part is left")
    return found


def _fresh(context: Context, but: Collection[str]) -> str:
    """Who is in no goal, can fly at once, and has most in its battery; empty: nobody. ``but``: not these."""
    fleet, view = context.fleet, context.fleet.view()
    busy = {name for entry in context.ledger.open for name in entry.goal.vehicles} | set(but)
    left = dict[str, float]()
    for name, each in view.vehicles.items():
        seen, battery = fleet.seen(name), fleet.battery_of(name)
        if name in busy or seen is None or seen.age > FRESH or battery is None or not (each.flies and each.hovers):
            continue
        able = each.airborne or bool(seen.state.ready)
        if able and not seen.state.pilot and seen.state.lease is None and battery > each.body.reserve + FRESH_LEFT:
            left[name] = battery
    return max(left, key=lambda name: left[name], default="")


def _airborne(context: Context, name: str) -> bool:
    seen = context.fleet.seen(name)
    return seen is not None and seen.view.airborne


def _height(context: Context, goal: swarm.Search, name: str) -> float:
    """m above its home at which it searches."""
    seen = context.fleet.seen(name)
    counts_from_home = isinstance(goal, swarm.Survey) or goal.above_ground
    ground = -seen.view.floor if seen is not None and not counts_from_home else 0.0
    return max(2.0, goal.height - ground)
