"""Mission items as MAVLink carries them, and what an autopilot's list of them must be able to do; the areas of a
fence.

Missions, fences and rally points are such lists. Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar

import msgspec

from zmav.mavlink.results import MissionResult
from zmav.sim.geo import Position, to_ned

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE

# MAV_CMD whose items name a place: x and y are latitude and longitude, z an altitude.
_MISSION_PLACES = (16, 17, 19, 21, 22, 31, 179, 189, 195, 201)
LOCATED = frozenset((*_MISSION_PLACES, 5000, 5001, 5002, 5003, 5004, 5100))


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
    def read(self, seq: int) -> Item | MissionResult:
        """One item, or why there is none."""

    @abstractmethod
    def open(self, count: int) -> MissionResult:
        """A new list of ``count`` items is about to come, one :meth:`put` each."""

    @abstractmethod
    def put(self, item: Item, last: int) -> MissionResult:
        """Take one item of an upload that ends with number ``last``."""

    def close(self) -> MissionResult:
        """All have come: the verdict on the whole."""
        return MissionResult.ACCEPTED

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

    def read(self, seq: int) -> Item | MissionResult:
        return self.items[seq] if 0 <= seq < len(self.items) else MissionResult.INVALID_SEQUENCE

    def open(self, count: int) -> MissionResult:
        self._coming = {}
        return MissionResult.ACCEPTED if count <= self.most else MissionResult.NO_SPACE

    def put(self, item: Item, last: int) -> MissionResult:
        kept = self.kept(item)
        if isinstance(kept, MissionResult):
            return kept
        self._coming[item.seq] = kept
        return MissionResult.ACCEPTED

    def close(self) -> MissionResult:
        new = tuple(self._coming[seq] for seq in sorted(self._coming))
        self._coming = {}
        verdict = self.judge(new)
        if verdict is MissionResult.ACCEPTED:
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
    def kept(self, item: Item) -> Item | MissionResult:
        """The item as it is kept, or why it is not taken."""

    def judge(self, new: tuple[Item, ...]) -> MissionResult:
        """Whether the whole makes sense."""
        return MissionResult.ACCEPTED

    def changed(self) -> None:
        """There is another list."""


def check_place(item: Item) -> MissionResult:
    """Whether ``x`` and ``y`` can be a latitude and a longitude."""
    if abs(item.x) > 900_000_000:
        return MissionResult.INVALID_PARAM5_X
    return MissionResult.INVALID_PARAM6_Y if abs(item.y) > 1_800_000_000 else MissionResult.ACCEPTED


# ---- the polygons and circles of a fence

POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE_...
Corner = tuple[float, float]


class Area(msgspec.Struct, frozen=True):
    """A polygon (``radius`` None) or a circle (one corner) of the world's NED, to stay in or out of."""

    corners: tuple[Corner, ...]
    radius: float | None
    inside: bool

    def outside_by(self, north: float, east: float) -> float:
        """Metres on the wrong side; negative on the right one."""
        if self.radius is not None:
            beyond = math.hypot(north - self.corners[0][0], east - self.corners[0][1]) - self.radius
            return beyond if self.inside else -beyond
        sides = list(zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True))
        edge = min(_to_side((north, east), a, b) for a, b in sides)
        # Within, a ray to the east crosses an odd number of sides (W. R. Franklin's even-odd rule).
        crossed = sum(
            (n1 > north) != (n2 > north) and east < e1 + (north - n1) / (n2 - n1) * (e2 - e1)
            for (n1, e1), (n2, e2) in sides
        )
        return -edge if bool(crossed % 2) == self.inside else edge


def areas_of(items: Sequence[Item], world: Position) -> Iterator[Area]:
    """The items of a fence as areas; those that make none are passed over."""
    at = 0
    while at < len(items):
        item, count = items[at], 1
        if item.command in (CIRCLE_IN, CIRCLE_OUT) and item.p1 > 0.0:
            yield Area((corner(item, world),), item.p1, item.command == CIRCLE_IN)
        elif item.command in (POLYGON_IN, POLYGON_OUT) and item.p1 >= 1:
            count = int(min(item.p1, len(items)))  # it may say anything, infinity too
            corners = tuple(corner(each, world) for each in items[at : at + count])
            if len(corners) >= 3:
                yield Area(corners, None, item.command == POLYGON_IN)
        at += count


def corner(item: Item, world: Position) -> Corner:
    north, east, _ = to_ned(Position(item.x * 1e-7, item.y * 1e-7, 0.0), world)
    return north, east


def _to_side(p: Corner, a: Corner, b: Corner) -> float:
    """From ``p`` to the line from ``a`` to ``b``, metres."""
    along = (b[0] - a[0], b[1] - a[1])
    length = along[0] * along[0] + along[1] * along[1]
    share = ((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / length if length > 0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.hypot(p[0] - a[0] - share * along[0], p[1] - a[1] - share * along[1])
