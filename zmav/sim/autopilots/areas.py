"""The polygons and circles of an uploaded fence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import msgspec

from zmav.sim.autopilots.items import Item
from zmav.sim.geo import Position, to_ned

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
            count = int(item.p1)
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
