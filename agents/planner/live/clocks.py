"""How far every vehicle's clock is ahead of ours, learnt all the time: before a goal begins it is known already."""

from __future__ import annotations

import time
from collections.abc import Iterable

import zmav
from agents.planner.execute.offset import Offset
from agents.planner.execute.vehicle_command import SURE, Clock, ask_time, learn_time
from zmav.waiting import together

EVERY = 4.0
"""s between two questions to one vehicle; of a large fleet one vehicle is asked at each look"""
SOON = 2.0
"""s that whoever waits for clocks to be known better waits at most: over bad hops they never are"""


class Clocks:
    """Of all that are heard. Lives on the event loop; :meth:`hear` and :meth:`due` are called a few times a second."""

    def __init__(self, z: zmav.Client) -> None:
        self._z, self.clock = z, Clock()
        self.offsets: dict[str, Offset] = {}
        self._asked: dict[str, float] = {}
        self._learnt: dict[str, float] = {}
        self._seen: dict[str, float] = {}

    def of(self, names: Iterable[str]) -> dict[str, Offset]:
        """Of each, made where there is none. One flight of a vehicle at a time converts by it."""
        return {name: self.offsets.setdefault(name, Offset()) for name in names}

    def hear(self) -> None:
        """Take in what was published: it proves one bound. Who is gone is forgotten."""
        fleet = {vehicle.name: vehicle for vehicle in self._z.fleet()}
        for known in (self.offsets, self._asked, self._learnt, self._seen):
            for name in known.keys() - fleet.keys():
                del known[name]
        for name, vehicle in fleet.items():
            heard = self._z.heard(name, vehicle.fleet)
            if heard is not None and heard.at > self._seen.get(name, -1.0):
                self._seen[name] = heard.at
                self.offsets.setdefault(name, Offset()).heard(heard.state.t, self.clock.of(heard.at))

    def due(self, now: float) -> str:
        """Who is to be asked for its time now; empty: nobody."""
        waits = min(self.offsets, key=lambda name: self._asked.get(name, -EVERY), default="")
        return waits if waits and now - self._asked.get(waits, -EVERY) >= EVERY else ""

    async def ask(self, name: str) -> None:
        """No answer leaves what is known."""
        self._asked[name] = time.monotonic()
        if name in self.offsets:
            await ask_time(self._z, name, self.clock, self.offsets[name])

    async def learn(self, names: Iterable[str]) -> None:
        """Ask those whose clocks are known badly again and again, as a flight does for longer: a plan's margins depend
        on it. Over bad hops they stay so: nobody is asked so twice within :data:`EVERY`.
        """
        now, unsure = time.monotonic(), dict[str, Offset]()
        for name, offset in self.of(names).items():
            if not offset.error(self.clock.now()) < SURE and now - self._learnt.get(name, -EVERY) >= EVERY:
                unsure[name] = offset
        await together(*(learn_time(self._z, name, self.clock, offset, SOON) for name, offset in unsure.items()))
        # Only now: who comes meanwhile is not to go on with clocks that are still being learnt.
        self._learnt.update(dict.fromkeys(unsure, time.monotonic()))
