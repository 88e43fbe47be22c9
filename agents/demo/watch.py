"""What a demo sees from the ground: distances, losses and delays, measured over the key space like anybody would."""

from __future__ import annotations

import asyncio
import itertools
import math
import statistics
from typing import TypeVar

import msgspec
import zenoh

import zmav
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.wire import Vector

W = TypeVar("W", bound=msgspec.Struct)


class Track(msgspec.Struct):
    """One vehicle's flight as heard on the ground."""

    start: Vector | None = None
    last: Vector | None = None
    distance: float = 0.0
    """m flown, from state to state"""
    rtts: list[float] = []
    """seconds, queries to the vehicle and back"""
    mavlink_lost: int = 0
    mavlink_frames: int = 0
    states: int = 0


class Watch:
    """Follows some vehicles until cancelled."""

    def __init__(self, z: zmav.Client, names: tuple[str, ...]) -> None:
        self._z = z
        self.tracks = {name: Track() for name in names}
        self.closest = math.inf
        self.closest_pair = ("", "")
        self.planner: wire.AgentStatus | None = None

    async def run(self) -> None:
        await asyncio.gather(self._positions(), self._links(), self._pings(), self._planner())

    def _samples(self, key: str, kind: type[W]) -> zmav.Subscription[tuple[str, W]]:
        """The vehicle's name and what was published under ``key``; what is not a ``kind`` is left out."""

        def convert(sample: zenoh.Sample) -> tuple[str, W]:
            key = str(sample.key_expr)
            return key.split("/")[2], wire.decode(sample.payload.to_bytes(), kind, key)

        return self._z.subscribe(key, convert)

    async def _positions(self) -> None:
        async with self._samples(keys.STATE.key(self._z.fleet_name, "*"), wire.VehicleState) as states:
            async for name, state in states:
                track = self.tracks.get(name)
                if track is None or state.local is None:
                    continue
                track.states += 1
                if track.last is None:
                    track.start = state.local
                elif state.armed:
                    track.distance += math.dist(track.last, state.local)
                track.last = state.local
                self._judge_distances()

    def _judge_distances(self) -> None:
        for (a, one), (b, other) in itertools.combinations(self.tracks.items(), 2):
            if one.last is not None and other.last is not None:
                apart = math.dist(one.last, other.last)
                if apart < self.closest:
                    self.closest, self.closest_pair = apart, (a, b)

    async def _links(self) -> None:
        async with self._samples(
            keys.LINK.key(self._z.fleet_name, "*", link="autopilot"), wire.LinkQuality
        ) as qualities:
            async for name, quality in qualities:
                if track := self.tracks.get(name):
                    track.mavlink_lost, track.mavlink_frames = quality.lost, quality.rx_frames

    async def _pings(self) -> None:
        while True:
            for name, track in self.tracks.items():
                try:
                    track.rtts.append(await self._z.vehicle(name).ping())
                except ZmavError:
                    continue  # the table shows the vehicle as stale; the summary counts what came
            await asyncio.sleep(0.5)

    async def _planner(self) -> None:
        key = keys.AGENT_STATUS.key(self._z.fleet_name, "*", agent="planner")
        async with self._samples(key, wire.AgentStatus) as statuses:
            async for _, status in statuses:
                self.planner = status

    def received(self, name: str) -> int:
        """Setpoints that reached the vehicle, flown or dropped there for a reason."""
        state = self._z.vehicle(name).last_state
        return sum(n for kind, n in state.setpoints.items() if kind != "held") if state else 0

    def delay_per_hop(self) -> float | None:
        """Seconds one more router costs, one way: half the slope of the median round trip over the vehicles in line."""
        medians = [statistics.median(track.rtts) for track in self.tracks.values() if track.rtts]
        if len(medians) < 2:
            return None
        return (medians[-1] - medians[0]) / (len(medians) - 1) / 2
