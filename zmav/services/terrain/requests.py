"""The ground for the vehicle's own autopilot: MAVLink's terrain protocol, answered beside it.

ArduPilot asks with TERRAIN_REQUEST, which names nobody, for blocks of 28 by 32 heights; one TERRAIN_DATA answers four
by four of them. Source: https://mavlink.io/en/services/terrain.html; the layout of a block is AP_Terrain's.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import zenoh

from zmav import keys, wire
from zmav.mavlink import Frame, decode
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.reported import fields_of
from zmav.services.orders.orders import Handler, Report
from zmav.services.queries.questions import Reply
from zmav.terrain import Terrain, piece_at
from zmav.waiting import in_thread

METRES_PER_DEGREE = 111319.5
"""of latitude, as ArduPilot's Location has it"""
ACROSS = 8
"""grids from west to east in a block; seven rows of them from south to north"""
EDGE = 4
"""heights along a grid"""
BITS = 56
BLOCKS = 24
"""blocks that wait to be answered: twice as many as ArduPilot keeps in memory"""
SHARE = 0.2
"""of a slow link, for TERRAIN_DATA"""
SIZE = 55
"""bytes of a TERRAIN_DATA, signed"""
PAUSE = 0.01
"""s between two of them on a link of unknown speed"""
MISSING = 64
"""names of pieces that are kept of what was not there"""
NEEDS = {"TERRAIN_REQUEST": 0.5, "TERRAIN_REPORT": 0.2}
"""Hz of what is read here, once there are pieces"""
FRESH = 3.0
"""s: age up to which a position says where the vehicle is"""


class Block(NamedTuple):
    """What TERRAIN_REQUEST names: its south-west corner in 1e-7 degrees, and m between two heights."""

    lat: int
    lon: int
    spacing: int

    def places(self, bit: int) -> Iterator[tuple[float, float]]:
        """Latitude and longitude of the 16 heights of one grid, from south to north, each row from west to east."""
        for i in range(EDGE * EDGE):
            north = (bit // ACROSS * EDGE + i // EDGE) * self.spacing
            east = (bit % ACROSS * EDGE + i % EDGE) * self.spacing
            lat = self.lat / 1e7 + north / METRES_PER_DEGREE
            half = math.radians((self.lat / 1e7 + lat) / 2.0)
            yield lat, self.lon / 1e7 + east / METRES_PER_DEGREE / max(math.cos(half), 0.01)


class TerrainRequests:
    """Answers the autopilot, keeps what ``terrain_put`` brings, and answers ``terrain``. Lives on the event loop.

    What is not known is not answered: the autopilot asks again, and an event names the piece once. ``need`` has
    messages flow from the autopilot (:meth:`zmav.services.rates.rates.Rates.need`).
    """

    def __init__(self, companion: Companion, terrain: Terrain, need: Callable[[str, float], None]) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self._key = keys.TERRAIN.key(companion.port.fleet, companion.port.name)
        companion.questions.declare(self._key, self._answer)
        self._requests = AutopilotMessages(companion, {"TERRAIN_REQUEST": self._on_request})
        self.terrain, self._need = terrain, need
        self.answered = 0
        self._asked: dict[Block, int] = {}
        self._missing: dict[str, None] = {}
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def handlers(self) -> dict[str, Handler]:
        """The verbs of this service."""
        return {"terrain_put": self.put, "terrain_clear": self.clear}

    def start(self) -> None:
        self._requests.start()
        self._task = asyncio.get_running_loop().create_task(self._work())
        self._ask_for()

    def close(self) -> None:
        self._requests.close()
        if self._task is not None:
            self._task.cancel()

    async def put(self, args: wire.TerrainPut, report: Report) -> dict[str, Any]:
        """Keep pieces. Raises :class:`~zmav.errors.BadInput` for the first that is none; those before it are kept."""
        args.check()
        try:
            for name, data in args.pieces.items():
                await in_thread(self.terrain.put, name, data)
                self._missing.pop(name, None)
        finally:
            kept = self._ask_for()
        return {"put": len(args.pieces), "pieces": kept}

    async def clear(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Forget all pieces; the autopilot keeps what it was told."""
        cleared = await in_thread(self.terrain.clear)
        self._ask_for()
        return {"cleared": cleared}

    def _ask_for(self) -> int:
        """An ArduPilot asks no more often than it is asked to, and one without pieces here need not. How many there
        are.
        """
        kept = len(self.terrain.names())
        for name, hz in NEEDS.items():
            self._need(name, hz if kept else 0.0)
        return kept

    def _on_request(self, fields: Mapping[str, Any], frame: Frame) -> None:
        block, mask = Block(fields["lat"], fields["lon"], fields["grid_spacing"]), fields["mask"] % (1 << BITS)
        if not mask or block.spacing < 1 or not (abs(block.lat) < 900_000_000 and abs(block.lon) <= 1_800_000_000):
            return
        self._asked.pop(block, None)  # it is wanted now
        self._asked[block] = mask
        if len(self._asked) > BLOCKS:
            del self._asked[next(iter(self._asked))]
        self._news.set()

    async def _work(self) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._asked:
                block, mask = self._asked.popitem()
                await self._send(block, mask)

    async def _send(self, block: Block, mask: int) -> None:
        capacity = self._port.link.capacity
        pause = PAUSE if capacity is None else max(PAUSE, SIZE / (SHARE * capacity))
        missing: dict[str, None] = {}
        for bit in range(BITS):
            if not mask >> bit & 1:
                continue
            places = list(block.places(bit))
            heights = [self.terrain.height(*place) for place in places]
            if None in heights:
                missing |= {piece_at(*place)[0]: None for place, h in zip(places, heights, strict=True) if h is None}
                continue
            data = [round(h) for h in heights if h is not None]
            named = {"lat": block.lat, "lon": block.lon, "grid_spacing": block.spacing}
            self._port.send("TERRAIN_DATA", **named, gridbit=bit, data=data)
            self.answered += 1
            await asyncio.sleep(pause)
        self._say_missing([name for name in missing if name not in self._missing])

    def _say_missing(self, names: list[str]) -> None:
        if not names:
            return
        for name in names:
            self._missing[name] = None
        while len(self._missing) > MISSING:
            del self._missing[next(iter(self._missing))]
        text = f"the autopilot asks for ground that is not here ({', '.join(names[:4])}): 'zmav terrain load'"
        self._events.emit("terrain", "warning", text, limit="terrain", pieces=names)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        """In the lane of questions."""
        report = wire.TerrainReport(
            pieces=self.terrain.names(),
            missing=list(self._missing.copy()),
            faults=self.terrain.faults.copy(),
            answered=self.answered,
        )
        source = self._identity.source
        position = fields_of(self._port, "GLOBAL_POSITION_INT", source, FRESH)
        if position is not None:
            report.height = self.terrain.height(position["lat"] / 1e7, position["lon"] / 1e7)
            report.above = None if report.height is None else position["alt"] / 1e3 - report.height
        said = self._port.latest("TERRAIN_REPORT", source) if source else None
        if said is not None:
            fields = decode(said.frame, self._port.dialect)
            report.pending, report.loaded, report.age = fields["pending"], fields["loaded"], said.age
        yield Reply(self._key, wire.encode(report))
