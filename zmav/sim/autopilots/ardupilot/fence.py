"""ArduPilot's fence: a ceiling, a floor, a circle about home, and polygons and circles to stay in or out of.

After ArduPilot's AC_Fence library; https://ardupilot.org/copter/docs/common-geofencing-landing-page.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots import items
from zmav.sim.autopilots.areas import CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, Area, Corner, areas_of, corner
from zmav.sim.autopilots.items import Item, ItemStore, Result, check_place
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

CEILING, CIRCLE, POLYGON, FLOOR = 1, 2, 4, 8  # FENCE_TYPE
EVERYTHING = CEILING | CIRCLE | POLYGON | FLOOR
REPORT_ONLY, ALWAYS_LAND, BRAKE_OR_LAND = 0, 2, 4  # FENCE_ACTION
UNION, NO_MODE_CHANGE = 2, 1  # FENCE_OPTIONS
WHEN_ARMED = 3  # FENCE_AUTOENABLE
GIVE_UP_M = 100.0  # beyond, it just lands
BACKUP_M = 20.0  # farther out: another breach
RECOVERY_S = 10.0
RETURN_POINT = 5000  # MAV_CMD_NAV_FENCE_RETURN_POINT
_FRAMES = (0, 3, 5, 6, 10, 11)
_NAMES = ((CEILING, "Max Alt"), (CIRCLE, "Circle"), (POLYGON, "Polygon"), (FLOOR, "Min Alt"))
_WARNING, _NOTICE, _INFO, _DEBUG = 4, 5, 6, 7


class FenceItems(ItemStore):
    """The polygons and circles; a new list takes effect as a whole."""

    kind: ClassVar[int] = items.FENCE
    title: ClassVar[str] = "Fence"
    most: ClassVar[int] = 70

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self._items: list[Item] = []
        self._new: list[Item | None] = []
        self.areas: list[Area] = []

    def __len__(self) -> int:
        return len(self._items)

    def read(self, seq: int) -> Item | Result:
        return self._items[seq] if seq < len(self._items) else Result.INVALID_SEQUENCE

    def open(self, count: int) -> Result:
        self._new = [None] * count
        return Result.ACCEPTED

    def reopen(self) -> Result:
        self._new = list(self._items)
        return Result.ACCEPTED

    def put(self, item: Item, last: int) -> Result:
        if item.seq >= len(self._new):
            return Result.INVALID_SEQUENCE
        if item.frame not in _FRAMES:
            return Result.UNSUPPORTED_FRAME
        if not RETURN_POINT <= item.command <= CIRCLE_OUT:
            return Result.UNSUPPORTED
        if item.command in (POLYGON_IN, POLYGON_OUT) and not item.p1 <= 255:
            return Result.INVALID_PARAM1
        p1 = float(int(item.p1)) if item.command in (POLYGON_IN, POLYGON_OUT) and item.p1 > 0 else item.p1
        p1 = 0.0 if item.command == RETURN_POINT else p1
        self._new[item.seq] = Item(
            command=item.command, frame=0, p1=p1, x=item.x, y=item.y, seq=item.seq, autocontinue=0
        )
        return Result.ACCEPTED

    def close(self) -> Result:
        new = [item for item in self._new if item is not None]
        self._new = []
        fault = self._fault(new)
        if fault:
            self._vehicle.say(_WARNING, fault)
            self._vehicle.say(_WARNING, "Fence validation failed")
            return Result.ERROR
        self._items = new
        self.areas = list(areas_of(new, self._vehicle.world))
        self._vehicle.say(_DEBUG, "Fence Indexed OK")
        self._vehicle.sized("FENCE_TOTAL", len(new) + 2 if len(new) >= 3 else 0)
        return Result.ACCEPTED

    def abandon(self) -> None:
        self._new = []

    def clear(self) -> bool:
        self._items, self.areas = [], []
        self._vehicle.say(_DEBUG, "Fence Indexed OK")
        self._vehicle.sized("FENCE_TOTAL", 0)
        return True

    @staticmethod
    def _fault(new: list[Item]) -> str:
        """What is wrong with the whole, in ArduPilot's words; empty: nothing."""
        left, kind, size, returns = 0, 0, 0.0, 0
        for item in new:
            if item.command in (POLYGON_IN, POLYGON_OUT):
                if not item.p1 >= 3:
                    return f"Invalid vertex count ({int(item.p1) if item.p1 > 0 else 0})"
                if left == 0:
                    left, kind, size = int(item.p1), item.command, item.p1
                elif item.command != kind:
                    return "Received incorrect vertex type"
                elif item.p1 != size:
                    return f"Unexpected vertex count want={int(size)} got={int(item.p1)}"
                left -= 1
            elif left:
                return "Received incorrect type"
            elif item.command == RETURN_POINT:
                returns += 1
                if returns > 1:
                    return "Multiple return points"
            elif not item.p1 > 0:
                return "Non-positive circle radius"
            if check_place(item) is not Result.ACCEPTED:
                return "Bad lat or lon"
        return "Incorrect item count" if left else ""


