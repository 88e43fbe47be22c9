"""The network between the agent and the vehicle stops carrying, without a word: no connection is closed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

import zmav
from tests.failsafe.conftest import PATIENT, agent, held, moves, stops
from tests.services.conftest import StartBench
from zmav.errors import NotHolder


class Cable:
    """A TCP proxy that can be cut: both connections stay, and nothing comes through any more."""

    def __init__(self, endpoint: str) -> None:
        self._host, _, self._port = endpoint.removeprefix("tcp/").rpartition(":")
        self.whole = asyncio.Event()
        self.whole.set()
        self._tasks: list[asyncio.Task[None]] = []
        self._server: asyncio.Server | None = None

    async def open(self) -> str:
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        return f"tcp/127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    def close(self) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(self._host, int(self._port))
        for way in ((reader, far_writer), (far_reader, writer)):
            self._tasks.append(asyncio.create_task(self._carry(*way)))

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                await self.whole.wait()
                writer.write(data)
        writer.close()


@pytest.fixture
async def cable() -> AsyncIterator[list[Cable]]:
    cables: list[Cable] = []
    yield cables
    for each in cables:
        each.close()


async def flown_over(bench: StartBench, cables: list[Cable], settings: object = None) -> None:
    b = await bench(settings=settings)
    alice = await agent(b, "alice")
    await b.ground.do("release", lease=alice.token)
    cables.append(Cable(b.endpoint))
    async with zmav.open(connect=[await cables[0].open()]) as z:
        (vehicle,) = await z.wait_for("quad1")
        async with vehicle.lease("bob", ttl=60) as lease:
            while len(moves(b)) < 6:
                lease.setpoint(vel=(1.5, -0.5, 0.25))
                await asyncio.sleep(0.05)
            assert stops(b) == []
            cables[0].whole.clear()
            for _ in range(4):
                lease.setpoint(vel=(1.5, -0.5, 0.25))
            cut = asyncio.get_running_loop().time()
            await held(b)
            assert not [t for t in moves(b) if t.at > stops(b)[0].at]
            if settings is None:
                assert stops(b)[0].at - cut < 2.0  # 0.5 s, and what a busy machine adds
            said = await b.event("bob, who held the lease, is gone", kind="lease")
            assert said["detail"]["reason"] == "gone"
            # The cable is mended: the lease is over, and its holder hears of it.
            cables[0].whole.set()
            while lease.lost is None:
                await asyncio.sleep(0.05)
            assert lease.lost.detail["reason"] == "gone"
            with pytest.raises(NotHolder, match="is gone"):
                lease.setpoint(vel=(1.5, -0.5, 0.25))


async def test_it_holds_by_the_silence(bench: StartBench, cable: list[Cable]) -> None:
    await flown_over(bench, cable)


async def test_it_holds_by_the_loss_of_liveliness(bench: StartBench, cable: list[Cable]) -> None:
    await flown_over(bench, cable, {"failsafe": PATIENT})
