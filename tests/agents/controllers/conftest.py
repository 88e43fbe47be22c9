"""A simulated hexarotor in the air under PX4's rules, with its agent, and supervisors of controllers for it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from agents.controllers.settings import ControllerSettings
from agents.controllers.supervisor import Supervisor
from zmav import keys, wire
from zmav.config import PilotSwitch
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 60.0
RATE_HZ = 100.0
SPEED = 6.0
"""of the world while nobody controls anything yet"""
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
SWITCH = PilotSwitch(channel=7)
"""PX4's radio: this channel is free for it"""


class Field:
    """One vehicle that flies, and anyone who supervises controllers for it."""

    def __init__(
        self, world: World, z: zmav.Client, vehicle: zmav.Vehicle, endpoint: str, stack: contextlib.AsyncExitStack
    ) -> None:
        self.world, self.z, self.vehicle, self.endpoint, self._stack = world, z, vehicle, endpoint, stack
        self.signals: list[wire.Signals] = []
        self._end: Callable[[], Awaitable[None]]

    async def supervise(self, controller: str | Path, tuned: dict[str, float] | None = None, **more: Any) -> Supervisor:
        """A supervisor whose controller is ready; it ends with the test."""
        settings = ControllerSettings(controller=str(controller), **{"rate_hz": RATE_HZ, **more})
        # Test machines are busy: a pause of a quarter of a second, or of the autopilot's, is nobody's fault here.
        patient = {"guard_late": 25.0, "guard_silent": 1.0}
        supervisor = Supervisor(self.z, self.vehicle.name, settings, {**patient, **(tuned or {})})
        await self._stack.enter_async_context(supervisor)
        running = asyncio.create_task(supervisor.run())

        async def end() -> None:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

        self._stack.push_async_callback(end)
        self._end = end
        await self.until(lambda: running.done() or self.ready(supervisor), "the controller is not ready")
        if running.done():
            await running
        return supervisor

    async def dismiss(self) -> None:
        """End the supervisor that came last: each has two processes."""
        await self._end()

    def ready(self, supervisor: Supervisor) -> bool:
        period = supervisor.estimate.period
        return supervisor.reloader.loaded is not None and supervisor.estimate.ready and 0.0 < period < 1.2 / RATE_HZ

    async def until(self, true: Callable[[], bool], otherwise: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < deadline, otherwise
            await asyncio.sleep(0.01)

    @property
    def mode(self) -> str:
        """By the autopilot itself."""
        vehicle = self.world.vehicles[0]
        return vehicle.px4.mode.name if vehicle.spec.autopilot == "px4" else str(vehicle.copter.mode)

    async def listen(self, agent: str) -> None:
        """Collect an agent's signals from now on."""

        async def take() -> None:
            key = keys.AGENT_OUT.key("demo", self.vehicle.name, agent=agent, topic="signals")
            read = lambda s: wire.decode(s.payload.to_bytes(), wire.Signals, "signals")  # noqa: E731
            async with self.z.subscribe(key, read) as heard:
                async for signals in heard:
                    self.signals.append(signals)

        task = asyncio.create_task(take())
        self._stack.callback(task.cancel)


@pytest.fixture
async def field(net: Net, onboard: StartOnboard, request: pytest.FixtureRequest) -> AsyncIterator[Field]:
    """Ten metres up. Its parameter is the vehicle's VehicleSpec: the hexarotor of 3.2 kg under PX4 1.13 by default."""
    spec = getattr(request, "param", VehicleSpec(name="hex1", autopilot="px4", airframe="hexa", firmware="1.13"))
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World([spec], endpoint="tcp:0", ready_s=0.5))
        session, endpoint = net.router()
        await onboard(session, world.urls[0], name="hex1", origin=ORIGIN, pilot_switch=SWITCH)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        (vehicle,) = await z.wait_for("hex1", timeout=PATIENCE_S)
        await vehicle.wait_until(lambda s: s.ready is True and s.local is not None, PATIENCE_S)
        if spec.autopilot == "px4":
            px4 = world.vehicles[0].px4
            px4.sticks.radio = True
            px4.sticks.pilot.sticks(throttle=0.5)
        world.set_speed(SPEED)
        await vehicle.arm()
        await vehicle.takeoff(10.0)
        world.set_speed(1.0)
        yield Field(world, z, vehicle, endpoint, stack)
