"""One vehicle to fly or drive, whatever it is: the embedded simulator under each autopilot's rules, or any link of the
person's choosing (``make conformance LINK=tcp:127.0.0.1:5760``). What it can be asked is in :mod:`.kinds`.

Every check brings the vehicle into the state it needs, so that any of them can be run alone and in any order.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
import pytest_asyncio
import zenoh

import zmav
from tests.conformance.kinds import SIMULATED, Kind, kind_of, named
from tests.conftest import endpoint_of
from zmav import keys, wire
from zmav.config import Geofence
from zmav.errors import Refused, ZmavError
from zmav.mavlink import Packer
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.sim import Remote
from zmav.vehicle import Lease, Vehicle

LINK = os.environ.get("ZMAV_LINK", "")
NAME = "dut"
GCS = (255, 190)

CONNECT_S, READY_S, MOVE_S = 60.0, 180.0, 90.0
"""s: patience with a vehicle that may be booting, waiting for its EKF, or flying a few tens of metres"""
PERIOD = 0.1
"""s between setpoints"""
HURRY = 8.0
"""times real time that a simulated vehicle goes, while it does something long by itself"""


class Flight:
    """The vehicle under test, seen as an agent sees it, and what each check needs done first."""

    def __init__(self, client: zmav.Client, onboard: Onboard, simulator: Remote | None) -> None:
        self.client, self.onboard, self._simulator = client, onboard, simulator
        self.vehicle: Vehicle = client.vehicle(NAME)
        self.events: list[wire.Event] = []
        self.home: wire.Vector | None = None
        """where it was armed last, as far as that is known"""
        client.session.declare_subscriber(keys.EVENT.key("demo", NAME), self._on_event)

    def _on_event(self, sample: zenoh.Sample) -> None:
        self.events.append(wire.decode(sample.payload.to_bytes(), wire.Event, "event"))

    @property
    def state(self) -> wire.VehicleState:
        return self.vehicle.state

    @property
    def kind(self) -> Kind:
        """What it can be asked."""
        return kind_of(self.state)

    def away(self, place: wire.Vector) -> float:
        """Metres from a place of the fleet's frame; over the ground alone for what cannot choose its height."""
        local = self.state.local
        if local is None:
            return math.inf
        return math.dist(local, place) if self.kind.height and self.kind.rests else math.dist(local[:2], place[:2])

    async def until(self, true: Callable[[wire.VehicleState], bool], seconds: float, what: str) -> wire.VehicleState:
        """Wait for a state; the failure says what was waited for and what the vehicle said meanwhile."""
        try:
            return await self.vehicle.wait_until(true, seconds)
        except ZmavError as e:
            said = "; ".join(event.text for event in self.events[-8:])
            raise AssertionError(f"{what}: {e}. State: {_brief(self.vehicle.last_state)}. It said: {said}") from e

    async def event(self, words: str, since: int, seconds: float = 10.0) -> wire.Event:
        """The first event with these words after the first ``since`` ones."""
        deadline = time.monotonic() + seconds
        while True:
            for event in self.events[since:]:
                if words in event.text:
                    return event
            if not await self.client.news(deadline - time.monotonic()) and time.monotonic() > deadline:
                raise AssertionError(f"no event {words!r} among {[e.text for e in self.events[since:]]}")

    @contextlib.contextmanager
    def hurried(self) -> Iterator[None]:
        """What is the vehicle's own business (a landing, a way home) takes less time, where it is simulated."""
        if self._simulator is None:
            yield
            return
        self._simulator.speed(HURRY)
        try:
            yield
        finally:
            self._simulator.speed(1.0)

    # Where a check begins.

    async def connected(self) -> None:
        await self.until(lambda s: s.connected and s.uid is not None, CONNECT_S, "an autopilot")

    async def ready(self) -> None:
        await self.connected()
        if self.state.mode == "OFFBOARD" and not self.state.armed:
            await self.vehicle.set_mode("HOLD")  # PX4 is never ready where a lost stream has left it
        await self.until(lambda s: bool(s.ready) or bool(s.armed), READY_S, "ready to arm")

    async def on_ground(self) -> None:
        """Disarmed on the ground, whatever the last check left."""
        await self.ready()
        if self.state.armed:
            try:
                await self.vehicle.disarm()
            except (Refused, ZmavError):
                with self.hurried():
                    await self.vehicle.land()
        await self.until(lambda s: s.armed is False, MOVE_S, "disarmed")

    async def under_way(self) -> None:
        """Armed where it can be moved, in nobody's hands: a copter hovers, a rover stands, a plane circles."""
        await self.ready()
        kind = self.kind
        high = not kind.height or (self.state.position and self.state.position.alt_rel > 0.6 * kind.height)
        if not (self.state.armed and high):
            await self.on_ground()
            self.home = self.offset(0.0, 0.0)
            await self.vehicle.arm()
            if kind.height:
                with self.hurried():
                    await self.vehicle.takeoff(kind.height)
        await self.vehicle.hold()
        if kind.rests:
            with self.hurried():
                await self.until(lambda s: speed(s) < 0.5, 30.0, "at rest")

    # What a check does.

    @asynccontextmanager
    async def streaming(self, lease: Lease, **point: Any) -> AsyncIterator[None]:
        """Stream one setpoint at 10 Hz meanwhile."""
        task = asyncio.create_task(stream(lease, **point))
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    def offset(self, north: float, east: float, up: float = 0.0) -> wire.Vector:
        """A point so many metres from where it is, in the fleet's frame."""
        local = self.state.local
        assert local is not None
        return local[0] + north, local[1] + east, local[2] - up

    async def gcs_mode(self, mode: str) -> None:
        """A pilot's or a ground station's change of mode, past all of zmav's own orders."""
        autopilot = self.onboard.identity.autopilot
        assert autopilot is not None
        command = autopilot.mode(mode).command
        packer = Packer(self.onboard.adapter.dialect, *GCS)
        number = packer.dialect.value("MAV_CMD", command.name)
        params = {f"param{i + 1}": value for i, value in enumerate(command.padded())}
        frame = packer.pack(
            "COMMAND_LONG", target_system=self.state.sysid, target_component=1, command=number, **params
        )
        key = keys.TX.key("demo", NAME, sys=self.state.sysid, comp=1, msg="COMMAND_LONG")
        self.client.put(keys.TX, key, frame)
        await self.until(lambda s: s.mode == mode, 10.0, f"mode {mode}")


