"""Who has flown a plan to its end is told nothing more: an order comes next, which a segment on its way would meet."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import zenoh

from agents.planner.execute.executor import Executor
from tests.agents.planner.execute.fleet import airborne
from tests.agents.planner.execute.test_executor import HEIGHT, flight
from tests.agents.planner.execute.virtual import line
from zmav import keys


async def test_no_segment_is_put_once_all_are_at_their_goals() -> None:
    motions = {"quad1": line(np.array([0.0, 0.0, HEIGHT]), np.array([0.0, 4.0, HEIGHT]))}
    put: list[dict[str, Any]] = []

    def on_setpoint(sample: zenoh.Sample) -> None:
        put.append(json.loads(sample.payload.to_bytes()))

    async with airborne([(0.0, 0.0)], HEIGHT) as fleet:
        fleet.z.session.declare_subscriber(keys.SETPOINT.key("demo", "*", agent="*"), on_setpoint)
        async with Executor(fleet.z, fleet.names, taking=30.0) as executor:
            # Who is not at its goal at the end of a plan is waited for, and told to stay: a slow machine's copter lags.
            outcome = await executor.run(dataclasses.replace(flight(motions), tolerance=5.0))
            assert outcome.done, outcome.reason
            await fleet.z.vehicle("quad1").hold()
        assert put
        assert all(max(point["pos"][0] for point in each["segment"]) > 3.5 for each in put), "each leads to the goal"
        assert all(len({tuple(point["pos"]) for point in each["segment"]}) > 1 for each in put), "none only to stay"
        counts = fleet.z.vehicle("quad1").state.setpoints
        assert set(counts) <= {"flown", "held"}, counts
