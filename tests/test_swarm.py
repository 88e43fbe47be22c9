"""Orders to several vehicles: who is left out, who brings them home, and that done is done."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

import zmav
from tests.agents.planner.execute.fleet import HOME, ORIGIN, PATIENCE_S, ROUTER, Fleet, airborne
from tests.conftest import endpoint_of
from zmav import wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import open_session
from zmav.sim import VehicleSpec, World
from zmav.swarm import FleetOrder, VehicleProgress

PLACES = [(0.0, 0.0), (0.0, 7.0), (7.0, 0.0)]


class Modes:
    """Every mode in which each vehicle was armed, and whether it was armed when an order was said to be done."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.modes: dict[str, set[str]] = {name: set() for name in fleet.names}
        self.told: list[tuple[str, str, bool]] = []

    async def watch(self) -> None:
        while True:
            for name, sim in zip(self.fleet.names, self.fleet.world.vehicles, strict=True):
                self.modes[name].add(sim.status().mode)
            await asyncio.sleep(0.02)

    def tell(self, news: str | VehicleProgress) -> None:
        if isinstance(news, VehicleProgress):
            sim = self.fleet.world.vehicles[self.fleet.names.index(news.vehicle)]
            self.told.append((news.vehicle, news.status, sim.status().armed))


@contextlib.asynccontextmanager
async def over(fleet: Fleet) -> AsyncIterator[Modes]:
    modes = Modes(fleet)
    watching = asyncio.create_task(modes.watch())
    try:
        yield modes
    finally:
        watching.cancel()


async def give(fleet: Fleet, modes: Modes, verb: str = "rtl", speed: float = 6.0) -> FleetOrder:
    fleet.world.set_speed(speed)
    order = FleetOrder(fleet.z, [fleet.z.vehicle(name) for name in fleet.names], verb, wire.Order(), modes.tell)
    await order.run()
    return order


async def test_the_disarmed_is_left_out_and_done_is_landed() -> None:
    """Nobody plans: each returns by itself, which is said."""
    async with airborne(PLACES, 5.0) as fleet:
        fleet.world.set_speed(6.0)
        (landed,) = await FleetOrder(fleet.z, [fleet.z.vehicle("quad3")], "land", wire.Order()).run()
        assert (landed.status, landed.text) == ("done", "done: landed and disarmed")
        before = fleet.world.vehicles[2].status().mode
        async with over(fleet) as modes:
            order = await give(fleet, modes)
        assert sorted(modes.told) == [("quad1", "done", False), ("quad2", "done", False), ("quad3", "left_out", False)]
        assert order.told["demo", "quad3"].text == "left out: it is disarmed"
        assert order.told["demo", "quad1"].text == "done: landed and disarmed"
        assert modes.modes["quad3"] == {before}, "a vehicle on the ground is not told to return"
        (note,) = [note for note in order.notes if "each returns by itself" in note]
        assert "no planner is in charge of fleet demo" in note


@pytest.mark.timeout(300)  # a plane flies home, and where the machine is busy the simulator is slow
async def test_done_is_home_for_what_stays_armed_there() -> None:
    """A plane circles at home, a rover stands there, which cannot land: both are returning until they are there."""
    specs = [VehicleSpec(autopilot="arduplane"), VehicleSpec(autopilot="ardurover", start_ned_m=(0.0, 9.0, 0.0))]
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", speed=6.0, ready_s=0.5, home=HOME))
        session = stack.enter_context(open_session(ROUTER))
        for name, url in zip(("plane1", "rover1"), world.urls, strict=True):
            await stack.enter_async_context(Onboard(session, OnboardSettings(link=url, name=name, origin=ORIGIN)))
        z = await stack.enter_async_context(zmav.open(connect=[endpoint_of(session)]))
        plane, rover = await z.wait_for("plane1", "rover1", timeout=PATIENCE_S)
        for vehicle in (plane, rover):
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), PATIENCE_S)
            await vehicle.arm()
        await plane.takeoff(40.0)
        await asyncio.gather(plane.goto(pos=(320.0, 0.0, -40.0)), rover.goto(pos=(40.0, 9.0, 0.0)))
        order = FleetOrder(z, [plane, rover], "rtl", wire.Order(), progress=lambda v: functools.partial(hear, v.name))
        on_the_way: dict[str, list[tuple[str, float]]] = {"plane1": [], "rover1": []}

        def hear(name: str, news: dict[str, Any]) -> None:
            if "away" in news:
                on_the_way[name].append((order.told["demo", name].status, news["away"]))

        told = {each.vehicle: each for each in await order.run()}
        assert {status for heard in on_the_way.values() for status, _ in heard} == {"returning"}
        assert on_the_way["plane1"][0][1] > 250.0 and on_the_way["rover1"][0][1] > 25.0
        assert told["plane1"].text == "done: home, circling in RTL; it stays armed"
        assert told["rover1"].text == "done: home, standing in RTL; it stays armed"
        (north, east, _), (n, e, _) = (sim.status().ned_m for sim in world.vehicles)
        assert math.hypot(north, east) < 130.0 and math.hypot(n, e - 9.0) < 6.0
        assert told["plane1"].result["armed"] is True
        order = FleetOrder(z, [rover, plane], "land", wire.Order())
        landing = asyncio.create_task(order.run())
        await plane.wait_until(lambda s: s.mode != "RTL", PATIENCE_S)
        landing.cancel()  # a plane's way down takes a minute and a half
        left = order.told["demo", "rover1"]
        assert (left.status, left.text) == ("left_out", "left out: a rover does not land")
        await rover.disarm()
        await rover.wait_until(lambda s: s.armed is False, PATIENCE_S)
        (left,) = await FleetOrder(z, [rover], "rtl", wire.Order()).run()
        assert (left.status, left.text) == ("left_out", "left out: it is disarmed")
