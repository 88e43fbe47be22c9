"""A simulated hexarotor in the air under PX4's rules, with its agent, and supervisors of controllers for it."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

import zmav
from agents.controllers.cycle import Cycles
from agents.controllers.settings import ControllerSettings
from agents.controllers.supervisor import Supervisor
from tests.conftest import endpoint_of
from zmav import keys, wire
from zmav.config import PilotSwitch
from zmav.errors import TimedOut
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec, World
from zmav.sim.autopilots.px4.modes import HOLD
from zmav.sim.external import Externals

PATIENCE_S = 60.0
RATE_HZ = 100.0
SPEED = 6.0
"""of the world while nobody controls anything yet"""
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
SWITCH = PilotSwitch(channel=7)
"""PX4's radio: this channel is free for it"""
BEHIND_S = 0.03
"""simulated s without an output after which the world waits for one"""
STALL_S = 0.6
"""s that it waits: the supervisor takes more than one without an attitude for the autopilot's end"""
HOVER = (0.0, 0.0, -10.0)
"""where each test begins, m NED"""


class InStep(Externals):
    """Has the world wait for the outputs of a controller that flies, as it waits for a flight stack outside: where the
    machine stalls, simulated time does too. Not for long: a controller that hangs is to be found out.
    """

    def __init__(self) -> None:
        self.cycles: Cycles | None = None
        self._now = self._came = self._since = 0.0
        self._outputs = 0

    def grant(self, now: float) -> None:
        self._now = now

    def behind(self) -> bool:
        if self.cycles is None:
            return False
        # Before an engagement nothing is missed: its first output is waited for as those after it are.
        if not self.cycles.phase or self.cycles.counters.outputs != self._outputs:
            self._outputs, self._came, self._since = self.cycles.counters.outputs, self._now, time.monotonic()
        return self._now - self._came > BEHIND_S and time.monotonic() - self._since < STALL_S


class Field:
    """One vehicle that flies, for the tests of a module, and anyone who supervises controllers for it."""

    def __init__(self, world: World, step: InStep, z: zmav.Client, vehicle: zmav.Vehicle, endpoint: str) -> None:
        self.world, self.z, self.vehicle, self.endpoint = world, z, vehicle, endpoint
        self._step = step
        self._supervisor: Supervisor | None = None
        self.signals: list[wire.Signals] = []
        self._stack = contextlib.AsyncExitStack()
        self._end: Callable[[], Awaitable[None]]

    async def clear(self) -> None:
        """End what a test has started, and have the vehicle again as the first test had it."""
        await self._stack.aclose()
        self._supervisor = self._step.cycles = None
        self.signals.clear()
        if self.world.vehicles[0].spec.autopilot == "px4":
            px4 = self.world.vehicles[0].px4
            px4.pilot.flip(SWITCH.channel, 1000)
            if px4.mode is not HOLD:
                assert self.world.call(lambda: px4.set_mode(HOLD))
        await self.vehicle.wait_until(lambda s: s.lease is None and s.pilot is None, PATIENCE_S)
        if math.dist(self.world.vehicles[0].status().ned_m, HOVER) > 0.5:
            self.world.set_speed(SPEED)
            try:
                await self.vehicle.goto(pos=HOVER)
            finally:
                self.world.set_speed(1.0)

    async def supervise(self, controller: str | Path, tuned: dict[str, float] | None = None, **more: Any) -> Supervisor:
        """A supervisor whose controller is ready; it ends with the test."""
        settings = ControllerSettings(controller=str(controller), **{"rate_hz": RATE_HZ, **more})
        # Test machines are busy: a pause of a quarter of a second, or of the autopilot's, is nobody's fault here.
        patient = {"guard_late": 25.0, "guard_silent": 1.0}
        supervisor = Supervisor(self.z, self.vehicle.name, settings, {**patient, **(tuned or {})})
        supervisor.take_over = PATIENCE_S  # the world waits for outputs, and so does the autopilot
        await self._stack.enter_async_context(supervisor)
        self._supervisor, self._step.cycles = supervisor, supervisor.cycles
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
            assert time.monotonic() < deadline, f"{otherwise}; {self._state()}"
            await asyncio.sleep(0.01)

    async def wait_until(self, true: Callable[[wire.VehicleState], bool], seconds: float) -> wire.VehicleState:
        """As the vehicle's, within so many simulated seconds: on a busy machine they last longer."""
        end = self.world.time_s + seconds
        while True:
            try:
                return await self.vehicle.wait_until(true, 1.0)
            except TimedOut as e:
                assert self.world.time_s < end, f"{e.message}; {self._state()}, {self.vehicle.state}"

    def _state(self) -> str:
        """What explains a failure."""
        why = self._supervisor.why if self._supervisor is not None else "no supervisor"
        return f"{self.mode}, {why}"

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


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def flying(request: pytest.FixtureRequest) -> AsyncIterator[Field]:
    """Ten metres up. Its parameter is the vehicle's VehicleSpec: the hexarotor of 3.2 kg under PX4 1.13 by default."""
    spec = getattr(request, "param", VehicleSpec(name="hex1", autopilot="px4", airframe="hexa", firmware="1.13"))
    async with contextlib.AsyncExitStack() as stack:
        step = InStep()
        world = stack.enter_context(World([spec], endpoint="tcp:0", ready_s=0.5, externals=lambda *_, **__: step))
        how = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        session = stack.enter_context(open_session(how))
        settings = OnboardSettings(link=world.urls[0], name="hex1", origin=ORIGIN, pilot_switch=SWITCH)
        onboard = await stack.enter_async_context(Onboard(session, settings))
        onboard.identity.heartbeat_timeout = PATIENCE_S  # one comes late where the world waits for outputs
        endpoint = endpoint_of(session)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        (vehicle,) = await z.wait_for("hex1", timeout=PATIENCE_S)
        world.set_speed(SPEED)
        await vehicle.wait_until(lambda s: s.ready is True and s.local is not None, PATIENCE_S)
        if spec.autopilot == "px4":
            px4 = world.vehicles[0].px4
            px4.pilot.radio = True
            px4.pilot.sticks(throttle=0.5)
        await vehicle.arm()
        await vehicle.takeoff(-HOVER[2])
        world.set_speed(1.0)
        yield Field(world, step, z, vehicle, endpoint)


@pytest_asyncio.fixture(loop_scope="module")
async def field(flying: Field) -> AsyncIterator[Field]:
    """The module's, with nobody but the autopilot in charge and nothing supervised."""
    yield flying
    await flying.clear()
