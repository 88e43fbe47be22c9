"""From the key space into the table: what is subscribed to, and what is asked for now and then."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence

import msgspec
import zenoh

from ground.feed import patterns
from ground.view.table import Table
from mesh import graph
from zmav import keys
from zmav.client import Client
from zmav.errors import BadKey, ZmavError
from zmav.vision.assembler import Assembler

GRAPH_EVERY = 4.0
PICTURES = (keys.FRAME, keys.DETECTION)
JPEG, MOST_CAMERAS = b"\xff\xd8\xff", 250


class Watch:
    """Fills a table until cancelled. Nothing here waits for a reader of the table.

    ``vehicles`` are names or patterns (``quad*``). Raises :class:`BadConfig` for one that cannot be.
    """

    def __init__(
        self, z: Client, table: Table, vehicles: Sequence[str] = ("*",), cameras: bool = True, signals: bool = True
    ) -> None:
        self._z, self._table = z, table
        self._vehicles = patterns(vehicles)
        self._cameras, self._signals = cameras, signals
        self._pictures: dict[tuple[str, ...], Assembler] = {}
        """by camera: what came of its pictures"""

    async def run(self) -> None:
        """Until cancelled."""
        await asyncio.gather(*(self._follow(channel, key) for channel, key in self._subscribed()), self._graphs())

    def _subscribed(self) -> list[tuple[keys.Channel, str]]:
        fleet = self._z.fleet_name
        found = [(keys.FLEET, keys.FLEET.key(fleet, topic="*"))]
        pictures = PICTURES if self._cameras else ()
        for vehicle in self._vehicles:
            found += [
                (keys.STATE, keys.STATE.key(fleet, vehicle)),
                (keys.EVENT, keys.EVENT.key(fleet, vehicle)),
                (keys.SETPOINT, keys.SETPOINT.key(fleet, vehicle, agent="*")),
                (keys.LINK, keys.LINK.key(fleet, vehicle, link="autopilot")),
                *((picture, picture.key(fleet, vehicle, camera="*")) for picture in pictures),
            ]
            if self._signals:
                found.append((keys.AGENT_OUT, keys.AGENT_OUT.key(fleet, vehicle, agent="*", topic="*")))
        return found

    async def _follow(self, channel: keys.Channel, key: str) -> None:
        async with self._z.subscribe(key, lambda sample: sample) as samples:
            async for sample in samples:
                self._take(channel, sample)

    def _take(self, channel: keys.Channel, sample: zenoh.Sample) -> None:
        try:
            found, parts = keys.match(str(sample.key_expr))
        except BadKey:
            return  # what matches our expression, and is no key of ours
        if found is not channel:
            return
        place = tuple(parts.values())
        gone = sample.kind == zenoh.SampleKind.DELETE
        payload = b"" if gone else sample.payload.to_bytes()
        if channel is keys.EVENT:
            self._table.append(channel.name, place, payload)
        elif channel is keys.FRAME:
            self._take_chunk(place, payload)
        elif not (gone and channel is not keys.FLEET) and parts.get("topic") != keys.ROSTER:
            self._table.put(channel.name, place, payload)

    def _take_chunk(self, place: tuple[str, ...], payload: bytes) -> None:
        """Of a camera's picture; whole JPEGs, as other people's cameras may send them, are taken as they are."""
        if payload.startswith(JPEG):
            self._table.put(keys.FRAME.name, place, payload)
        elif place in self._pictures or len(self._pictures) < MOST_CAMERAS:
            whole = self._pictures.setdefault(place, Assembler()).add(payload, time.monotonic())
            if whole is not None:
                self._table.put(keys.FRAME.name, place, whole.jpeg)

    async def _graphs(self) -> None:
        while True:
            with contextlib.suppress(ZmavError):
                found = await graph.gather(self._z, tries=2)
                self._table.put("graph", (), msgspec.json.encode(found))
            await asyncio.sleep(GRAPH_EVERY)
