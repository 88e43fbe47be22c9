"""The autopilot's own battery failsafe, in the simulator: what nobody's hold and no lost stream takes away from it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from tests.descents import COPTER_HOME, PX4_DOWN
from tests.failsafe.test_px4_flight import HOME, SPEED, stream_until
from zmav.config import Failsafe
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

LOW_MAH = 3290.0
"""mAh left at which the simulated copter's full battery is low at once"""


@contextlib.asynccontextmanager
async def flying(
    net: Net, onboard: StartOnboard, autopilot: Any, params: dict[str, float]
) -> AsyncIterator[tuple[World, str]]:
    """A copter in the air, whose ladder alone would never send it anywhere, and where clients find it."""
    spec = VehicleSpec(autopilot=autopilot, params=params)
    with World([spec], endpoint="tcp:127.0.0.1:0", speed=SPEED, ready_s=1.0) as world:
        session, endpoint = net.router()
        await onboard(session, world.urls[0], origin=HOME, failsafe=Failsafe(hold_after=2.0, land_after="never"))
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), 30.0)
            await vehicle.arm()
            await vehicle.takeoff(6.0)
        yield world, endpoint


@pytest.mark.parametrize(("rule", "mode"), [(1.0, "RTL"), (2.0, "LAND")])
async def test_px4_s_comes_through_a_stream(net: Net, onboard: StartOnboard, rule: float, mode: str) -> None:
    """It waits in HOLD first, for the pilot; to order that HOLD, as after a lost stream, would end it."""
    params = {"COM_OF_LOSS_T": 10.0, "COM_LOW_BAT_ACT": rule, "COM_FAIL_ACT_T": 5.0, **PX4_DOWN}
    async with flying(net, onboard, "px4", params) as (world, endpoint), zmav.open(connect=[endpoint]) as z:
        (vehicle,) = await z.wait_for("quad1")
        async with vehicle.lease("alice", ttl=60.0) as lease:
            await stream_until(lease, vehicle, "OFFBOARD")
            power = world.vehicles[0].px4.power
            world.call(lambda: power.battery.drain(power.index, 0.06))

            async def stream() -> None:
                with contextlib.suppress(zmav.errors.NotHolder):
                    while True:
                        lease.setpoint(vel=(1.0, 0.0, 0.0))
                        await asyncio.sleep(0.05)

            streaming = asyncio.create_task(stream())
            await vehicle.wait_until(lambda s: s.mode == mode, 20.0)
            streaming.cancel()
            assert vehicle.state.lease is None
        await vehicle.wait_until(lambda s: s.armed is False, 60.0)


async def test_who_hovers_after_a_hold_goes_home_by_it(net: Net, onboard: StartOnboard) -> None:
    """The one who ordered the hold is gone for good; nothing else of ours would end it."""
    async with flying(net, onboard, "arducopter", {"BATT_FS_LOW_ACT": 2.0, **COPTER_HOME}) as (world, endpoint):
        async with zmav.open(connect=[endpoint]) as z:
            await (await z.wait_for("quad1"))[0].hold()
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            assert (await vehicle.wait_until(lambda s: s.connected, 10.0)).mode == "GUIDED"
            world.call(lambda: world.vehicles[0].copter.params.set("BATT_LOW_MAH", LOW_MAH))
            await vehicle.wait_until(lambda s: s.mode == "RTL", 10.0)
            await vehicle.wait_until(lambda s: s.armed is False, 60.0)
