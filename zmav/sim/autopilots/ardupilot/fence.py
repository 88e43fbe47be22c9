"""ArduPilot's fence: a ceiling, a circle about home, and polygons and circles to stay in or out of.

After ArduPilot's AC_Fence library; https://ardupilot.org/copter/docs/common-geofencing-landing-page.html
"""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots import items
from zmav.sim.autopilots.ardupilot.plan import MISSION_FRAME, kept_frame
from zmav.sim.autopilots.ardupilot.state import DEBUG, INFO, NOTICE, WARNING, VehicleState
from zmav.sim.autopilots.items import (
    CIRCLE_OUT,
    POLYGON_IN,
    POLYGON_OUT,
    Area,
    Item,
    WholeList,
    areas_of,
    check_place,
)
from zmav.sim.control.setpoints import Vector

CEILING, CIRCLE, POLYGON = 1, 2, 4  # FENCE_TYPE
EVERYTHING = CEILING | CIRCLE | POLYGON
REPORT_ONLY, ALWAYS_LAND, BRAKE_OR_LAND = 0, 2, 4  # FENCE_ACTION
NO_MODE_CHANGE = 1  # FENCE_OPTIONS
GIVE_UP_M = 100.0  # beyond, it just lands
BACKUP_M = 20.0  # farther out: another breach
RECOVERY_S = 10.0
RALLY_POINT = 5100  # MAV_CMD_NAV_RALLY_POINT
_FARTHEST_M = 32767.0
RETURN_POINT = 5000  # MAV_CMD_NAV_FENCE_RETURN_POINT
_FRAMES = (0, 3, 5, 6, 10, 11)
_NAMES = ((CEILING, "Max Alt"), (CIRCLE, "Circle"), (POLYGON, "Polygon"))


class FenceItems(WholeList):
    """The polygons and circles."""

    kind: ClassVar[int] = items.FENCE
    title: ClassVar[str] = "Fence"
    most: ClassVar[int] = 70

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__()
        self._vehicle = vehicle
        self.areas: list[Area] = []

    def kept(self, item: Item) -> Item | MissionResult:
        if item.frame not in _FRAMES:
            return MissionResult.UNSUPPORTED_FRAME
        if not RETURN_POINT <= item.command <= CIRCLE_OUT:
            return MissionResult.UNSUPPORTED
        if item.command in (POLYGON_IN, POLYGON_OUT) and not item.p1 <= 255:
            return MissionResult.INVALID_PARAM1
        p1 = float(int(item.p1)) if item.command in (POLYGON_IN, POLYGON_OUT) and item.p1 > 0 else item.p1
        p1 = 0.0 if item.command == RETURN_POINT else p1
        return Item(command=item.command, frame=0, p1=p1, x=item.x, y=item.y, seq=item.seq, autocontinue=0)

    def judge(self, new: tuple[Item, ...]) -> MissionResult:
        fault = self._fault(new)
        if not fault:
            return MissionResult.ACCEPTED
        self._vehicle.say(WARNING, fault)
        self._vehicle.say(WARNING, "Fence validation failed")
        return MissionResult.ERROR

    def changed(self) -> None:
        self.areas = list(areas_of(self.items, self._vehicle.world))
        self._vehicle.say(DEBUG, "Fence Indexed OK")
        self._vehicle.sized("FENCE_TOTAL", len(self.items) + 2 if len(self.items) >= 3 else 0)

    @staticmethod
    def _fault(new: tuple[Item, ...]) -> str:
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
            if check_place(item) is not MissionResult.ACCEPTED:
                return "Bad lat or lon"
        return "Incorrect item count" if left else ""


