"""Routers over UDP as between vehicles, each with its measuring part."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import zenoh

from mesh.quality.probe import Pace, Prober
from mesh.quality.publisher import LinkQualities
from tests.mesh.quality.relay import Relay
from zmav import wire
from zmav.session import SessionSettings, open_session

PATIENCE_S = 30.0
QUICK = Pace(period=0.02, per_host=1000.0, look=0.05)
"""so that a window of loss is over in a second"""


class Routers:
    """``await routers("quad1")``: a router with its measuring part; ``routers.relay(one)``: a link to it."""

    def __init__(self, stack: contextlib.AsyncExitStack) -> None:
        self._stack = stack
        self.sessions: dict[str, zenoh.Session] = {}

    async def open(
        self,
        name: str,
        *connect: str,
        cfg: tuple[str, ...] = (),
        listen: tuple[str, ...] = (),
        credentials: Path | None = None,
    ) -> int:
        """A router alone; the UDP port it listens on, with credentials by QUIC."""
        endpoints = (("quic/127.0.0.1:0?mixed_rel=1" if credentials else "udp/127.0.0.1:0?rel=1;mixed_rel=1"), *listen)
        settings = SessionSettings(
            mode="router",
            listen=endpoints,
            connect=connect,
            cfg=("scouting/delay:0", *cfg),
            credentials=str(credentials) if credentials else None,
        )
        session = self.sessions[name] = await asyncio.to_thread(open_session, settings)
        self._stack.push_async_callback(asyncio.to_thread, session.close)
        (locator,) = (each for each in self.locators(name) if each.startswith(("udp/", "quic/")))
        return int(locator.partition("?")[0].rpartition(":")[2])

    def locators(self, name: str) -> list[str]:
        session = self.sessions[name]
        (reply,) = session.get(f"@/{session.info.zid()}/router")
        assert reply.ok is not None
        found: list[str] = json.loads(reply.ok.payload.to_bytes())["locators"]
        return found

    async def measure(self, name: str, pace: Pace = QUICK, fleet: str = "demo") -> LinkQualities:
        session = self.sessions[name]
        part = LinkQualities(session, fleet, name, Prober(session, fleet, name, pace), period=0.05)
        return await self._stack.enter_async_context(part)

    def relay(self, port: int) -> Relay:
        return self._stack.enter_context(Relay(port))


@pytest.fixture
async def routers() -> AsyncIterator[Routers]:
    async with contextlib.AsyncExitStack() as stack:
        yield Routers(stack)


def known(part: LinkQualities, name: str) -> wire.NeighbourQuality:
    """What was last published of a neighbour."""
    return part.latest[name]
