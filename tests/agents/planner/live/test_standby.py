"""What a planner that stands by takes over from the one in charge."""

from __future__ import annotations

from typing import Any

import zmav
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.conftest import Net
from zmav import wire
from zmav.wire import swarm

CHIEF: dict[str, Any] = {"t": 1.0, "planner": "chief", "instance": "1"}


async def test_a_map_with_something_that_is_no_obstacle_is_not_kept(net: Net) -> None:
    """No plan could be made among it, once we are in charge."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        agent = Agent(z, PlannerSettings(name="aside"))
        tree = swarm.Cylinder(center=(0.0, 9.0), radius=1.0, floor=0.0, ceiling=9.0)
        known = swarm.Obstacle(name="oak", t=1.0, what=tree)
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