class Fence:
    """Watches where the vehicle is, 25 times a second, and acts on a breach."""

    def __init__(self, vehicle: VehicleState) -> None:
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
        return not any(beyond > 0 for _, beyond in self._measure(place))

    @property
    def ceiling(self) -> float | None:
        """The height above home that flying back keeps below, m; None without a ceiling."""
        params = self._vehicle.params
        return params["FENCE_ALT_MAX"] - params["FENCE_MARGIN"] if self.active & CEILING else None

    @property
    def blocks_mode_change(self) -> bool:
        """It brings the vehicle back, and lets nobody take it meanwhile (FENCE_OPTIONS)."""
        vehicle = self._vehicle
        acts = self.breached and vehicle.armed and not vehicle.landed and vehicle.mode_by_fence
        return bool(acts and int(vehicle.params["FENCE_OPTIONS"]) & NO_MODE_CHANGE)

    def faults(self) -> list[str]:
        """Why arming is refused for the fence's sake."""
        params, configured = self._vehicle.params, self.configured
        if params["FENCE_ENABLE"] and not self.present:
            return ["Fences enabled, but none selected"]
        if not self.enabled or not configured:
            return []
        checks = (
            (configured & (CIRCLE | POLYGON) and not self._vehicle.position_ok, "Fence requires position"),
            (
                configured & CIRCLE and params["FENCE_RADIUS"] < params["FENCE_MARGIN"],
                "Circle FENCE_MARGIN is greater than FENCE_RADIUS",
            ),
            (self.breached, f"Vehicle breaching {names(self.breached)}"),
        )
        return [text for failed, text in checks if failed][:1]

    # ---- watching

    def update(self) -> None:
        vehicle = self._vehicle
        parameter = vehicle.params["FENCE_ENABLE"]
        if parameter != self._parameter:
            self._parameter = parameter
            self.enabled = self.configured if parameter else 0
        if not self.enabled and not self.breached:
            return
        before = self.breached
        self.breached &= self.configured
        new = 0
        sense = vehicle.sense
        for kind, beyond in self._measure((sense.north, sense.east, sense.down)):
            if kind == CEILING or vehicle.position_ok:
                new |= self._judge(kind, beyond)
        if self._recovering is not None:
            if vehicle.now - self._recovering < RECOVERY_S:
                new = 0
            else:
                self._recovering = None
        if before and not self.breached and not vehicle.landed:
            vehicle.say(NOTICE, "Fence breach cleared")
        if new and vehicle.armed:
            self._act(new)

    def _measure(self, place: Vector) -> list[tuple[int, float]]:
        """How far beyond each active fence a point of the world's NED is, metres."""
        params, home = self._vehicle.params, self._vehicle.home_world
        found, active = [], self.active
        if active & CEILING:
            found.append((CEILING, home[2] - place[2] - params["FENCE_ALT_MAX"]))
        if active & CIRCLE:
            found.append((CIRCLE, math.hypot(place[0] - home[0], place[1] - home[1]) - params["FENCE_RADIUS"]))
        if active & POLYGON:
            found.append((POLYGON, max(area.outside_by(place[0], place[1]) for area in self.items.areas)))
        return found

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
            vehicle.say(NOTICE, f"{names(new)} breached")
        if int(vehicle.params["FENCE_ACTION"]) != REPORT_ONLY:
            beyond = max(self._beyond.get(kind, 0.0) for kind, _ in _NAMES if new & kind)
            vehicle.reactions.fence_breached(new, beyond)

    def mode_changed(self) -> None:
        """Any change of mode in a breach is taken for the pilot's recovery: ten seconds of grace."""
        if self.breached and int(self._vehicle.params["FENCE_ACTION"]) != REPORT_ONLY:
            self._recovering = self._vehicle.now
            self._vehicle.say(INFO, "Manual recovery started")


def names(kinds: int) -> str:
    """Fences by name, as ArduPilot lists them."""
    found = [name for kind, name in _NAMES if kinds & kind]
    if len(found) < 2:
        return f"{''.join(found)} fence"
    return f"{', '.join(found[:-1])} and {found[-1]} fences"


class Rally(WholeList):
    """Points that it may return to instead of home: https://ardupilot.org/copter/docs/common-rally-points.html"""

    kind: ClassVar[int] = items.RALLY
    title: ClassVar[str] = "Rally"
    most: ClassVar[int] = 46

    def __init__(self, vehicle: VehicleState, fence: Fence) -> None:
        super().__init__()
        self._vehicle, self._fence = vehicle, fence

    def kept(self, item: Item) -> Item | MissionResult:
        if item.command != RALLY_POINT:
            return MissionResult.UNSUPPORTED
        bad = check_place(item)
        if bad is not MissionResult.ACCEPTED:
            return bad
        if not -_FARTHEST_M - 1 <= item.z <= _FARTHEST_M:
            return MissionResult.INVALID_PARAM7
        frame = kept_frame(item.frame)
        if frame is None or item.frame == MISSION_FRAME:
            return MissionResult.UNSUPPORTED_FRAME
        z = float(int(item.z))
        return Item(command=RALLY_POINT, frame=frame, x=item.x, y=item.y, z=z, seq=item.seq, autocontinue=0)

    def changed(self) -> None:
        self._vehicle.sized("RALLY_TOTAL", len(self.items))

    def nearest(self) -> Vector:
        """Where to return to from here: the nearest point within RALLY_LIMIT_KM, or home where that is nearer."""
        vehicle, s = self._vehicle, self._vehicle.sense
        home = vehicle.home_world
        points = [vehicle.place_of(item, home) for item in self.items]
        places = [point for point in points if self._fence.allows(point)]
        if not places:
            return home
        best = min(places, key=lambda p: math.hypot(p[0] - s.north, p[1] - s.east))
        away = math.hypot(best[0] - s.north, best[1] - s.east)
        limit = vehicle.params["RALLY_LIMIT_KM"] * 1000.0
        if limit > 0 and away > limit:
            return home
        return best if not vehicle.params["RALLY_INCL_HOME"] or away < vehicle.from_home else home
