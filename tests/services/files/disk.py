"""A simulated vehicle with files and logs, the Onboard before it, and a ground station's client behind that."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import pytest

import zmav
from zmav.client import Client
from zmav.onboard import Onboard
from zmav.sim import World
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.storage import Storage

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, StartOnboard

T = TypeVar("T")
PATIENCE_S = 30.0


class Disk(NamedTuple):
    world: World
    storage: Storage
    onboard: Onboard
    ground: Ground
    z: Client
    v: zmav.Vehicle

    def call(self, function: Callable[[], T]) -> T:
        """Run it in the simulator's thread."""
        return self.world.call(function)

    def put(self, path: str, data: bytes) -> bytes:
        """A file on the vehicle."""
        files = self.storage.files

        def put() -> None:
            files.create(path)
            files.write(path, 0, data)

        self.call(put)
        return data

    def there(self, path: str) -> bytes:
        """A file of the vehicle."""
        return self.call(lambda: self.storage.files.open(path, 239)[:])

    def log(self, data: bytes) -> bytes:
        """A log on the vehicle."""
        self.call(lambda: self.storage.logs.begin(bytearray(data), time.time()))
        return data

    @property
    def idle(self) -> bool:
        """No file is open on the vehicle."""
        return self.call(lambda: self.storage.ftp.open_path) is None


@contextlib.asynccontextmanager
async def disk(
    net: Net, onboard: StartOnboard, cache: Path, link: str = "{}", speed: float = 1.0
) -> AsyncIterator[Disk]:
    """``link``: what to make of the simulator's own URL."""
    with World(copters=1, endpoint="tcp:0", ready_s=0.5, speed=speed) as world:
        session, endpoint = net.router()
        vehicle = await onboard(session, link.format(world.urls[0]), cache=str(cache))
        async with zmav.open(connect=[endpoint]) as z:
            v = z.vehicle("quad1")
            await v.wait_until(lambda s: s.connected, PATIENCE_S)
            node = world.vehicles[0].node
            assert isinstance(node, MavNode)
            yield Disk(world, node.storage, vehicle, net.ground(endpoint), z, v)
            await onboard.close(vehicle)


def noise(size: int, seed: int = 1) -> bytes:
    """Bytes of which no two stretches are alike."""
    out = bytearray()
    value = seed
    while len(out) < size:
        value = (value * 6364136223846793005 + 1442695040888963407) % (1 << 64)
        out += value.to_bytes(8, "little")
    return bytes(out[:size])


def same(found: bytes, wanted: bytes) -> None:
    """Compare long ones: pytest itself shows the beginning of both, or all, and neither says where to look."""
    if found != wanted:
        least = min(len(found), len(wanted))
        at = next((n for n in range(least) if found[n] != wanted[n]), least)
        there = f"{found[at : at + 20]!r}, not {wanted[at : at + 20]!r}"
        pytest.fail(f"{len(found)} bytes, not {len(wanted)}; from {at} on {there}")
