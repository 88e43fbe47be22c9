"""A router, clients of it, and what is heard on ``@fleet/traffic`` there."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from ground.traffic.feeds import Feed
from ground.traffic.program import LISTEN_S, TrafficProgram, TrafficSettings
from zmav import keys, wire
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.conftest import Net, Samples

ORIGIN = wire.Origin(lat_deg=47.3977, lon_deg=8.5456, alt_amsl=488.0)


class Sky:
    """One router, and the reports that are heard there. The first program that runs has listened long enough."""

    def __init__(self, net: Net) -> None:
        self.net, self._running = net, 0
        self.ahead = 0.0
        """s by which the programs' clock is ahead"""
        self.router, self.endpoint = net.router()
        self.samples: Samples = net.ground(self.endpoint).samples(keys.TRAFFIC)
        self.said: list[str] = []

    @property
    def reports(self) -> list[wire.Traffic]:
        return [wire.decode(payload, wire.Traffic, "traffic") for _, payload in self.samples.items]

    @property
    def last(self) -> dict[str, wire.Aircraft]:
        """The aircraft of the last report, by callsign."""
        reports = self.reports
        return {each.callsign: each for each in reports[-1].aircraft} if reports else {}

    @contextlib.asynccontextmanager
    async def client(self) -> AsyncIterator[zmav.Client]:
        async with zmav.open(settings=SessionSettings(connect=[self.endpoint])) as z:
            yield z

    @contextlib.asynccontextmanager
    async def program(self, *feeds: Feed, **more: Any) -> AsyncIterator[TrafficProgram]:
        known = {"name": "gs", "at": (ORIGIN.lat_deg, ORIGIN.lon_deg), **more}

        class Program(TrafficProgram):
            clock = staticmethod(lambda: time.monotonic() + self.ahead)

        async with (
            self.client() as z,
            Program(z, TrafficSettings(feeds=feeds, **known), self.said.append) as one,
        ):
            self.ahead += 0.0 if self._running else LISTEN_S
            self._running += 1
            yield one
            self._running -= 1


@pytest.fixture
def sky(net: Net) -> Sky:
    return Sky(net)
