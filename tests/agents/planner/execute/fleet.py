"""Simulated copters in the air, their agents, and a client that may hear and reach them badly."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import zenoh

import zmav
from tests.conftest import endpoint_of
from tests.descents import COPTER_DOWN
from tests.waiting import Watcher
from zmav import keys, wire
from zmav.client import Answer
from zmav.config import BodyConfig
from zmav.errors import ZmavError
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import Home, VehicleSpec, World
from zmav.waiting import together

PATIENCE_S = 60.0
HOME = Home()
ORIGIN = wire.Origin(lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg, alt_amsl=HOME.alt_amsl_m)
NEAR = BodyConfig(position_error=0.05)
"""of copters that know where they are: what they keep between their layers is little, and so is the way up and down"""
ROUTER = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))


class Fleet:
    """``world`` runs at real time once everybody is in the air; ``z`` is the planner's client."""

    def __init__(self, z: zmav.Client, world: World, names: list[str], endpoint: str) -> None:
        self.z, self.world, self.names, self.endpoint = z, world, names, endpoint

    async def rise(self, height: float) -> None:
        """Once all are ready, to that height (0: not), quickly; from then on at real time."""
        vehicles = await self.z.wait_for(*self.names, timeout=PATIENCE_S)
        await together(*(_rise(vehicle, height) for vehicle in vehicles))
        self.world.set_speed(1.0)

    def watch(self) -> Watch:
        return Watch(self)

    def places(self) -> dict[str, wire.Vector]:
        """Where they truly are: NED."""
        return {n: sim.status().ned_m for n, sim in zip(self.names, self.world.vehicles, strict=True)}

    @contextlib.contextmanager
    def quickly(self) -> Iterator[None]:
        """For what the autopilots fly by themselves, to no plan's clock."""
        self.world.set_speed(6.0)
        try:
            yield
        finally:
            self.world.set_speed(1.0)

    async def up_again(self, vehicle: zmav.Vehicle, place: wire.Vector | None) -> None:
        """Where the next test has it."""
        await vehicle.arm()
        rising = asyncio.create_task(vehicle.takeoff(10.0))
        await vehicle.wait_until(lambda s: s.landed is False, PATIENCE_S)  # hurried, it might disarm before
        with self.quickly():
            await rising
            await vehicle.goto(pos=place)


class Watch(Watcher):
    """Where everybody truly is, many times a second, as long as the ``async with`` lasts."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self.rows: list[tuple[float, dict[str, wire.Vector]]] = []

    async def _look(self) -> None:
        while True:
            self.rows.append((time.monotonic(), self._fleet.places()))
            await asyncio.sleep(0.05)

    def least(self, downwash: float) -> float:
        """m of the nearest two at any time."""
        return min(
            math.hypot(p[0] - q[0], p[1] - q[1], (p[2] - q[2]) / downwash)
            for _, places in self.rows
            for p, q in itertools.combinations(places.values(), 2)
        )

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until it holds, looked at with every row."""
        deadline = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < deadline, what
            await asyncio.sleep(0.05)

    def still(self, seconds: float) -> bool:
        """Nobody has moved by a decimetre within the last seconds."""
        last, places = self.rows[-1]
        before = [row for t, row in self.rows if t <= last - seconds]
        return bool(before) and all(math.dist(before[-1][name], places[name]) < 0.1 for name in places)

    def moved(self) -> float:
        """m that the one has come that has come farthest."""
        first, last = self.rows[0][1], self.rows[-1][1]
        return max(math.dist(first[name], last[name]) for name in first)


@contextlib.asynccontextmanager
async def airborne(starts: Sequence[tuple[float, float]], height: float, **how: Any) -> AsyncIterator[Fleet]:
    """Copters above these places (m north and east), or on them (``height`` 0); ``how``: as for ``starting``."""
    async with starting(starts, **how) as fleet:
        await fleet.rise(height)
        yield fleet


@contextlib.asynccontextmanager
async def starting(
    starts: Sequence[tuple[float, float]],
    *,
    autopilot: str = "arducopter",
    params: Mapping[str, float] = COPTER_DOWN,
    weather: Mapping[str, Any] = {},
    **settings: Any,
) -> AsyncIterator[Fleet]:
    """They have power just now, and time goes fast until they ``rise``; ``params`` are ArduCopter's, ``weather`` the
    world's: noise, seed, wind, gusts.
    """
    names = [f"quad{i + 1}" for i in range(len(starts))]
    own = dict(params) if autopilot == "arducopter" else {}
    specs = [VehicleSpec(autopilot=autopilot, start_ned_m=(n, e, 0.0), params=own) for n, e in starts]
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", speed=6.0, ready_s=0.5, home=HOME, **weather))
        router = stack.enter_context(open_session(ROUTER))
        for name, url in zip(names, world.urls, strict=True):
            team = Onboard(router, OnboardSettings(link=url, name=name, origin=ORIGIN, **settings))
            await stack.enter_async_context(team)
        endpoint = endpoint_of(router)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        yield Fleet(z, world, names, endpoint)


async def _rise(vehicle: zmav.Vehicle, height: float) -> None:
    await vehicle.wait_until(lambda s: bool(s.connected and s.ready), PATIENCE_S)
    if height <= 0.0:
        return
    if (vehicle.last_state or wire.VehicleState(t=0, fleet="", name="", instance="")).kind != "rover":
        await vehicle.arm()
        await vehicle.takeoff(height)
    else:
        await vehicle.arm()


class BadClient(zmav.Client):
    """What it puts, asks and hears of states is lost and late."""

    def __init__(self, endpoint: str, loss: float, delay: tuple[float, float], seed: int = 0) -> None:
        super().__init__(SessionSettings(connect=[endpoint]), "demo", "ardupilotmega")
        self._loss, self._delay, self._random = loss, delay, random.Random(seed)
        self.lost = self.passed = 0
        self.cut = False
        """nothing goes through at present"""

    async def __aenter__(self) -> BadClient:
        await super().__aenter__()
        return self

    def _late(self) -> float | None:
        """Seconds that a message takes; None: it is lost."""
        gone = self.cut or self._random.random() < self._loss
        self.lost += gone
        self.passed += not gone
        return None if gone else self._random.uniform(*self._delay)

    def put(
        self,
        channel: keys.Channel,
        key: str,
        payload: bytes | msgspec.Struct,
        attachment: bytes | None = None,
        publisher: zenoh.Publisher | None = None,
    ) -> None:
        late = self._late()
        if late is not None:
            asyncio.get_running_loop().call_later(late, super().put, channel, key, payload, attachment, publisher)

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        timeout: float = 2.0,
        channel: keys.Channel = keys.DO,
        enough: Callable[[Answer], bool] = lambda answer: False,
    ) -> list[Answer | ZmavError]:
        there, back = self._late(), self._late()
        if there is not None:
            await asyncio.sleep(there)
            answers = await super().ask(key, payload, timeout, channel, enough)
            if back is not None:
                await asyncio.sleep(back)
                return answers
        await asyncio.sleep(timeout)
        return []

    def _on_state(self, sample: zenoh.Sample) -> None:
        late = self._late()
        if late is not None:
            asyncio.get_running_loop().call_later(late, super()._on_state, sample)
