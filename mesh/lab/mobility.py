"""Where hosts are, and what that does to the radios: positions become loss and outages a few times a second.

Up to ``free`` m a range takes nothing away; from there loss grows with the square of the way to ``cut`` m, where
nothing is heard any more. Radios have no single law (walls, antennas, multipath); this one has the three parts that
matter to a network: good, failing, gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mesh.lab.network import Network, Reach
from mesh.lab.scenario import Place, Range
from zmav.errors import BadConfig, ZmavError
from zmav.sim.remote import Remote

EVERY_S = 0.2
_STEPS = 50
"""loss is set in this many steps: a change too small to matter is not sent to the relay"""


def reach(range_: Range, distance: float) -> Reach:
    """What so many metres do."""
    if not distance < range_.cut:  # not a number is nowhere
        return Reach(heard=False)
    if distance <= range_.free:
        return Reach()
    share = (distance - range_.free) / (range_.cut - range_.free)
    return Reach(loss=round(share**2 * _STEPS) / _STEPS)


class Track:
    """Along waypoints at a constant speed, and back to the first after the last one."""

    def __init__(self, start: Place | None, waypoints: Sequence[Place], speed: float) -> None:
        self._points = [*([start] if start is not None else []), *waypoints]
        self._lengths = [math.dist(a, b) for a, b in zip(self._points, self._round()[1:], strict=True)]
        self._speed = speed

    def _round(self) -> list[Place]:
        return [*self._points, *self._points[:1]]

    def at(self, t: float) -> Place | None:
        """After ``t`` s."""
        if len(self._points) < 2 or not sum(self._lengths):
            return self._points[0] if self._points else None
        left = (t * self._speed) % sum(self._lengths)
        for a, b, length in zip(self._points, self._round()[1:], self._lengths, strict=True):
            if left <= length and length > 0:
                share = left / length
                return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            left -= length
        return self._points[0]


class Mobility:
    """Moves the hosts while it is open (``async with``), where any of them moves or has a place at all."""

    def __init__(self, network: Network, clock: Callable[[], float] = time.monotonic) -> None:
        self._network, self._clock = network, clock
        hosts = network.scenario.hosts
        self._tracks = {name: Track(h.position, h.waypoints, h.speed) for name, h in hosts.items()}
        self._follows = {name for name, host in hosts.items() if host.follow}
        self._moving = bool(self._follows) or any(host.waypoints for host in hosts.values())
        self._begun = clock()
        self._task: asyncio.Task[None] | None = None
        self.simulator: Path | None = None
        """the control socket of the simulator whose vehicles are followed"""
        self.positions: dict[str, Place] = {}
        """m north and east; hosts without a place are near to all"""

    async def __aenter__(self) -> Mobility:
        self._begun = self._clock()
        self.update()
        if self._moving:
            self._task = asyncio.ensure_future(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(EVERY_S)
            if self._follows and self.simulator is not None:
                with contextlib.suppress(ZmavError):  # it is not up yet, or has been stopped
                    self._follow(await asyncio.to_thread(_positions, self.simulator))
            with contextlib.suppress(ZmavError):  # the relay has died: the lab says so
                self.update()

    def _follow(self, found: Mapping[str, Place]) -> None:
        for name in self._follows & set(found):
            self._tracks[name] = Track(found[name], (), 1.0)

    def move(self, host: str, north: float, east: float) -> None:
        """Put a host there, to stay. Raises :class:`BadConfig` for a host there is not."""
        self._network.namespace(host)
        if not (math.isfinite(north) and math.isfinite(east)):
            text = f"no host can stand at {north}, {east}; expected metres north and east"
            raise BadConfig(text, field="position", value=[north, east], expected="metres north and east")
        self._follows.discard(host)
        self._tracks[host] = Track((north, east), (), 1.0)
        self.update()

    def update(self) -> None:
        """Set what the distances of this moment do to the links."""
        t = self._clock() - self._begun
        places = {name: track.at(t) for name, track in self._tracks.items()}
        self.positions = {name: place for name, place in places.items() if place is not None}
        found: dict[str, Reach] = {}
        for edge in self._network.links():
            a, b = self.positions.get(edge.a), self.positions.get(edge.b)
            if edge.range is not None and a is not None and b is not None:
                found[edge.name] = reach(edge.range, math.dist(a, b))
        self._network.set_reach(found)


def _positions(simulator: Path) -> dict[str, Place]:
    with Remote(simulator, timeout=1.0) as remote:
        return {vehicle.name: vehicle.ned_m[:2] for vehicle in remote.status().vehicles}
