"""The geofence: a cylinder about home (GF_MAX_HOR_DIST, GF_MAX_VER_DIST), and the polygons and circles of the plan.

https://docs.px4.io/v1.16/en/flying/geofence.html. An area that home, or a flying vehicle, is on the wrong side of is
not taken. What happens at a breach is GF_ACTION; it is looked for five times a second, at where the vehicle is
(GF_PREDICT 0).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from zmav.sim.autopilots.items import Item
from zmav.sim.autopilots.px4 import events
from zmav.sim.control.setpoints import Vector
from zmav.sim.geo import Position, to_ned

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

_POLYGON_IN, _POLYGON_OUT, _CIRCLE_IN, _CIRCLE_OUT = 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE_...
_CRITICAL = 2
Corner = tuple[float, float]


class Area(NamedTuple):
    """A polygon, or (with a radius) a circle about its only corner; metres NED of the world."""

    corners: tuple[Corner, ...]
    radius: float
    inclusion: bool

    def allows(self, north: float, east: float) -> bool:
        inside = _in_polygon(self.corners, north, east) if self.radius == 0.0 else self._in_circle(north, east)
        return inside is self.inclusion

    def _in_circle(self, north: float, east: float) -> bool:
        about = self.corners[0]
        return math.hypot(north - about[0], east - about[1]) < self.radius


class Breach(NamedTuple):
    """Which of its parts are breached."""

    distance: bool = False
    height: bool = False
    area: bool = False

    def __bool__(self) -> bool:
        return self.distance or self.height or self.area


class Fence:
    """One vehicle's geofence; ``breach`` is what was found lately."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self._areas: tuple[Area, ...] = ()
        self._known = 0
        self.breach = Breach()

    def renew(self) -> None:
        """Take the areas of the plan, where it has changed."""
        items = self._copter.fence
        if self._known != items.opaque_id:
            self._known = items.opaque_id
            self._areas = tuple(area for area in _areas(items.items, self._copter.world) if self._fits(area))

    def _fits(self, area: Area) -> bool:
        copter = self._copter
        if copter.has_home and not area.allows(*copter.home_world[:2]):
            copter.tell(events.FENCE_WITHOUT_HOME)
            return False
        sense = copter.sense
        if copter.params["GF_ACTION"] and not copter.landed and not area.allows(sense.north, sense.east):
            copter.tell(events.FENCE_WITHOUT_VEHICLE)
            return False
        return True

    def at(self, place: Vector) -> Breach:
        """What a vehicle there, in the world's NED, would breach."""
        copter, p = self._copter, self._copter.params
        north, east, down = copter.home_world
        farthest, highest = p["GF_MAX_HOR_DIST"], p["GF_MAX_VER_DIST"]
        return Breach(
            copter.has_home and farthest > 0.0 and math.hypot(place[0] - north, place[1] - east) >= farthest,
            copter.has_home and highest > 0.0 and down - place[2] >= highest,
            not all(area.allows(place[0], place[1]) for area in self._areas),
        )

    @property
    def acts(self) -> bool:
        """It is breached, and that is no matter of indifference."""
        return bool(self.breach) and int(self._copter.params["GF_ACTION"]) != 0

    def update(self) -> None:
        """Look where the vehicle is."""
        self.renew()
        copter, sense = self._copter, self._copter.sense
        p = copter.params
        if not (self._areas or p["GF_MAX_HOR_DIST"] > 0.0 or p["GF_MAX_VER_DIST"] > 0.0):
            self.breach = Breach()
        elif copter.position_ok:
            self.breach = self.at((sense.north, sense.east, sense.down))


def _areas(items: tuple[Item, ...], world: Position) -> list[Area]:
    """The items of a plan as areas; those that make none are passed over."""
    areas, at = [], 0
    while at < len(items):
        item = items[at]
        if item.command in (_CIRCLE_IN, _CIRCLE_OUT):
            if item.p1 > 0.0:
                areas.append(Area((_corner(item, world),), item.p1, item.command == _CIRCLE_IN))
            at += 1
        elif item.command in (_POLYGON_IN, _POLYGON_OUT) and item.p1 >= 1:
            count = int(item.p1)
            corners = tuple(_corner(each, world) for each in items[at : at + count])
            if len(corners) >= 3:
                areas.append(Area(corners, 0.0, item.command == _POLYGON_IN))
            at += count
        else:
            at += 1
    return areas


def _corner(item: Item, world: Position) -> Corner:
    north, east, _ = to_ned(Position(item.x * 1e-7, item.y * 1e-7, world.alt_amsl_m), world)
    return north, east


def _in_polygon(corners: tuple[Corner, ...], north: float, east: float) -> bool:
    """By how often a ray to the east crosses the sides (W. R. Franklin's even-odd rule)."""
    inside = False
    for (n1, e1), (n2, e2) in zip(corners, (*corners[1:], corners[0]), strict=True):
        if (n1 >= north) != (n2 >= north) and east < (e2 - e1) * (north - n1) / (n2 - n1) + e1:
            inside = not inside
    return inside
