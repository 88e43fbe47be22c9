"""A route in wind, with a typical autopilot's noise, by a PX4 hexarotor's own cascade."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

import pytest

import zmav
from agents.navigator.agent import Navigator
from tests.agents.navigator.behind import Behind
from tests.services.authority.test_levels_flown import ORIGIN, free_udp_port
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 60.0
SPEED = 1.5  # m/s


@pytest.mark.slow
async def test_a_hexarotor_flies_ev3_in_wind_and_noise(net: Net, onboard: StartOnboard) -> None:
    port = free_udp_port()
    spec = VehicleSpec(autopilot="px4", airframe="hexa", firmware="1.13", sysid=1, endpoints=(f"onboard:0:{port}",))
    async with contextlib.AsyncExitStack() as stack:
        wind = {"wind": (3.0, 2.0, 0.0), "gusts": "light", "noise": "typical"}
        world = stack.enter_context(World([spec], ready_s=0.5, seed=3, speed=6.0, **wind))  # type: ignore[arg-type]
        session, endpoint = net.router()
        await onboard(session, f"udpin:127.0.0.1:{port}", name="hex1", origin=ORIGIN)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        (vehicle,) = await z.wait_for("hex1", timeout=PATIENCE_S)
        await vehicle.wait_until(lambda s: bool(s.ready and s.local), PATIENCE_S)
        await vehicle.arm()
        await vehicle.takeoff(5.0)
        world.set_speed(1.0)
        navigator = Navigator(z, "hex1", None, {"accel": 2.0, "jerk": 6.0, "settle": 1.0})
        await stack.enter_async_context(navigator)
        running = asyncio.create_task(navigator.run())
        async with Behind(world) as behind:
            told = await vehicle.tell("navigator", "fly", route="ev3", side=3.0, height=1.5, speed=SPEED)
            assert told["length"] == 21.0
            assert navigator.flight is not None
            await asyncio.wait({navigator.flight}, timeout=2 * told["seconds"])
        found = navigator.last
        assert found is not None
        assert navigator._text.startswith("flew ev3")
        assert found.samples > 15 * (found.seconds - behind.whole)
        assert found.rms < 0.8 + SPEED * behind.most
        assert found.peak < 2.0 + SPEED * behind.most
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
