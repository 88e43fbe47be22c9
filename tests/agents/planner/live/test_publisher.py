"""What a planner says by itself goes on, whatever one part of it has become."""

from __future__ import annotations

import numpy as np
import pytest

import zmav
from agents.planner.cli.asking import books
from agents.planner.live.agent import Agent
from agents.planner.live.publisher import POINTS, thin
from agents.planner.live.settings import PlannerSettings
from tests.conftest import Net
from tests.waiting import until
from zmav.wire import swarm

PATIENCE_S = 30.0


async def test_a_map_that_no_message_holds_does_not_silence_the_planner(
    net: Net, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    _, endpoint = net.router()
    own = PlannerSettings(name="ground", patience=1.0)
    async with zmav.open(connect=[endpoint]) as z, Agent(z, own) as agent, zmav.open(connect=[endpoint]) as me:
        await until(lambda: agent.context.charge.in_charge, "nobody takes charge", PATIENCE_S)
        coast = swarm.NoFly(polygon=[(k / 7.0, k / 3.0) for k in range(500_000)], floor=0.0, ceiling=9.0)
        agent.context.take_obstacle(swarm.Obstacle(name="coast", t=1.0, what=coast))
        events = agent.context.events
        await until(lambda: any("too much for one message" in event.text for event in events), "", PATIENCE_S)
        assert not any(task.done() for task in agent.publisher.tasks)
        async for book in books(me, PATIENCE_S):
            if book is not None and book.obstacles == 1:
                break


@pytest.mark.parametrize("rows", [1, 2, POINTS, POINTS + 1, 2 * POINTS, 1000])
def test_a_track_is_told_in_so_many_points_with_both_its_ends(rows: int) -> None:
    motion = np.repeat(np.arange(rows, dtype=np.float64)[:, None], 4, axis=1)
    told = thin(motion)
    assert len(told) == rows if rows <= POINTS else 2 <= len(told) <= POINTS
    assert (told[0][0], told[-1][0]) == (0.0, rows - 1.0)
