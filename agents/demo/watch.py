"""What is seen of a demo: by its simulator where everybody truly is, for distances and the picture of the tracks; from
the ground losses and delays, measured over the key space like anybody would.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

import zmav
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.sim import Remote
from zmav.subscription import document

EVERY = 0.2
"""s between two looks"""


class Row(NamedTuple):
    """A moment (s since the beginning) and everybody's place: north, east and up, m in the world."""

    t: float
    places: tuple[tuple[float, float, float], ...]


class Truth:
    """What the simulator says of its vehicles, from ``with truth.watching(control)`` on."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        self.rows: list[Row] = []
        self.begun = time.monotonic()
        self.closest, self.pair, self.closest_at = math.inf, ("", ""), 0.0
        self.whole = False
        """the simulator told of them until we had seen enough"""
        self._paces: list[float] = []
        self._stop = threading.Event()

    @contextlib.contextmanager
    def watching(self, control: Path) -> Iterator[None]:
        thread = threading.Thread(target=self._watch, args=(control,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _watch(self, control: Path) -> None:
        with contextlib.suppress(ZmavError), Remote(control) as sim:  # it may end before us
            while not self._stop.wait(EVERY):
                status = sim.status()
                by_name = {vehicle.name: vehicle.ned_m for vehicle in status.vehicles}
                self.take(tuple((n, e, -d) for n, e, d in (by_name[name] for name in self.names)))
                if status.speed and status.speed_reached:  # not while it is paused, or as fast as it goes
                    self._paces.append(status.speed_reached / status.speed)
            self.whole = True

    def take(self, places: tuple[tuple[float, float, float], ...]) -> None:
        now = time.monotonic() - self.begun
        self.rows.append(Row(now, places))
        for (a, one), (b, other) in itertools.combinations(zip(self.names, places, strict=True), 2):
            if (apart := math.dist(one, other)) < self.closest:
                self.closest, self.pair, self.closest_at = apart, (a, b), now

    @property
    def pace(self) -> float:
        """How fast simulated time passed, as a share of what was asked for; 1: as it should."""
        return statistics.fmean(self._paces) if self._paces else 1.0

    def flown(self, name: str) -> float:
        """m along its track."""
        i = self.names.index(name)
        return sum(math.dist(a.places[i], b.places[i]) for a, b in itertools.pairwise(self.rows))

    def highest(self, name: str) -> float:
        """m above the world's origin."""
        i = self.names.index(name)
        return max((row.places[i][2] for row in self.rows), default=0.0)


PING = 1.0
"""s between two round trips to a vehicle"""


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

    async def _links(self) -> None:
        key = keys.LINK.key(self._z.fleet_name, "*", link="autopilot")
        async with self._z.subscribe(key, document(wire.LinkQuality)) as qualities:
            async for key, quality in qualities:
                if track := self.tracks.get(key.split("/")[2]):
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
