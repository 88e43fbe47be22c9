"""What a demo sees from the ground: distances, losses and delays, measured over the key space like anybody would."""

from __future__ import annotations

import asyncio
import itertools
import math
import statistics

import msgspec

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, ZmavError
from zmav.wire import Vector


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

    async def _positions(self) -> None:
        async with self._z.subscribe(keys.STATE.key(self._z.fleet_name, "*")) as samples:
            async for sample in samples:
                state = wire.decode(sample.payload.to_bytes(), wire.VehicleState, "state")
                track = self.tracks.get(state.name)
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
        async with self._z.subscribe(keys.LINK.key(self._z.fleet_name, "*", link="autopilot")) as samples:
            async for sample in samples:
                quality = wire.decode(sample.payload.to_bytes(), wire.LinkQuality, "link")
                track = self.tracks.get(str(sample.key_expr).split("/")[2])
                if track is not None:
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
        async with self._z.subscribe(key) as samples:
            async for sample in samples:
                try:
                    self.planner = wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "planner status")
                except BadInput:
                    continue

    def flown(self, name: str) -> int:
        """Setpoints that the vehicle says it passed to its autopilot."""
        state = self._z.vehicle(name).last_state
        return state.setpoints.get("flown", 0) if state else 0

    def delay_per_hop(self) -> float | None:
        """Seconds one more router costs, one way: half the slope of the median round trip over the vehicles in line."""
        medians = [statistics.median(track.rtts) for track in self.tracks.values() if track.rtts]
        if len(medians) < 2:
            return None
        return (medians[-1] - medians[0]) / (len(medians) - 1) / 2
