"""An agent that streams, and what the autopilot was told because of it: shared by one acceptance test per failsafe."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.services.conftest import GUIDED, SET_MODE, Bench, Peer, Told, bench, peer
from zmav import keys, wire
from zmav.config import Failsafe

__all__ = ["bench", "peer"]  # the fixtures, for the tests here

LOCAL = "SET_POSITION_TARGET_LOCAL_NED"
FORWARD, STOP = (1.5, -0.5, 0.25), (0.0, 0.0, 0.0)
PATIENT = Failsafe(hold_after=60.0, land_after="never")
"""a stream that may pause: what ends it is then something else"""


class Px4Peer(Peer):
    """... with modes as PX4 has them."""

    def __init__(self) -> None:
        super().__init__(autopilot=12)

    def obey(self, number: int, fields: dict[str, Any]) -> None:
        if number == SET_MODE:
            self.mode = int(fields["param2"]) << 16 | int(fields["param3"]) << 24
        else:
            super().obey(number, fields)


@pytest.fixture
async def px4() -> AsyncIterator[Px4Peer]:
    one = Px4Peer()
    await one.open()
    yield one
    await one.close()


class Agent:
    """An agent with a lease, flying."""

    def __init__(self, b: Bench, holder: str, token: str) -> None:
        self.b, self.holder, self.token, self.seq = b, holder, token, 0

    def put(self, **fields: Any) -> None:
        """The next setpoint: a velocity, with what is given changed."""
        self.seq += 1
        given = {"lease": self.token, "seq": self.seq, "deadline": time.time() + 2.0, "vel": FORWARD, **fields}
        self.b.ground.put(keys.SETPOINT, wire.encode(wire.Setpoint(**given)), agent=self.holder)

    async def fly(self) -> None:
        """Put one setpoint, and see it flown."""
        before = len(moves(self.b))
        self.put()
        await self.b.peer.until(lambda: len(moves(self.b)) > before, "flown setpoint")


async def agent(b: Bench, holder: str = "alice", *, mode: int = GUIDED, **more: Any) -> Agent:
    """Armed in that mode (by its number), and the lease taken."""
    await b.connected()
    b.peer.mode, b.peer.armed = mode, True
    identity = b.vehicle.identity
    await b.state(lambda s: bool(identity.armed and identity.heartbeat["custom_mode"] == mode), "armed")  # type: ignore[index]
    return await another(b, holder, **more)


async def another(b: Bench, holder: str, **more: Any) -> Agent:
    """A lease for somebody."""
    granted = await b.ground.do("lease", **{"holder": holder, "ttl": 30, **more})
    return Agent(b, holder, granted.result["lease"])


def vel(told: Told) -> tuple[float, float, float]:
    return (told.fields["vx"], told.fields["vy"], told.fields["vz"])


def moves(b: Bench) -> list[Told]:
    """The velocities the autopilot was told, other than zero."""
    return [t for t in b.peer.heard(LOCAL) if vel(t) != STOP]


def stops(b: Bench) -> list[Told]:
    return [t for t in b.peer.heard(LOCAL) if vel(t) == STOP]


async def held(b: Bench) -> None:
    """Wait until the autopilot was told to stop."""
    await b.peer.until(lambda: bool(stops(b)), "hold")


async def nothing_more(b: Bench) -> None:
    """Nothing that moves it is sent for as long as a stream would be kept alive."""
    told = len(b.peer.heard(LOCAL)), len(b.peer.commands(SET_MODE))
    for _ in range(4):
        await b.state(lambda s: True, "a moment")  # 5 Hz
    assert (len(b.peer.heard(LOCAL)), len(b.peer.commands(SET_MODE))) == told
