"""From the key space into the table: what is subscribed to, and what is asked for now and then."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence

import msgspec
import zenoh

from ground.view.table import Table
from mesh import graph
from zmav import keys
from zmav.client import Answer, Client
from zmav.errors import BadKey, ZmavError
from zmav.session import reason
from zmav.vision.assembler import Assembler

GRAPH_EVERY = 4.0
PLANS_EVERY = 60.0
"""s after which a vehicle's plans are asked for again even where no event says that they changed"""
PICTURES = (keys.FRAME, keys.DETECTION)
JPEG, MOST_CAMERAS = b"\xff\xd8\xff", 250


class Watch:
    """Fills a table until cancelled. Nothing here waits for a reader of the table.

    ``vehicles`` are names or patterns (``quad*``). Raises :class:`BadKey` for one that cannot be.
    """

    def __init__(
        self, z: Client, table: Table, vehicles: Sequence[str] = ("*",), cameras: bool = True, signals: bool = True
    ) -> None:
        self._z, self._table = z, table
        self._vehicles = {vehicle: zenoh.KeyExpr(_pattern(vehicle)) for vehicle in vehicles}
        self._cameras, self._signals = cameras, signals
        self._stale: dict[tuple[str, str], float] = {}
        """when each vehicle's plans are to be asked for, by the loop's clock"""
        self._changed = asyncio.Event()
        self._pictures: dict[tuple[str, ...], Assembler] = {}
        """by camera: what came of its pictures"""

    async def run(self) -> None:
        """Until cancelled."""
        await asyncio.gather(
            *(self._follow(channel, key) for channel, key in self._subscribed()), self._graphs(), self._plans()
        )

    def _subscribed(self) -> list[tuple[keys.Channel, str]]:
        fleet = self._z.fleet_name
        found = [
            (keys.FLEET, keys.FLEET.key(fleet, topic="*")),
            (keys.AGENT_STATUS, keys.AGENT_STATUS.key(fleet, "*", agent="*")),
        ]
        pictures = PICTURES if self._cameras else ()
        for vehicle in map(str, self._vehicles.values()):
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
            if b'"mission"' in payload:
                self._ask_again(place[0], place[1], 0.5)
        elif channel is keys.FRAME:
            self._take_chunk(place, payload)
        elif not (gone and channel is not keys.FLEET) and parts.get("topic") != keys.ROSTER:
            self._table.put(channel.name, place, payload)
        if channel is keys.STATE and place not in self._stale:
            self._ask_again(place[0], place[1], 0.0)

    def _take_chunk(self, place: tuple[str, ...], payload: bytes) -> None:
        """Of a camera's picture; whole JPEGs, as other people's cameras may send them, are taken as they are."""
        if payload.startswith(JPEG):
            self._table.put(keys.FRAME.name, place, payload)
        elif place in self._pictures or len(self._pictures) < MOST_CAMERAS:
            whole = self._pictures.setdefault(place, Assembler()).add(payload, time.monotonic())
            if whole is not None:
                self._table.put(keys.FRAME.name, place, whole.jpeg)

    def _ask_again(self, fleet: str, vehicle: str, wait: float) -> None:
        if len(self._stale) < 1000 or (fleet, vehicle) in self._stale:
            self._stale[fleet, vehicle] = asyncio.get_running_loop().time() + wait
            self._changed.set()

    # What is asked for.

    async def _graphs(self) -> None:
        while True:
            with contextlib.suppress(ZmavError):
                found = await graph.gather(self._z, tries=2)
                self._table.put("graph", (), msgspec.json.encode(found))
            await asyncio.sleep(GRAPH_EVERY)

    async def _plans(self) -> None:
        """One vehicle after the other, so that a fleet that has just appeared is not asked all at once."""
        loop = asyncio.get_running_loop()
        while True:
            due = sorted((at, place) for place, at in self._stale.items())
            if not due or due[0][0] > loop.time():
                self._changed.clear()
                with contextlib.suppress(asyncio.TimeoutError):
                    wait = 1.0 if not due else min(1.0, max(0.01, due[0][0] - loop.time()))
                    await asyncio.wait_for(self._changed.wait(), wait)
                continue
            fleet, vehicle = due[0][1]
            self._stale[fleet, vehicle] = loop.time() + PLANS_EVERY
            with contextlib.suppress(ZmavError):
                await self._ask_plans(fleet, vehicle)

    async def _ask_plans(self, fleet: str, vehicle: str) -> None:
        kinds, home = ("mission", "fence", "rally"), keys.MSG.key(fleet, vehicle, msg="HOME_POSITION")
        asked = [self._z.ask(keys.MISSION.key(fleet, vehicle, kind=kind), channel=keys.MISSION) for kind in kinds]
        answers = await asyncio.gather(*asked, self._z.ask(home, channel=keys.MSG))
        for name, replies in zip((*kinds, "home"), answers, strict=True):
            for reply in replies:
                if not isinstance(reply, Answer):
                    if "reading" in reply.detail:
                        self._ask_again(fleet, vehicle, 2.0)
                elif name == "home":
                    self._table.put("home", (fleet, vehicle), reply.payload)
                else:
                    self._table.put("mission", (fleet, vehicle, name), reply.payload)


def _pattern(vehicle: str) -> str:
    """A vehicle's chunk of a key expression."""
    try:
        return keys.expression(f"{vehicle}/state", "x").split("/")[2]
    except (BadKey, zenoh.ZError, IndexError) as e:
        why = reason(e) if isinstance(e, zenoh.ZError) else str(e)
        raise BadKey(f"no vehicle can be called {vehicle!r}: {why}", field="vehicles", value=vehicle) from e