class Fence:
    """Watches where the vehicle is, 25 times a second, and acts on a breach."""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self.items = FenceItems(vehicle)
        self.power_on()

    def power_on(self) -> None:
        self.enabled = 0  # of the types, those that are watched
        self.breached = 0
        self.breaches = 0
        self.breach_time = 0.0
        self._parameter = -1.0
        self._recovering: float | None = None
        self._backup: dict[int, float] = {}
        self._beyond: dict[int, float] = {}

    # ---- what there is

    @property
    def configured(self) -> int:
        params = self._vehicle.params
        return int(params["FENCE_TYPE"]) & (EVERYTHING if "FENCE_ALT_MAX" in params else CIRCLE | POLYGON)

    @property
    def present(self) -> int:
        return self.configured & (EVERYTHING if self.items.areas else EVERYTHING & ~POLYGON)

    @property
    def active(self) -> int:
        return self.enabled & self.present

    def allows(self, place: Vector) -> bool:
        """Whether GUIDED may be sent to a point of the world's NED."""
        vehicle, params, active = self._vehicle, self._vehicle.params, self.active
        home = vehicle.home_world
        height, away = home[2] - place[2], math.hypot(place[0] - home[0], place[1] - home[1])
        outside = (
            active & CEILING and height > params["FENCE_ALT_MAX"],
            active & FLOOR and height < params["FENCE_ALT_MIN"],
            active & CIRCLE and away > params["FENCE_RADIUS"],
            active & POLYGON and self._outside_areas(place[0], place[1]) > 0,
        )
        return not any(outside)

    @property
    def return_point(self) -> Corner | None:
        """Where a plane returns to, north and east in the world; None where none was uploaded."""
        for seq in range(len(self.items)):
            item = self.items.read(seq)
            if isinstance(item, Item) and item.command == RETURN_POINT:
                return corner(item, self._vehicle.world)
        return None

    @property
    def ceiling(self) -> float | None:
        """The height above home that flying back keeps below, m; None without a ceiling."""
        params = self._vehicle.params
        return params["FENCE_ALT_MAX"] - params["FENCE_MARGIN"] if self.active & CEILING else None

    @property
    def blocks_mode_change(self) -> bool:
        vehicle = self._vehicle
        if not (self.breached and vehicle.armed and not vehicle.landed and vehicle.mode_by_fence):
            return False
        return bool(int(vehicle.params["FENCE_OPTIONS"]) & NO_MODE_CHANGE)

    def fault(self) -> str:
        """Why arming is refused for the fence's sake; empty: it is not."""
        params = self._vehicle.params
        if params["FENCE_ENABLE"] and not self.present:
            return "Fences enabled, but none selected"
        if not (self.enabled or params.get("FENCE_AUTOENABLE")) or not self.configured:
            return ""
        if self.configured & (CIRCLE | POLYGON) and not self._vehicle.position_ok:
            return "Fence requires position"
        if self.configured & CIRCLE and params["FENCE_RADIUS"] < 0:
            return "Invalid Circle FENCE_RADIUS value"
        if self.configured & CIRCLE and params["FENCE_RADIUS"] < params["FENCE_MARGIN"]:
            return "Circle FENCE_MARGIN is greater than FENCE_RADIUS"
        if params.get("FENCE_ALT_MAX") < 0.0:
            return "Invalid FENCE_ALT_MAX value"
        breached = self.breached
        if int(params.get("FENCE_AUTOENABLE")) == WHEN_ARMED and self.configured & POLYGON:
            s = self._vehicle.sense
            breached |= POLYGON * (self._outside_areas(s.north, s.east) > 0)
        if breached:
            return f"Vehicle breaching {names(breached)}"
        if params["FENCE_MARGIN"] < 0:
            return "Invalid FENCE_MARGIN value"
        if (
            "FENCE_ALT_MAX" in params
            and params["FENCE_ALT_MAX"] - params["FENCE_ALT_MIN"] <= 2.0 * params["FENCE_MARGIN"]
        ):
            return "FENCE_MARGIN too big"
        return ""

    def on_arming(self) -> None:
        if int(self._vehicle.params.get("FENCE_AUTOENABLE")) == WHEN_ARMED:
            self.enabled |= self.configured & ~FLOOR
            if self.active:
                self._vehicle.say(_NOTICE, f"{names(self.active)} auto-enabled")

    # ---- watching

    def update(self) -> None:
        vehicle = self._vehicle
        parameter = vehicle.params["FENCE_ENABLE"]
        if parameter != self._parameter:
            self._parameter = parameter
            self.enabled = self.configured & ~FLOOR if parameter else 0
        if not self.enabled and not self.breached:
            return
        before = self.breached
        self.breached &= self.configured
        if vehicle.landed or not vehicle.armed:
            self.enabled &= ~FLOOR
            self.breached &= ~FLOOR
        elif self.configured & FLOOR and not self.enabled & FLOOR and self.enabled:
            self._raise_floor()
        new = 0
        for kind, beyond in self._measure():
            new |= self._judge(kind, beyond)
        if self._recovering is not None:
            if vehicle.now - self._recovering < RECOVERY_S:
                new = 0
            else:
                self._recovering = None
        if before and not self.breached and not vehicle.landed:
            vehicle.say(_NOTICE, "Fence breach cleared")
        if new and vehicle.armed:
            self._act(new)

    def _raise_floor(self) -> None:
        params = self._vehicle.params
        if self._vehicle.height >= params["FENCE_ALT_MIN"] + params["FENCE_MARGIN"]:
            self.enabled |= FLOOR
            self._vehicle.say(_NOTICE, "Min Alt fence enabled (auto enable)")

    def _measure(self) -> list[tuple[int, float]]:
        """How far beyond each active fence it is, metres."""
        vehicle, params, active = self._vehicle, self._vehicle.params, self.active
        found = []
        if active & CEILING:
            found.append((CEILING, vehicle.height - params["FENCE_ALT_MAX"]))
        if active & FLOOR:
            found.append((FLOOR, params["FENCE_ALT_MIN"] - vehicle.height))
        if active & CIRCLE and vehicle.position_ok:
            found.append((CIRCLE, vehicle.from_home - params["FENCE_RADIUS"]))
        if active & POLYGON and vehicle.position_ok:
            found.append((POLYGON, self._outside_areas(vehicle.sense.north, vehicle.sense.east)))
        return found

    def _outside_areas(self, north: float, east: float) -> float:
        inside = [a.outside_by(north, east) for a in self.items.areas if a.inside]
        out = [a.outside_by(north, east) for a in self.items.areas if not a.inside]
        union = bool(int(self._vehicle.params["FENCE_OPTIONS"]) & UNION)
        allowed = [min(inside)] if inside and union else inside
        return max([*allowed, *out], default=-math.inf)

    def _judge(self, kind: int, beyond: float) -> int:
        """Note a breach, or its end; gives the kind where the breach is new."""
        self._beyond[kind] = beyond
        at_edge = beyond >= 0 if kind != POLYGON else beyond > 0
        if not at_edge:
            self.breached &= ~kind
            self._backup.pop(kind, None)
            return 0
        if self.breached & kind and (kind == POLYGON or beyond < self._backup.get(kind, math.inf)):
            return 0
        if not self.breached:
            self.breach_time = self._vehicle.uptime
            self._vehicle.report("FENCE_STATUS")
        self.breaches += 1
        self.breached |= kind
        self._backup[kind] = beyond + BACKUP_M
        return kind

    def _act(self, new: int) -> None:
        vehicle = self._vehicle
        if not vehicle.landed:
            vehicle.say(_NOTICE, f"{names(new)} breached")
        if int(vehicle.params["FENCE_ACTION"]) != REPORT_ONLY:
            beyond = max(self._beyond.get(kind, 0.0) for kind, _ in _NAMES if new & kind)
            vehicle.reactions.fence_breached(new, beyond)

    def mode_changed(self) -> None:
        """Any change of mode in a breach is taken for the pilot's recovery: ten seconds of grace."""
        if self.breached and int(self._vehicle.params["FENCE_ACTION"]) != REPORT_ONLY:
            self._recovering = self._vehicle.now
            self._vehicle.say(_INFO, "Manual recovery started")


def names(kinds: int) -> str:
    """Fences by name, as ArduPilot lists them."""
    found = [name for kind, name in _NAMES if kinds & kind]
    if len(found) < 2:
        return f"{''.join(found)} fence"
    return f"{', '.join(found[:-1])} and {found[-1]} fences"
