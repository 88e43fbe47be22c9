"""Goals flown one after another by simulated copters, several teams at once: how near any two of a team truly came, and
what each goal's preview said of the time that it took.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import zmav
from agents.planner.cli.asking import Planner, books, find
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.agents.planner.execute.fleet import Fleet, airborne
from zmav import wire
from zmav.config import body_of
from zmav.waiting import together, within
from zmav.wire import swarm

PATIENCE_S = 120.0
LONGEST_S = 600.0
DOWNWASH = 1.5
AFLOAT = 3.0
"""m of height from which two are looked at: on the ground they stand as their pads do"""
ASIDE = 200.0
"""m between two teams"""
Make = Callable[[list[str], float], swarm.Goal]
"""a goal for these vehicles, whose places are so far east of a team's own"""


@dataclass
class Took:
    """One goal of one team."""

    team: int
    what: str
    said: float
    """s that its preview said it takes"""
    seconds: float
    """s that it took from the book to its end"""
    entry: swarm.GoalEntry
    preview: dict[str, Any] = field(default_factory=dict)

    @property
    def ratio(self) -> float:
        return self.seconds / max(self.said, 1e-6)


@dataclass
class Flown:
    took: list[Took]
    least: dict[tuple[int, str], float]
    """m, by team and goal: how near two of it truly came, height counted less by the downwash"""
    said: list[wire.Event]
    """what the planner said had happened"""

    def all_of(self, *kinds: str) -> list[str]:
        return [event.text for event in self.said if event.kind in kinds]

    @property
    def nearest(self) -> float:
        return min(self.least.values())


def readme() -> dict[str, Make]:
    """The README's own commands, two swaps, and smaller searches."""
    return {
        "takeoff": lambda names, east: swarm.TakeOff(vehicles=names, height=12.0),
        "formation": lambda names, east: swarm.Formation(
            vehicles=names, shape="vee", at=(50.0, east, -20.0), heading=math.pi / 2.0, spacing=9.0
        ),
        "goto": lambda names, east: swarm.GoTo(vehicles=names[:2], to=[(30.0, east, -15.0), (0.0, 20.0 + east, -15.0)]),
        "swap": lambda names, east: swarm.GoTo(
            vehicles=names, to=[(25.0, 14.0 * (len(names) - i) + east, -15.0) for i in range(len(names))]
        ),
        "swap back": lambda names, east: swarm.GoTo(
            vehicles=names, to=[(25.0, 14.0 * i + east, -15.0) for i in range(len(names))]
        ),
        "search": lambda names, east: swarm.Search(
            vehicles=names, polygon=[(0.0, east), (60.0, east), (60.0, 60.0 + east), (0.0, 60.0 + east)], height=25.0
        ),
        "survey": lambda names, east: swarm.Survey(
            vehicles=names,
            polygon=[(0.0, east), (60.0, east), (60.0, 60.0 + east), (0.0, 60.0 + east)],
            height=20.0,
            camera=(1.5, 1.0),
        ),
        "return": lambda names, east: swarm.Return(vehicles=names),
    }


async def fly(
    goals: Mapping[str, Make],
    teams: int,
    size: int,
    weather: Mapping[str, Any],
    apart: float = 10.0,
    autopilot: str = "arducopter",
) -> Flown:
    """``teams`` of ``size`` copters each, their pads ``apart`` metres in a row."""
    starts = [(0.0, team * ASIDE + apart * i) for team in range(teams) for i in range(size)]
    took: list[Took] = []
    async with contextlib.AsyncExitStack() as stack:
        fleet = await stack.enter_async_context(airborne(starts, 0.0, autopilot=autopilot, weather=weather, params={}))
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        agent = await stack.enter_async_context(Agent(z, PlannerSettings(name="ground", patience=1.0)))
        me = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        await agent.context.solver.until_ready(PATIENCE_S)
        planner, doing = await find(me), [""] * teams
        least: dict[tuple[int, str], float] = {}
        said = dict[float, wire.Event]()
        watching = asyncio.create_task(_watch(fleet, teams, size, doing, least))
        hearing = asyncio.create_task(_hear(agent, said))

        async def one(team: int) -> None:
            names = fleet.names[team * size : (team + 1) * size]
            for what, make in goals.items():
                doing[team] = what
                took.append(await _fly_one(me, planner, team, what, make(names, team * ASIDE)))

        await together(*(one(team) for team in range(teams)))
        watching.cancel()
        hearing.cancel()
    return Flown(took, least, list(said.values()))