async def stream(lease: Lease, **point: Any) -> None:
    """Put a setpoint at 10 Hz until cancelled, or until the lease is lost."""
    while True:
        lease.setpoint(**point)
        await asyncio.sleep(PERIOD)


def speed(state: wire.VehicleState) -> float:
    """m/s over the ground and up."""
    return sum(v * v for v in state.velocity) ** 0.5 if state.velocity else 0.0


def _brief(state: wire.VehicleState | None) -> str:
    if state is None:
        return "none"
    names = ("mode", "armed", "ready", "not_ready", "local", "velocity", "lease", "setpoints")
    return json.dumps({name: msgspec.to_builtins(getattr(state, name)) for name in names})


@contextlib.contextmanager
def simulated(kind: Kind, control: Path) -> Iterator[tuple[str, Remote]]:
    """The link URL of a simulated vehicle of that kind, in a process of its own as any other autopilot, and a word with
    its simulator.
    """
    onboard = f"onboard:0:{free_port(socket.SOCK_DGRAM)}" if kind.autopilot == "px4" else "tcp:127.0.0.1:0"
    what = [*kind.simulate, "--endpoint", onboard, "--control", str(control)]
    process = subprocess.Popen([sys.executable, "-m", "zmav", "sim", *what], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        with Remote(control) as simulator:
            yield url, simulator
    finally:
        process.terminate()
        process.wait(10)


@pytest_asyncio.fixture(scope="module", loop_scope="module", params=[LINK] if LINK else SIMULATED)
async def flight(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Flight]:
    """The vehicle under test, connected or about to be."""
    with contextlib.ExitStack() as stack:
        url, simulator = LINK, None
        if not LINK:
            control = tmp_path_factory.mktemp("sim") / "control"
            url, simulator = stack.enter_context(simulated(named(request.param), control))
        router = stack.enter_context(open_session(SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"])))
        async with zmav.open(connect=[endpoint_of(router)]) as client:
            origin = await find_origin(router, client, url)
            # A plane's circles and the ways to them are wider than a club's field.
            settings = OnboardSettings(link=url, name=NAME, origin=origin, geofence=Geofence(radius=5000.0))
            async with Onboard(router, settings) as onboard:
                flight = Flight(client, onboard, simulator)
                if simulator is not None:
                    await flight.connected()
                    for name, value in named(request.param).shorter.items():
                        await flight.vehicle.params.set(name, value)
                yield flight


async def find_origin(router: zenoh.Session, client: zmav.Client, url: str) -> wire.Origin:
    """Where the vehicle stands: the fleet's origin of these flights."""
    async with Onboard(router, OnboardSettings(link=url, name="scout")):  # whose last words are nobody else's
        vehicle = client.vehicle("scout")
        await vehicle.wait_until(lambda s: s.position is not None, READY_S)
        position = vehicle.state.position
        assert position is not None
        return wire.Origin(lat_deg=position.lat_deg, lon_deg=position.lon_deg, alt_amsl=position.alt_amsl)
