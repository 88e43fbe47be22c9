"""What a planner that stands by takes over from the one in charge."""

from __future__ import annotations

import math
from typing import Any

import msgspec

import zmav
from agents.planner.live.agent import Agent
from agents.planner.live.settings import FENCE, PlannerSettings
from tests.conftest import Net
from tests.waiting import until
from zmav import wire
from zmav.wire import swarm

CHIEF: dict[str, Any] = {"t": 1.0, "planner": "chief", "instance": "1"}


def tree(name: str, east: float = 9.0) -> swarm.Obstacle:
    return swarm.Obstacle(name=name, t=1.0, what=swarm.Cylinder(center=(0.0, east), radius=1.0, floor=0.0, ceiling=9.0))


async def test_a_map_with_something_that_is_no_obstacle_is_not_kept(net: Net) -> None:
    """No plan could be made among it, once we are in charge."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        agent, known = Agent(z, PlannerSettings(name="aside")), tree("oak")
        agent.on_book(wire.encode(swarm.Book(**CHIEF, term=1, obstacles=1)))
        agent.on_map(wire.encode(swarm.ObstacleMap(**CHIEF, obstacles=[known])))
        for wrong in (
            swarm.NoFly(polygon=[], floor=0.0, ceiling=9.0),
            swarm.Ball(center=(0.0, 0.0, 1e300), radius=1.0),
        ):
            odd = swarm.Obstacle(name="odd", t=1.0, what=wrong)
            agent.on_map(wire.encode(swarm.ObstacleMap(**CHIEF, obstacles=[known, odd])))
            assert [each.name for each in agent.context.world.obstacles] == ["oak"]
        agent.context.world.pieces(2.0).bounds([(0.0, 0.0, 10.0)])


async def test_what_is_no_obstacle_is_named_and_the_rest_of_its_map_kept(net: Net) -> None:
    """The fleet file of the one in charge may have a fence with more corners than we take: ours stays."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        ours = swarm.Geofence(polygon=[(0.0, 0.0), (0.0, 90.0), (90.0, 90.0)], floor=0.0, ceiling=50.0)
        agent = Agent(z, PlannerSettings(name="aside", geofence=ours))
        round_about = [(90.0 * math.cos(k / 99.0), 90.0 * math.sin(k / 99.0)) for k in range(600)]
        fence = swarm.Obstacle(name=FENCE, t=0.0, what=swarm.Geofence(polygon=round_about, floor=0.0, ceiling=50.0))
        book = swarm.Book(**CHIEF, term=1, obstacles=3)
        agent.on_book(wire.encode(book))
        agent.on_map(wire.encode(swarm.ObstacleMap(**CHIEF, obstacles=[tree("oak"), fence, tree("elm", 20.0)])))
        await until(lambda: bool(agent.context.events), "it is said", 5.0)
        assert f"{FENCE}: obstacle.what.polygon has 600 entries" in agent.context.events[-1].text
        assert {each.name for each in agent.context.world.obstacles} == {"oak", "elm", FENCE}
        kept = agent.context.world.find(FENCE)
        assert kept is not None and kept.what == ours
        goal = swarm.GoTo(vehicles=["quad1"], to=[(0.0, 0.0, -9.0)])
        entry = swarm.GoalEntry(id="g1-1", goal=goal, state="queued", t=1.0)
        agent.check_map(book, [entry])
        assert entry.state == "paused"
        assert f"2 are known here (not kept: {FENCE}" in agent.context.events[-1].text


async def test_a_map_that_was_overtaken_brings_nothing_back(net: Net) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        agent = Agent(z, PlannerSettings(name="aside"))
        agent.on_book(wire.encode(swarm.Book(**CHIEF, term=1, obstacles=1)))

        def kept(t: float, *names: str) -> list[str]:
            told = swarm.ObstacleMap(**{**CHIEF, "t": t}, obstacles=[tree(name) for name in names])
            agent.on_map(wire.encode(told))
            return [each.name for each in agent.context.world.obstacles]

        assert kept(1000.0, "oak", "elm") == ["elm", "oak"]
        assert kept(1005.0, "oak") == ["oak"]
        assert kept(1000.0, "oak", "elm") == ["oak"]
        agent.on_obstacle(wire.encode(msgspec.structs.replace(tree("ash"), t=1010.0)))
        assert kept(1000.0, "oak", "elm") == ["ash", "oak"], "nor does it take away what was told since"
        assert kept(5.0, "oak", "elm") == ["elm", "oak"], "its clock was set back: no map is late for so long"
