"""Where hosts are, and what that does to the radios: positions become loss and outages a few times a second.

Up to ``free`` m a range takes nothing away; from there loss grows with the square of the way to ``cut`` m, where
nothing is heard any more. Radios have no single law (walls, antennas, multipath); this one has the three parts that
matter to a network: good, failing, gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
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


class Mobility:
    """Where the hosts are, while it is open (``async with``): as the file says, or where their vehicles are."""

    def __init__(self, network: Network) -> None:
        self._network = network
        hosts = network.scenario.hosts
        self._follows = {name for name, host in hosts.items() if host.follow}
        self._task: asyncio.Task[None] | None = None
        self.simulator: Path | None = None
        """the control socket of the simulator whose vehicles are followed"""
        self.positions = {name: host.position for name, host in hosts.items() if host.position}
        """m north and east; hosts without a place are near to all"""

    async def __aenter__(self) -> Mobility:
        self.update()
        if self._follows:
            self._task = asyncio.ensure_future(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(EVERY_S)
            if self.simulator is None:
                continue
            with contextlib.suppress(ZmavError):  # it is not up, or the relay has died: the lab says so
                found = await asyncio.to_thread(_positions, self.simulator)
                self.positions.update({name: found[name] for name in self._follows & set(found)})
                self.update()

    def move(self, host: str, north: float, east: float) -> None:
        """Put a host there, to stay. Raises :class:`BadConfig` for a host there is not."""
        self._network.namespace(host)
        if not (math.isfinite(north) and math.isfinite(east)):
            text = f"no host can stand at {north}, {east}; expected metres north and east"
            raise BadConfig(text, field="position", value=[north, east], expected="metres north and east")
        self._follows.discard(host)
        self.positions[host] = (north, east)
        self.update()

    def update(self) -> None:
        """Set what the distances of this moment do to the links."""
        wiring, found = self._network.wiring, dict[str, Reach]()
        for edge in wiring.edges:
            a, b = self.positions.get(edge.a), self.positions.get(edge.b)
            if edge.medium in wiring.ranges and a is not None and b is not None:
                found[edge.name] = reach(wiring.ranges[edge.medium], math.dist(a, b))
        self._network.set_reach(found)


def _positions(simulator: Path) -> dict[str, Place]:
    with Remote(simulator, timeout=1.0) as remote:
        return {vehicle.name: vehicle.ned_m[:2] for vehicle in remote.status().vehicles}
