"""A torn network in virtual time, and what everybody then does alone: segments, holds, ways home, landings.

As :mod:`tests.agents.planner.execute.virtual`, with vehicles that store the ways home that come with their segments.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from agents.planner.execute.commit import Part
from agents.planner.execute.conductor import Conductor, Send
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.separation import separation
from agents.planner.returning.finder import Returner, Surroundings
from agents.planner.returning.keeper import ReturnKeeper
from agents.planner.returning.ways import Pace
from tests.agents.planner.execute.virtual import LEASE, Craft, History
from zmav import wire
from zmav.config import RETURN_LEAD
from zmav.errors import BadInput
from zmav.services.authority.homeward import StoredReturn, read_way_home

AFTER = 13.0
"""s from a segment's end until a way home may begin: ``land_after`` of 10 s and what the mode may take"""
PACE = Pace(5.0, 3.0, 2.0, 2.5)
LANDING = 0.5
"""m/s of a landing by the autopilot"""
LOOK = 0.2
"""s between two samples of what a vehicle does alone"""
CEILING = 120.0


class HomeCraft(Craft):
    """... by what zmav.services.authority.setpoints decides of a way home."""

    def __init__(self, part: Part, clock: float) -> None:
        super().__init__(part, clock)
        self.home: StoredReturn | None = None
        self.lands = False
        """it cannot fly home after all: it was blown away, or its mode does not come"""

    def take_home(
        self, now: float, seq: int, deadline: float, points: list[wire.SegmentPoint], home: wire.WayHome | None
    ) -> None:
        self.take(now, seq, deadline, points)
        if self.on != seq or self.segment is None:
            return
        self.home = None
        if home is not None:
            mine = now + self.clock
            try:
                self.home = read_way_home(home, self.segment, AFTER, mine, now)
            except BadInput as e:
                raise AssertionError(f"{self.part.id}: {e}") from e

    @property
    def left(self) -> float:
        """From when on (true time) it acts alone: nothing that comes after that is taken."""
        if self.segment is None:
            return math.inf
        return self.segment.end - self.clock + AFTER - RETURN_LEAD

    def take(self, now: float, seq: int, deadline: float, points: list[wire.SegmentPoint]) -> None:
        if now < self.left:
            super().take(now, seq, deadline, points)

    def place(self, now: float) -> tuple[float, float, float]:
        if self.segment is None or now <= self.left:
            return super().place(now)
        if self.home is None or self.lands:
            return down(super().place(now), now - self.left)
        way = self.home.way
        gone = min(max(now - self.home.begins, 0.0), way.end - way.start)
        return down(way.local(way.start + gone)[0], now - self.home.ends)

    def state(self, now: float) -> dict[str, Any]:
        told = super().state(now)
        return told if now <= self.left else told | {"stamp": None, "end": None}

    @property
    def rests(self) -> float:
        """When it is down, if nothing comes any more."""
        if self.segment is None:
            return -math.inf
        begins = self.left if self.home is None or self.lands else self.home.ends
        return begins + 60.0 / LANDING

    def alone(self, now: float) -> Motion:
        """What it does from ``now`` on if nothing comes any more, by true time."""
        times = np.array([now, max(self.rests, now + 1.0)])
        if self.segment is not None:
            end, lands = self.segment.end - self.clock, self.home is None or self.lands
            begins, ends = (self.left, self.left) if lands or self.home is None else (self.home.begins, self.home.ends)
            descent = (end, self.left, ends, ends + super().place(end)[2] / LANDING, ends + 4.0 / LANDING)
            moving = (np.arange(now, end, LOOK), np.arange(begins, ends, LOOK))
            times = np.concatenate((times, *moving, np.array(descent)))
        times = times + self.late
        times = np.unique(np.round(np.append(times[times >= now], now), 6))
        return np.array([(t, *self.truly(t)) for t in times.tolist()])


def down(place: tuple[float, float, float], seconds: float) -> tuple[float, float, float]:
    """After so many seconds of a landing by the autopilot."""
    return (place[0], place[1], max(place[2] - LANDING * max(seconds, 0.0), 0.0))


class Torn(NamedTuple):
    """What a moment came to."""

    least: float
    """m of clearance between the nearest two"""
    pair: tuple[str, str]
    home: int
    """how many flew home"""
    vehicles: int


class HomeHistory(History):
    """Homes are where the vehicles' motions begin, on the ground, unless they are given."""

    def __init__(
        self,
        motions: dict[str, Motion],
        rng: np.random.Generator,
        *,
        homes: Mapping[str, tuple[float, float, float]] | None = None,
        lasts: Mapping[str, float] | None = None,
        **more: object,
    ) -> None:
        super().__init__(motions, rng, **more)  # type: ignore[arg-type]
        self.homes = dict(homes or {part.id: (*part.track.pos[0, :2].tolist(), 0.0) for part in self.parts})
        self.lasts = dict(lasts or {})
        self.missing: dict[str, str] = {}
        self.homers = {part.id: HomeCraft(part, self.crafts[part.id].clock) for part in self.parts}
        self.crafts = dict(self.homers)
        self.keeper = ReturnKeeper(self.downwash, self._returners, self._around, self._tell)
        self.conductor = Conductor(self.parts, self.downwash, self.now, homes=self.keeper)
        self.bytes: list[int] = []

    def _returners(self) -> dict[str, Returner]:
        return {name: Returner(home, PACE, AFTER, self.lasts.get(name, math.inf)) for name, home in self.homes.items()}

    def _around(self, names: object, lowest: float, spacing: float) -> Surroundings:
        return Surroundings(_inside, (), lowest, CEILING, spacing)

    def _tell(self, vehicle: str, why: str) -> None:
        self.missing[vehicle] = why

    def _put(self, send: Send) -> None:
        part, craft = send.part, self.homers[send.part.id]
        self.seqs[part.id] += 1
        seq, deadline = self.seqs[part.id], part.offset.vehicle(send.deadline)
        points = [
            wire.SegmentPoint(t=part.offset.vehicle(row[0]), pos=tuple(row[1:4]), vel=tuple(row[4:7]))
            for row in send.rows.tolist()
        ]
        home = None
        if send.home is not None:
            rows = send.home.rows
            home = wire.WayHome(
                start=part.offset.vehicle(send.home.begins),
                points=[(t - rows[0, 0], (x, y, z), (u, v, w)) for t, x, y, z, u, v, w in rows.tolist()],
            )
            self.bytes.append(len(wire.encode(home)))
        self.conductor.sent(send, (LEASE, seq), deadline, self.now)
        self.sends += 1
        self.network.send(self.now, part.id, lambda at: craft.take_home(at, seq, deadline, points, home))

    def torn(self, rng: np.random.Generator, lands: float = 0.0) -> Torn:
        """Nothing reaches anybody from now on. ``lands``: the share of those who cannot fly home after all."""
        ways = {}
        for craft in self.homers.values():
            craft.lands = bool(rng.random() < lands)
            ways[craft.part.id] = craft.alone(self.now)
            craft.lands = False
        return self.judged(ways)

    def judged(self, ways: Mapping[str, Floats]) -> Torn:
        radius = {part.id: part.radius for part in self.parts}
        nearest = [
            (separation(ways[a], ways[b], self.downwash)[0] - radius[a] - radius[b], (a, b))
            for a, b in itertools.combinations(ways, 2)
        ]
        least, pair = min(nearest)
        home = sum(craft.home is not None for craft in self.homers.values())
        return Torn(least, pair, home, len(ways))


def _inside(p: Floats, q: Floats, radius: float) -> bool:
    return True
