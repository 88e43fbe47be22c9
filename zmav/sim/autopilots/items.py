"""Mission items as MAVLink carries them, and what an autopilot's list of them must be able to do.

Missions, fences and rally points are such lists. Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from typing import ClassVar

import msgspec

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE

# MAV_CMD whose items name a place: x and y are latitude and longitude, z an altitude.
_MISSION_PLACES = (16, 17, 19, 21, 22, 31, 179, 189, 195, 201)
LOCATED = frozenset((*_MISSION_PLACES, 5000, 5001, 5002, 5003, 5004, 5100))


class Result(enum.IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


class Item(msgspec.Struct, frozen=True, kw_only=True):
    """One item, with the fields of MISSION_ITEM_INT: ``x`` and ``y`` in degrees times 1e7 where they are a place,
    ``z`` in metres of ``frame`` (MAV_FRAME).
    """

    command: int
    frame: int = 3
    p1: float = 0.0
    p2: float = 0.0
    p3: float = 0.0
    p4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0
    seq: int = 0
    current: int = 0
    autocontinue: int = 1

    @property
    def params(self) -> tuple[float, float, float, float]:
        return self.p1, self.p2, self.p3, self.p4

    @property
    def here(self) -> bool:
        """It names no place: latitude and longitude are zero."""
        return self.x == 0 and self.y == 0


class ItemStore(ABC):
    """One list of items on an autopilot: how it takes a new one, piece by piece, and gives it back.

    ``kind`` is its MAV_MISSION_TYPE, ``title`` what people call it, ``most`` how many items it holds.
    """

    kind: ClassVar[int]
    title: ClassVar[str]
    most: ClassVar[int]

    @abstractmethod
    def __len__(self) -> int:
        """How many items a download gives."""

    @abstractmethod
    def read(self, seq: int) -> Item | Result:
        """One item, or why there is none."""

    @abstractmethod
    def open(self, count: int) -> Result:
        """A new list of ``count`` items is about to come, one :meth:`put` each."""

    @abstractmethod
    def put(self, item: Item, last: int) -> Result:
        """Take one item of an upload that ends with number ``last``."""

    def close(self) -> Result:
        """All have come: the verdict on the whole."""
        return Result.ACCEPTED

    def abandon(self) -> None:  # noqa: B027 - what has come stays
        """The upload ends without its rest."""

    @abstractmethod
    def clear(self) -> bool:
        """Forget all items; False where that is not allowed now."""


class WholeList(ItemStore):
    """A list that takes effect as a whole, when its last item has come, and not before."""

    def __init__(self) -> None:
        self.items: tuple[Item, ...] = ()
        self._coming: dict[int, Item] = {}

    def __len__(self) -> int:
        return len(self.items)

    def read(self, seq: int) -> Item | Result:
        return self.items[seq] if 0 <= seq < len(self.items) else Result.INVALID_SEQUENCE

    def open(self, count: int) -> Result:
        self._coming = {}
        return Result.ACCEPTED if count <= self.most else Result.NO_SPACE

    def put(self, item: Item, last: int) -> Result:
        kept = self.kept(item)
        if isinstance(kept, Result):
            return kept
        self._coming[item.seq] = kept
        return Result.ACCEPTED

    def close(self) -> Result:
        new = tuple(self._coming[seq] for seq in sorted(self._coming))
        self._coming = {}
        verdict = self.judge(new)
        if verdict is Result.ACCEPTED:
            self.items = new
            self.changed()
        return verdict

    def abandon(self) -> None:
        self._coming = {}

    def clear(self) -> bool:
        self.items, self._coming = (), {}
        self.changed()
        return True

    @abstractmethod
    def kept(self, item: Item) -> Item | Result:
        """The item as it is kept, or why it is not taken."""

    def judge(self, new: tuple[Item, ...]) -> Result:
        """Whether the whole makes sense."""
        return Result.ACCEPTED

    def changed(self) -> None:
        """There is another list."""


def check_place(item: Item) -> Result:
    """Whether ``x`` and ``y`` can be a latitude and a longitude."""
    if abs(item.x) > 900_000_000:
        return Result.INVALID_PARAM5_X
    return Result.INVALID_PARAM6_Y if abs(item.y) > 1_800_000_000 else Result.ACCEPTED
