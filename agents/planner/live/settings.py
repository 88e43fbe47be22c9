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
from zmav.wire import swarm

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
    """The fleet file's geofence about its origin; of a circle, a polygon inside it. Heights above home are taken to be
    above the origin.
    """
    fence, origin, far = file.geofence, file.origin, NO_CEILING
    if origin is None:
        return None
    if fence.polygon:
        corners = [geo.to_ned(origin, lat, lon, origin.alt_amsl)[:2] for lat, lon in fence.polygon]
    elif fence.radius is not None and fence.radius < math.inf:
        angles = [math.tau * i / ROUND for i in range(ROUND)]
        corners = [(fence.radius * math.cos(a), fence.radius * math.sin(a)) for a in angles]
    else:
        return None
    floor = -far if fence.floor is None else max(-far, fence.floor)
    ceiling = far if fence.ceiling is None else min(far, fence.ceiling)
    return swarm.Geofence(polygon=corners, floor=floor, ceiling=ceiling)
