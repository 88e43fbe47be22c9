"""The geofence: a cylinder about home (GF_MAX_HOR_DIST, GF_MAX_VER_DIST), and the polygons and circles of the plan.

https://docs.px4.io/v1.16/en/flying/geofence.html. An area that home, or a flying vehicle, is on the wrong side of is
not taken. What happens at a breach is GF_ACTION; it is looked for five times a second, at where the vehicle is
(GF_PREDICT 0).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav.sim.autopilots.areas import Area, areas_of
from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.items import FenceItems
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.control.setpoints import Vector


class Breach(NamedTuple):
    """Which of its parts are breached."""

    distance: bool = False
    height: bool = False
    area: bool = False

    def __bool__(self) -> bool:
        return self.distance or self.height or self.area


class Fence:
    """One vehicle's geofence; ``breach`` is what was found lately."""

    def __init__(self, copter: Px4State, items: FenceItems) -> None:
        self._copter, self._items = copter, items
        self._areas: tuple[Area, ...] = ()
        self._known = 0
        self.breach = Breach()

    def renew(self) -> None:
        """Take the areas of the plan, where it has changed."""
        items = self._items
        if self._known != items.opaque_id:
            self._known = items.opaque_id
            self._areas = tuple(area for area in areas_of(items.items, self._copter.world) if self._fits(area))

    def _fits(self, area: Area) -> bool:
        copter = self._copter
        if copter.has_home and area.outside_by(*copter.home_world[:2]) > 0.0:
            copter.tell(events.FENCE_WITHOUT_HOME)
            return False
        sense = copter.sense
        if copter.params["GF_ACTION"] and not copter.landed and area.outside_by(sense.north, sense.east) > 0.0:
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
            any(area.outside_by(place[0], place[1]) > 0.0 for area in self._areas),
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
