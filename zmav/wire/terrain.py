"""Heights of the ground as they cross the key space: pieces for a vehicle, and what it has of them."""

from __future__ import annotations

from zmav.errors import BadInput
from zmav.wire.base import Told
from zmav.wire.orders import Order

MOST_PIECES = 128
"""in one order"""
MOST_BYTES = 1 << 19
"""of all pieces in one order"""


class TerrainPut(Order, kw_only=True):
    """``do/terrain_put``: keep pieces of ground (:mod:`zmav.terrain`), packed, by their names (base64 in JSON)."""

    pieces: dict[str, bytes]

    def check(self) -> None:
        """Raise :class:`BadInput` for more than an order can have in it."""
        size = sum(map(len, self.pieces.values()))
        if len(self.pieces) > MOST_PIECES or size > MOST_BYTES:
            text = f"{len(self.pieces)} pieces of {size} bytes are too many for one order"
            most = f"at most {MOST_PIECES} pieces and {MOST_BYTES} bytes"
            raise BadInput(text, field="pieces", value=len(self.pieces), expected=most)


class TerrainReport(Told, kw_only=True):
    """What a vehicle knows of the ground, and what its autopilot says of it."""

    pieces: list[str]
    """what it keeps"""
    missing: list[str]
    """what its autopilot asked for and it does not keep, the last ones"""
    faults: dict[str, str]
    """pieces that cannot be read, and why"""
    answered: int
    """TERRAIN_DATA that were sent"""
    height: float | None = None
    """m above the sea of the ground under the vehicle, by its pieces; None: not known"""
    above: float | None = None
    """m of the vehicle above it"""
    pending: int | None = None
    """grids of four by four heights that the autopilot waits for, by its last TERRAIN_REPORT; None: it sent none"""
    loaded: int | None = None
    """grids that it has"""
    age: float | None = None
    """s since that report"""
