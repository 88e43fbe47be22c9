"""How a planning agent is set up."""

from __future__ import annotations

import math

import msgspec

from agents.planner.execute.flight import TRACKING
from agents.planner.live.field import FleetField
from agents.planner.live.leadership.election import PATIENCE
from agents.planner.model.ground import GroundMap
from zmav import geo, keys
from zmav.config import FleetConfig, Geofence
from zmav.errors import BadConfig
from zmav.wire import Origin, swarm

ROUND = 32
"""corners of the polygon that a round fence is kept as: they lie on it"""
FENCE = "fleet-file"
NO_CEILING = 10_000.0
"""m"""
BOUNDS = {
    "margin": (0.0, 20.0),
    "tracking": (0.05, 5.0),
    "downwash": (1.0, 10.0),
    "traffic": (0.0, 2000.0),
    "patience": (1.0, 600.0),
}
"""of the settings, each in its own unit"""


class PlannerSettings(msgspec.Struct, kw_only=True, frozen=True):
    """One planner. Raises :class:`~zmav.errors.BadConfig` naming what cannot be, and :class:`~zmav.errors.BadKey`."""

    name: str = "planner"
    """the host's name, as it stands in keys"""
    fleet: str = "demo"
    standby: bool = False
    """let others take charge first"""
    margin: float = 0.5
    """m that every two vehicles keep in plans beyond the sum of their radii"""
    tracking: float = TRACKING
    """m, of the margin, by which a vehicle may be off its trajectory, and at its goal"""
    downwash: float = 1.5
    """how much farther above each other than beside each other vehicles stay"""
    traffic: float = 100.0
    """m kept from aircraft that are not of the fleet, beyond what their places may be off; 0: from none"""
    patience: float = PATIENCE
    """s without token and book after which it takes charge"""
    plan_seconds: float = 15.0
    """s of the processor that the solver may take for a plan"""
    unknown_batteries: bool = False
    """vehicles may fly goals of whose batteries it is not known what is left in them"""
    field: FleetField = FleetField(Geofence(), {}, None)
    """what the fleet file declares; goals are held to it, and to a club's field for the rest"""
    ground: GroundMap | None = None
    """how high the ground is; None: not known"""
    geofence: swarm.Geofence | None = None
    """the same as plans are held to it; None: none that they must be"""

    def __post_init__(self) -> None:
        keys.check_name(self.name, "name")
        keys.check_name(self.fleet, "fleet")
        for field, (least, most) in BOUNDS.items():
            value = getattr(self, field)
            if not least <= value <= most:  # nor a number that is none: nothing would be too near or too far off then
                raise BadConfig.wrong(field, value, f"{least} to {most}")


def fence_of(file: FleetConfig) -> swarm.Geofence | None:
    """The fleet file's geofence about its origin; heights above home are taken to be above the origin."""
    fence = file.geofence
    if file.origin is None:
        return None
    corners = _corners(fence, file.origin)
    if corners is None:
        return None
    floor = max(-NO_CEILING, -NO_CEILING if fence.floor is None else fence.floor)
    ceiling = min(NO_CEILING, NO_CEILING if fence.ceiling is None else fence.ceiling)
    return swarm.Geofence(polygon=corners, floor=floor, ceiling=ceiling)


def _corners(fence: Geofence, origin: Origin) -> list[swarm.Corner] | None:
    """North and east of the origin: of the polygon, or of one inside the circle where there is only that."""
    if fence.polygon:
        places = [geo.to_ned(origin, lat, lon, origin.alt_amsl) for lat, lon in fence.polygon]
        return [(north, east) for north, east, _ in places]
    if fence.radius in (None, math.inf):
        return None
    assert fence.radius is not None
    angles = [math.tau * i / ROUND for i in range(ROUND)]
    return [(fence.radius * math.cos(a), fence.radius * math.sin(a)) for a in angles]
