"""Somebody takes one vehicle of a goal that flies what was prepared: the others go on without it."""

from __future__ import annotations

import pytest

from tests.agents.planner.live.led import PATIENCE_S, led
from tests.waiting import until
from zmav.wire import swarm


async def test_who_is_taken_from_a_prepared_flight_keeps_nobody_from_its_end() -> None:
    async with led([(0.0, 0.0), (0.0, 8.0)], 10.0) as field:
        names = ["quad1", "quad2"]
        line = swarm.Formation(
            vehicles=names, shape="line", at=(40.0, 4.0, -10.0), via=[(8.0, 4.0, -10.0)], spacing=8.0, labelled=True
        )
        name = await field.submit(line)
        await field.until(name, lambda entry: entry.state == "flying" and "on its way" in entry.text)
        run = field.agent.runs[name]
        await until(lambda: run.flying is not None and field.fleet.places()["quad1"][0] > 12.0, run.entry, PATIENCE_S)
        async with field.me.vehicle("quad1").lease("boss", priority=50) as lease:
            with pytest.raises(AssertionError, match="the others are there; without quad1"):
                await field.until(name, lambda entry: entry.state == "done")
            assert lease.lost is None
        north, _, down = field.fleet.places()["quad2"]
        assert (north, down) == pytest.approx((40.0, -10.0), abs=1.5)
