"""The rotation, flown by two simulated copters: how it ends well, and what it leaves alone when it does not."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, NamedTuple

import pytest

import zmav
from agents.planner.swap import swap
from zmav import keys, wire
from zmav.errors import BadInput, NotHolder, Refused
from zmav.sim import SimVehicle, VehicleSpec, World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 30.0
NAMES = ("quad1", "quad2")
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Pair(NamedTuple):
    z: zmav.Client
    sims: list[SimVehicle]
    world: World
    said: list[str]

    def swap(self) -> asyncio.Task[object]:
        return asyncio.create_task(swap(self.z, NAMES, "ground", self.said.append))

    async def until(self, name: str, true: Callable[[zmav.VehicleState], bool]) -> None:
        await self.z.vehicle(name).wait_until(true, PATIENCE_S)


@pytest.fixture
async def pair(net: Net, onboard: StartOnboard) -> AsyncIterator[Pair]:
    """Two copters six metres apart, ready, and a client that has heard of both."""
    specs = [VehicleSpec(params={"DISARM_DELAY": 0.0}) for _ in NAMES]
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", speed=8.0, ready_s=0.5, spacing_m=6.0))
        session, endpoint = net.router()
        other, _ = net.router(endpoint)
        for name, url, router in zip(NAMES, world.urls, (session, other), strict=True):
            await onboard(router, url, name=name, origin=ORIGIN)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        found = Pair(z, world.vehicles, world, [])
        for name in NAMES:
            await found.until(name, lambda s: bool(s.ready))
        yield found


async def test_two_vehicles_swap(pair: Pair) -> None:
    starts = [sim.status().ned_m for sim in pair.sims]
    states: list[str] = []
    key = keys.AGENT_STATUS.key("demo", "*", agent="planner")
    async with pair.z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), wire.AgentStatus, "status")) as news:
        flown = await swap(pair.z, NAMES, "ground", pair.said.append)
        while not states or states[-1] != "done":
            states.append((await news.get()).state)
    assert [part.arrived for part in flown.values()] == [True, True]
    for sim, goal in zip(pair.sims, reversed(starts), strict=True):
        assert sim.status().ned_m[:2] == pytest.approx(goal[:2], abs=1.0)
        assert not sim.status().armed
    assert list(dict.fromkeys(states)) == ["takeoff", "swap", "land", "done"]
    assert pair.said == ["takeoff", "swap", "land", "done"]


async def test_what_a_pilot_took_over_is_left_to_the_pilot(pair: Pair) -> None:
    flying = pair.swap()
    await pair.until("quad1", lambda s: s.setpoints.get("flown", 0) > 5)
    pair.world.call(lambda: pair.sims[0].pilot_mode("LOITER"))
    with pytest.raises(Refused, match=r"quad1 was taken over: .*the mode is now LOITER"):
        await flying
    one, two = (sim.status() for sim in pair.sims)
    assert (one.mode, one.armed, one.landed) == ("LOITER", True, False)
    assert (two.mode, two.armed, two.landed) == ("LAND", False, True)


async def test_when_one_does_not_rise_all_come_down(pair: Pair) -> None:
    flying = pair.swap()
    await pair.until("quad2", lambda s: bool(s.position and s.position.alt_rel > 1.0))
    pair.world.call(lambda: pair.sims[1].pilot_mode("LOITER"))
    with pytest.raises(Refused, match="taken over"):
        await flying
    one, two = (sim.status() for sim in pair.sims)
    assert (one.armed, one.landed) == (False, True)
    assert (two.mode, two.armed) == ("LOITER", True)


async def test_who_cancels_it_sees_all_land(pair: Pair) -> None:
    flying = pair.swap()
    await pair.until("quad1", lambda s: s.setpoints.get("flown", 0) > 5)
    flying.cancel()
    with pytest.raises(asyncio.CancelledError):
        await flying
    assert [sim.status().armed for sim in pair.sims] == [False, False]
    for name in NAMES:
        await pair.until(name, lambda s: s.lease is None)


async def test_a_vehicle_that_another_commands_is_not_taken(pair: Pair) -> None:
    async with pair.z.vehicle("quad2").lease("rival", ttl=10.0):
        with pytest.raises(NotHolder, match="rival commands quad2"):
            await swap(pair.z, NAMES, "ground", pair.said.append)
    assert [sim.status().armed for sim in pair.sims] == [False, False]


async def test_two_at_one_place_are_refused_on_the_ground(pair: Pair) -> None:
    with pytest.raises(BadInput, match="two vehicles or more"):
        await swap(pair.z, ("quad1",), "ground", pair.said.append)
    assert not pair.sims[0].status().armed
