"""A vehicle on the bench: a small autopilot made of one UDP socket, the Onboard before it, and the ground behind that.

The autopilot does what a test tells it to the last frame, which neither a real one nor the simulator can.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from zmav import keys
from zmav.mavlink import Dialect, Packer, Splitter, decode, load_dialect
from zmav.onboard import Onboard

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, Samples, StartOnboard

PATIENCE_S = 30.0
BEAT_S = 0.1
ARMED, CUSTOM = 128, 1
STABILIZE, GUIDED, LOITER, LAND = 0, 4, 5, 9
ACCEPTED, FAILED, IN_PROGRESS = 0, 4, 5
SET_MODE, ARM, SET_INTERVAL, REQUEST_MESSAGE, TAKEOFF = 176, 400, 511, 512, 22
VERSION = 148


class Told(NamedTuple):
    """A message the autopilot was sent."""

    name: str
    fields: dict[str, Any]
    source: tuple[int, int]
    seq: int
    at: float
    """s of the event loop's clock"""


class Peer(asyncio.DatagramProtocol):
    """An autopilot: beats, keeps a mode and arming, and answers commands by ``results`` (ACCEPTED unless given).

    ``mute`` are commands it does not answer; ``told`` is all it was sent, ``sent`` what it sent itself.
    """

    def __init__(self, sysid: int = 1, *, mav_type: int = 2, autopilot: int = 3, uid: int = 1) -> None:
        self.dialect: Dialect = load_dialect()
        self.mav_type, self.autopilot, self.uid = mav_type, autopilot, uid
        self.mode, self.armed = STABILIZE, False
        self.capabilities = 0
        self.told: list[Told] = []
        self.sent: list[bytes] = []
        self.results: dict[int, list[int]] = {}
        """what to answer a command with, one after the other; a last one is kept"""
        self.mute: set[int] = set()
        self.beating = True
        self.obedient = True
        """it does what it has acknowledged"""
        self.place: tuple[float, float] | None = None
        """where it says that it is with each beat, 10 m above a home at 600 m, until a test sends another place"""
        self.on_told: Callable[[Told], None] = lambda told: None
        """what a test answers by itself"""
        self.packer = Packer(self.dialect, sysid, 1)
        self._splitter = Splitter(self.dialect)
        self._news = asyncio.Event()
        self._transport: asyncio.DatagramTransport | None = None
        self._companion: Any = None
        self._heart: asyncio.Task[None] | None = None

    @property
    def url(self) -> str:
        """The link to it."""
        assert self._transport is not None
        host, port = self._transport.get_extra_info("sockname")
        return f"udpout:{host}:{port}"

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=("127.0.0.1", 0))
        self._heart = loop.create_task(self._beat())

    async def close(self) -> None:
        assert self._heart is not None
        assert self._transport is not None
        self._heart.cancel()
        self._transport.close()

    # Out.

    def send(self, name: str, **fields: Any) -> None:
        if name == "GLOBAL_POSITION_INT":
            self.place = None
        self.raw(self.packer.pack(name, **fields))

    def raw(self, data: bytes) -> None:
        if self._companion is not None and self._transport is not None:
            self._transport.sendto(data, self._companion)
            self.sent.append(data)

    def heartbeat(self) -> None:
        armed = ARMED if self.armed else 0
        self.send(
            "HEARTBEAT",
            type=self.mav_type,
            autopilot=self.autopilot,
            base_mode=CUSTOM | armed,
            custom_mode=self.mode,
            system_status=4,
        )

    async def _beat(self) -> None:
        while True:
            if self.beating:
                self.heartbeat()
                if self.place is not None:
                    lat, lon = (round(degrees * 1e7) for degrees in self.place)
                    self.raw(self.packer.pack("GLOBAL_POSITION_INT", lat=lat, lon=lon, alt=610000, relative_alt=10000))
            await asyncio.sleep(BEAT_S)

    # In.

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._companion = addr
        for frame in self._splitter.feed(data):
            name, now = self.dialect.name_of(frame.msgid), asyncio.get_running_loop().time()
            told = Told(name, decode(frame, self.dialect), (frame.sysid, frame.compid), frame.seq, now)
            self.told.append(told)
            self.on_told(told)
            if told.name in ("COMMAND_LONG", "COMMAND_INT"):
                self.command(told)
        self._news.set()

    def command(self, told: Told) -> None:
        """Answer one command, and do it where the answer is yes."""
        number = told.fields["command"]
        if number in self.mute:
            return
        results = self.results.get(number, [ACCEPTED])
        result = results.pop(0) if len(results) > 1 else results[0]
        if result == ACCEPTED and self.obedient:
            self.obey(number, told.fields)
        self.acknowledge(number, result, told.source)
        if (number, told.fields["param1"]) == (REQUEST_MESSAGE, VERSION):
            can = self.capabilities
            self.send("AUTOPILOT_VERSION", uid=self.uid, flight_sw_version=0x04070000, capabilities=can)

    def obey(self, number: int, fields: dict[str, Any]) -> None:
        if number == SET_MODE:
            self.mode = int(fields["param2"])
        elif number == ARM:
            self.armed = fields["param1"] == 1

    def acknowledge(self, number: int, result: int, to: tuple[int, int] = (0, 0)) -> None:
        self.send("COMMAND_ACK", command=number, result=result, target_system=to[0], target_component=to[1])

    def heard(self, name: str, **fields: Any) -> list[Told]:
        """The messages of that name it was sent, with these fields."""
        return [t for t in self.told if t.name == name and fields.items() <= t.fields.items()]

    async def count(self, name: str, count: int) -> None:
        """Wait until it was sent so many messages of that name."""
        await self.until(lambda: len(self.heard(name)) >= count, f"{count} of {name}")

    def commands(self, number: int) -> list[Told]:
        return self.heard("COMMAND_LONG", command=number)

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until ``true()`` holds; it is asked again after each datagram."""

        async def wait() -> None:
            while not true():
                self._news.clear()
                await self._news.wait()

        try:
            await asyncio.wait_for(wait(), PATIENCE_S)
        except asyncio.TimeoutError:
            raise AssertionError(f"no {what}; it was told {self.told[-5:]}") from None


class Bench(NamedTuple):
    """One vehicle from end to end; ``endpoint`` is where its router listens."""

    peer: Peer
    endpoint: str
    vehicle: Onboard
    ground: Ground
    states: Samples
    events: Samples

    async def state(self, true: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """Wait for a state as wanted, from now on."""
        return await self.states.object(true, what, after=len(self.states.items))

    async def event(self, words: str, **same: Any) -> dict[str, Any]:
        """The first event with these words."""
        return await self.events.object(lambda e: words in e["text"] and same.items() <= e.items(), f"event {words!r}")

    async def connected(self) -> Bench:
        await self.state(lambda s: s["connected"] and s["uid"], "connected state with a uid")
        return self

    async def flying(self) -> Bench:
        """Armed in GUIDED, as setpoints need it."""
        self.peer.mode, self.peer.armed = GUIDED, True
        await self.state(lambda s: s["mode"] == "GUIDED" and s["armed"], "armed GUIDED")
        return self


StartPeer = Callable[..., Awaitable[Peer]]
StartBench = Callable[..., Awaitable[Bench]]


@pytest.fixture
async def peer() -> AsyncIterator[StartPeer]:
    """Start a Peer: ``await peer(sysid, uid=...)``."""
    async with contextlib.AsyncExitStack() as stack:

        async def start(sysid: int = 1, **more: Any) -> Peer:
            one = Peer(sysid, **more)
            await one.open()
            stack.push_async_callback(one.close)
            return one

        yield start


@pytest.fixture
async def bench(net: Net, peer: StartPeer, onboard: StartOnboard) -> StartBench:
    """Put a vehicle on the bench: ``await bench(name=..., sysid=..., uid=..., connect=...)``, its autopilot known."""

    async def start(
        one: Peer | None = None, name: str = "quad1", connect: tuple[str, ...] = (), settings: Any = None, **more: Any
    ) -> Bench:
        session, endpoint = net.router(*connect)
        ground = net.ground(endpoint, name)
        states, events = ground.samples(keys.STATE), ground.samples(keys.EVENT)
        await net.linked(session, keys.EVENT.key("demo", name))
        one = one or await peer(**more)
        vehicle = await onboard(session, one.url, name, **(settings or {}))
        return Bench(one, endpoint, vehicle, ground, states, events)

    return start


@pytest.fixture
async def mission_bench(bench: StartBench) -> AsyncIterator[Any]:
    """A vehicle with a mission store: :func:`tests.services.missions.mission_peer.mission_benches`."""
    from tests.services.missions.mission_peer import mission_benches  # it builds on what is here

    async with mission_benches(bench) as start:
        yield start