async def _hear(agent: Agent, said: dict[float, wire.Event]) -> None:
    while True:
        said |= {event.t: event for event in agent.context.events}
        await asyncio.sleep(0.2)


async def _fly_one(z: zmav.Client, planner: Planner, team: int, what: str, goal: swarm.Goal) -> Took:
    preview = await planner.order("preview", swarm.Preview(goal=goal))
    submitted = time.monotonic()
    name = str((await planner.order("submit", swarm.Submit(goal=goal, when="now")))["goal"])
    entry = await within(LONGEST_S, _ended(z, name))
    return Took(team, what, float(preview["seconds"]), time.monotonic() - submitted, entry, preview)


async def _ended(z: zmav.Client, name: str) -> swarm.GoalEntry:
    async for book in books(z, PATIENCE_S):
        for entry in book.goals if book else []:
            if entry.id == name and entry.state in ("done", "failed", "cancelled"):
                return entry
    raise AssertionError("books never end")


def _scaled(a: wire.Vector, b: wire.Vector) -> float:
    return math.hypot(math.dist(a[:2], b[:2]), (a[2] - b[2]) / DOWNWASH)


async def _watch(fleet: Fleet, teams: int, size: int, doing: list[str], least: dict[tuple[int, str], float]) -> None:
    while True:
        places = fleet.places()
        for team in range(teams):
            own = [places[name] for name in fleet.names[team * size : (team + 1) * size]]
            pairs = [(a, b) for a, b in itertools.combinations(own, 2) if min(-a[2], -b[2]) > AFLOAT]
            near = min((_scaled(a, b) for a, b in pairs), default=math.inf)
            key = (team, doing[team])
            least[key] = min(least.get(key, math.inf), near)
        await asyncio.sleep(0.05)


PROMISED = 2.0 * body_of("copter").radius
"""m between two copters' centres"""


def show(flown: Flown) -> str:
    lines = [f"{'goal':12} {'team':>4} {'said s':>7} {'took s':>7} {'ratio':>6} {'nearest m':>9}"]
    for each in flown.took:
        near = flown.least.get((each.team, each.what), math.inf)
        lines.append(
            f"{each.what:12} {each.team:4} {each.said:7.1f} {each.seconds:7.1f} {each.ratio:6.2f}"
            f" {near:9.2f}  {each.entry.state}: {each.entry.text}; {each.preview.get('positions', {}).get('text', '')}"
        )
    return "\n".join(lines)


def main() -> None:
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--teams", type=int, default=2)
    parser.add_argument("--noise", default="typical")
    parser.add_argument("--wind", type=float, default=0.0, help="m/s from the west, with light gusts")
    parser.add_argument("--autopilot", default="arducopter")
    parser.add_argument("--only", nargs="*", help="of the goals")
    options = parser.parse_args()
    for seed in range(options.seeds):
        weather: dict[str, Any] = {"noise": options.noise, "seed": seed}
        if options.wind:
            weather |= {"wind": (0.0, options.wind, 0.0), "gusts": "light"}
        goals = {name: make for name, make in readme().items() if not options.only or name in options.only}
        flown = asyncio.run(fly(goals, options.teams, 4, weather, autopilot=options.autopilot))
        stops = flown.all_of("halt", "replan")
        print(show(flown), *stops, f"{len(stops)} unplanned stops", sep="\n", flush=True)


if __name__ == "__main__":
    main()
