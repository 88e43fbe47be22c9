"""What the planner knows of vehicles, and how long of those that are gone."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

from agents.planner.live.fleet import FORGOTTEN, Fleet
from zmav import wire
from zmav.client import Answer
from zmav.config import body_of
from zmav.wire import swarm

PLACE = wire.GlobalPosition(lat_deg=50.0, lon_deg=8.0, alt_amsl=110.0, alt_rel=10.0)


class Air:
    """A client that hears one vehicle, or none."""

    fleet_name = "demo"

    def __init__(self) -> None:
        self.state: wire.VehicleState | None = None

    def fleet(self) -> list[SimpleNamespace]:
        return [] if self.state is None else [SimpleNamespace(name="quad1", last_state=self.state, age=0.0)]

    async def ask(self, key: str, **how: object) -> list[Answer]:
        body = swarm.BodyReport(
            kind="copter", declared=True, body=swarm.Body(**{**BODY, "radius": 3.0}), returns_after=9.0
        )
        return [Answer(key, wire.encode(body))]


BODY = {name: getattr(body_of("copter"), name) for name in swarm.Body.__struct_fields__}


def state(t: float, landed: bool, battery: float = 1.0) -> wire.VehicleState:
    return wire.VehicleState(
        t=t,
        fleet="demo",
        name="quad1",
        instance="i",
        kind="copter",
        armed=not landed,
        landed=landed,
        position=PLACE,
        local=(5.0 * t, 0.0, 0.0 if landed else -10.0),
        battery=wire.Battery(remaining=round(battery, 2)),
    )


async def test_of_who_is_gone_for_long_nothing_comes_back() -> None:
    """Another vehicle may have its name by then: with another home, another battery and another autopilot."""
    air = Air()
    fleet = Fleet(air)  # type: ignore[arg-type]
    air.state = state(0.0, True)
    fleet.watch()
    for tick in range(1, 400):
        air.state = state(0.2 * tick, False, 1.0 - 0.005 * 0.2 * tick)
        fleet.watch()
    await fleet.bodies.ask("quad1")
    following = fleet.followings_of(["quad1"])["quad1"]
    following.heard(lambda at: (np.zeros(3), np.array([5.0, 0.0, 0.0])), 0.0, np.array([-4.0, 0.0, 0.0]))
    usual = body_of("copter")
    assert fleet.energy.takes("quad1", usual, 60.0, 0.0) > 1.2 * 60.0 / usual.endurance
    assert (fleet.homeless, fleet.bodies.returns_after("quad1")) == ([], 9.0)
    last, _ = fleet.last["quad1"]
    fleet.last["quad1"], air.state = (last, time.monotonic() - FORGOTTEN - 1.0), None
    fleet.watch()
    assert fleet.names == []
    air.state = state(5000.0, False)
    fleet.watch()
    assert fleet.homeless == ["quad1"]
    assert fleet.followings_of(["quad1"])["quad1"] is not following
    assert fleet.energy.takes("quad1", usual, 60.0, 0.0) == pytest.approx(60.0 / usual.endurance)
    assert (fleet.bodies.of("quad1", "copter"), fleet.bodies.returns_after("quad1")) == (usual, None)
    assert fleet.bodies.due(["quad1"]) == ["quad1"]
