"""An autopilot with parameters, which loses, repeats and clips them as a test wants it."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, NamedTuple

import zenoh

from tests.services.conftest import Bench, Peer, StartBench, Told
from zmav import wire

NO_INDEX = 65535
REAL32, INT8, INT32 = 9, 2, 6
BY_NAME = -1
BURST = 25
"""PARAM_VALUEs at once: the kernel's buffer of a socket holds some hundred datagrams"""


HOME = {"RTL_ALT": (1500.0, INT32), "WPNAV_SPEED": (1000.0, REAL32), "WPNAV_ACCEL": (250.0, REAL32), "FRAME": (1.0, 2)}


def many(count: int) -> dict[str, tuple[float, int]]:
    """That many parameters: value and type by name."""
    return {f"P_{i:04d}": (float(i), REAL32) for i in range(count)}


class ParamPeer(Peer):
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET as ArduPilot does."""

    def __init__(self, sysid: int = 1, **more: Any) -> None:
        super().__init__(sysid, **more)
        self.params: dict[str, tuple[float, int]] = {}
        self.hidden: dict[str, tuple[float, int]] = {}
        """known by name, but in no list"""
        self.bytewise = self.autopilot == 12
        self.lost: set[int] = set()
        """indices that a stream leaves out"""
        self.repeat = 1
        """times each is sent in a stream"""
        self.stop_at: int | None = None
        """a stream ends before this index"""
        self.deaf: set[str] = set()
        """messages it does not hear"""
        self.clip: dict[str, float] = {}
        """the value a parameter has, whatever it is set to"""
        self.link = "{}"
        """the way to it, around its URL"""
        self.on_told = self._told
        self._streams: set[asyncio.Task[None]] = set()

    @property
    def url(self) -> str:
        return self.link.format(super().url)

    async def close(self) -> None:
        for stream in self._streams:
            stream.cancel()
        await super().close()

    def value(self, name: str, index: int = NO_INDEX, *, count: int | None = None, compid: int = 1) -> None:
        """Send a PARAM_VALUE."""
        number, kind = {**self.params, **self.hidden}[name]
        self.packer.compid = compid
        self.send(
            "PARAM_VALUE",
            param_id=name,
            param_value=self._field(number, kind),
            param_type=kind,
            param_index=index,
            param_count=len(self.params) if count is None else count,
        )
        self.packer.compid = 1

    def junk(self, **fields: Any) -> None:
        """Send a PARAM_VALUE as no autopilot does."""
        good = {"param_id": "JUNK", "param_value": 1.0, "param_type": REAL32, "param_index": 0, "param_count": 1}
        self.send("PARAM_VALUE", **{**good, **fields})

    def _field(self, number: float, kind: int) -> float:
        if not self.bytewise or kind == REAL32:
            return number
        layout = {INT8: "<bxxx", INT32: "<i", 5: "<I"}[kind]
        return float(struct.unpack("<f", struct.pack(layout, int(number)))[0])

    def _number(self, field: float, kind: int) -> float:
        if not self.bytewise or kind == REAL32:
            return field
        layout = {INT8: "<bxxx", INT32: "<i"}[kind]
        return int(struct.unpack(layout, struct.pack("<f", field))[0])

    def _told(self, told: Told) -> None:
        if told.name in self.deaf:
            return
        fields, names = told.fields, list(self.params)
        if told.name == "PARAM_REQUEST_LIST":
            stream = asyncio.get_running_loop().create_task(self.stream())
            self._streams.add(stream)
            stream.add_done_callback(self._streams.discard)
        elif told.name == "PARAM_REQUEST_READ" and fields["param_index"] != BY_NAME:
            if fields["param_index"] < len(names):
                self.value(names[fields["param_index"]], fields["param_index"])
        elif told.name == "PARAM_REQUEST_READ" and fields["param_id"] in {**self.params, **self.hidden}:
            self.value(fields["param_id"])
        elif told.name == "PARAM_SET" and fields["param_id"] in {**self.params, **self.hidden}:
            self.set(fields["param_id"], fields["param_value"])

    def set(self, name: str, field: float) -> None:
        where = self.params if name in self.params else self.hidden
        kind = where[name][1]
        where[name] = (self.clip.get(name, self._number(field, kind)), kind)
        self.value(name)

    async def stream(self) -> None:
        for index, name in enumerate(list(self.params)):
            if self.stop_at is not None and index >= self.stop_at:
                return
            if index not in self.lost:
                for _ in range(self.repeat):
                    self.value(name, index)
            if index % BURST == BURST - 1:
                await asyncio.sleep(0.001)

    def lists(self) -> int:
        """How often the list was asked for."""
        return len(self.heard("PARAM_REQUEST_LIST"))

    def asked(self) -> list[int]:
        """The indices that were asked for one by one."""
        return [told.fields["param_index"] for told in self.heard("PARAM_REQUEST_READ")]


class Scene(NamedTuple):
    """A vehicle whose autopilot has parameters."""

    peer: ParamPeer
    b: Bench

    @property
    def known(self) -> Any:
        return self.b.vehicle.params.known

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until it is so; every state published is a moment to look."""
        await self.b.states.until(true, what)

    async def read(self) -> Scene:
        """Wait until the set is complete, for as long as more of it comes: over a bad link that takes 15 to 30 s."""

        def more(left: int) -> bool:
            return bool(self.known.complete or len(self.known.missing) != left)

        while not self.known.complete:
            await self.until(functools.partial(more, len(self.known.missing)), "more of the set")
        return self

    async def table(self, **query: Any) -> wire.ParamTable:
        (reply,) = await self.b.ground.ask("zmav/demo/quad1/param", json.dumps(query).encode() if query else b"")
        return wire.decode(_ok(reply), wire.ParamTable, "param")

    async def get(self, name: str) -> wire.Param:
        (reply,) = await self.b.ground.ask(f"zmav/demo/quad1/param/{name}")
        return wire.decode(_ok(reply), wire.Param, name)

    async def values(self) -> dict[str, Any]:
        return {p.name: p.value for p in (await self.table()).params}


def _ok(reply: zenoh.Reply) -> bytes:
    if reply.ok is None:
        assert reply.err is not None
        raise wire.error_from(reply.err.payload.to_bytes())
    return reply.ok.payload.to_bytes()


StartScene = Callable[..., Awaitable[Scene]]


@contextlib.asynccontextmanager
async def scenes(bench: StartBench) -> AsyncIterator[StartScene]:
    """Start one: ``await scene(params, link="lossy:{}?loss=0.2", autopilot=12, prepare=...)``; ``prepare(peer)``
    before it is heard.
    """
    peers: list[ParamPeer] = []

    async def start(
        params: dict[str, tuple[float, int]] | None = None,
        prepare: Callable[[ParamPeer], None] | None = None,
        link: str = "{}",
        **more: Any,
    ) -> Scene:
        peer = ParamPeer(**more)
        peer.link = link
        peer.params = dict(params or HOME)
        if prepare:
            prepare(peer)
        await peer.open()
        peers.append(peer)
        return Scene(peer, await bench(peer))

    yield start
    for peer in peers:
        await peer.close()
