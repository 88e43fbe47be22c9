"""What a vehicle knows of the ground, as a script sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from zmav import keys, wire
from zmav.terrain import Piece, pack
from zmav.wire.terrain import MOST_BYTES, MOST_PIECES

if TYPE_CHECKING:
    from zmav.vehicle.vehicle import Vehicle

Progress = Callable[[dict[str, Any]], None]


class GroundPieces:
    """``vehicle.terrain``. Raises what orders raise."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    async def put(self, pieces: Mapping[str, Piece], progress: Progress | None = None) -> int:
        """Have the vehicle keep pieces; returns how many bytes were sent. A few orders, each repeated by itself."""
        sent = done = 0
        for batch in _batches({name: pack(piece) for name, piece in pieces.items()}):
            await self._vehicle.order("terrain_put", wire.TerrainPut(pieces=batch))
            sent, done = sent + sum(map(len, batch.values())), done + len(batch)
            if progress is not None:
                progress({"done": done, "of": len(pieces)})
        return sent

    async def clear(self) -> int:
        """Have it forget all pieces; how many there were."""
        return int((await self._vehicle.order("terrain_clear", wire.Order()))["cleared"])

    async def report(self) -> wire.TerrainReport:
        """What it keeps, and what its autopilot says."""
        key = keys.TERRAIN.key(self._vehicle.fleet, self._vehicle.name)
        return wire.decode(await self._vehicle._ask(key), wire.TerrainReport, "reply to terrain")


def _batches(packed: Mapping[str, bytes]) -> Iterator[dict[str, bytes]]:
    """What one order can have in it, one after the other."""
    batch: dict[str, bytes] = {}
    for name, data in packed.items():
        if batch and (len(batch) == MOST_PIECES or sum(map(len, batch.values())) + len(data) > MOST_BYTES):
            yield batch
            batch = {}
        batch[name] = data
    if batch:
        yield batch
