"""What a demo sees from the ground: losses and delays, measured over the key space like anybody would."""

from __future__ import annotations

import asyncio
import contextlib
import statistics
from collections.abc import Callable
from typing import TypeVar

import msgspec
import zenoh

import zmav
from zmav import keys, wire
from zmav.errors import ZmavError

PING = 1.0
"""s between two round trips to a vehicle"""
W = TypeVar("W", bound=msgspec.Struct)


class LinkFigures(msgspec.Struct):
    """One vehicle's link as measured from the ground."""

    rtts: list[float] = []
    """seconds, queries to the vehicle and back"""
    mavlink_lost: int = 0
    mavlink_frames: int = 0


class Watch:
    """Follows some vehicles until cancelled."""

    def __init__(self, z: zmav.Client, names: tuple[str, ...]) -> None:
        self._z = z
        self.tracks = {name: LinkFigures() for name in names}

    async def run(self) -> None:
        await asyncio.gather(self._links(), *(self._ping(name, track) for name, track in self.tracks.items()))

    def _samples(self, key: str, kind: type[W]) -> zmav.Subscription[tuple[str, W]]:
        """The vehicle's name and what was published under ``key``; what is not a ``kind`` is left out."""

        def convert(sample: zenoh.Sample) -> tuple[str, W]:
            key = str(sample.key_expr)
            return key.split("/")[2], wire.decode(sample.payload.to_bytes(), kind, key)

        return self._z.subscribe(key, convert)

    async def _links(self) -> None:
        async with self._samples(
            keys.LINK.key(self._z.fleet_name, "*", link="autopilot"), wire.LinkQuality
        ) as qualities:
            async for name, quality in qualities:
                if track := self.tracks.get(name):
                    track.mavlink_lost, track.mavlink_frames = quality.lost, quality.rx_frames

    async def _ping(self, name: str, track: LinkFigures) -> None:
        while True:
            with contextlib.suppress(ZmavError):  # the summary counts what came
                track.rtts.append(await self._z.vehicle(name).ping())
            await asyncio.sleep(PING)

    def state(self, name: str) -> wire.VehicleState | None:
        """What was last heard of it."""
        return self._z.vehicle(name).last_state

    def delay_per_hop(self, relays: Callable[[str], int]) -> float | None:
        """Seconds one more router costs, one way: half the slope of the median round trips over the relays between."""
        by_relays: dict[int, list[float]] = {}
        for name, track in self.tracks.items():
            if track.rtts:
                by_relays.setdefault(relays(name), []).append(statistics.median(track.rtts))
        if len(by_relays) < 2:
            return None
        far, near = max(by_relays), min(by_relays)
        return (statistics.median(by_relays[far]) - statistics.median(by_relays[near])) / (far - near) / 2
