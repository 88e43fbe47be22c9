"""How a planning agent is set up."""

from __future__ import annotations

import math

import msgspec

from agents.planner.live.charge import PATIENCE
from zmav import geo, keys
from zmav.config import FleetConfig, Geofence
from zmav.errors import BadConfig
from zmav.wire import Origin, swarm

ROUND = 32
"""corners of the polygon that a round fence is kept as: they lie on it"""
FENCE = "fleet-file"
NO_CEILING = 10_000.0
"""m"""


class Settings(msgspec.Struct, kw_only=True, frozen=True):
    """One planner. Raises :class:`~zmav.errors.BadInput` from :func:`check` for what makes no sense."""

    name: str = "planner"
    """the host's name, as it stands in keys"""
    fleet: str = "demo"
    standby: bool = False
    """let others take charge first"""
    margin: float = 0.5
    """m that every two vehicles keep in plans beyond the sum of their radii"""
    downwash: float = 1.5
    """how much farther above each other than beside each other vehicles stay"""
    patience: float = PATIENCE
    """s without token and book after which it takes charge"""
    plan_seconds: float = 15.0
    """s that the solver may take"""
    priority: int = 0
    """of the leases"""
    clock_error: float = math.inf
    """s by which all hosts' clocks agree, because something else keeps them so (chrony, GPS); inf: they are measured"""
    geofence: swarm.Geofence | None = None


def check(settings: Settings) -> None:
    """Raises :class:`BadConfig` naming what cannot be."""
    keys.check_name(settings.name, "name")
    keys.check_name(settings.fleet, "fleet")
    for field, least, most in (("margin", 0.0, 20.0), ("downwash", 1.0, 10.0), ("patience", 1.0, 600.0),
                               ("clock_error", 0.001, math.inf)):  # fmt: skip
        value = getattr(settings, field)
        if not least <= value <= most:
            text = f"{field} is {value}; expected {least} to {most}"
            raise BadConfig(text, field=field, value=value, expected=f"{least} to {most}")


def fence_of(file: FleetConfig) -> swarm.Geofence | None:
    """The fleet file's geofence about its origin; heights above home are taken to be above the origin."""
    fence = file.geofence
    if file.origin is None:
        return None
    corners = _corners(fence, file.origin)
    if corners is None:
        return None
    floor = fence.floor if fence.floor is not None else -NO_CEILING
    ceiling = fence.ceiling if fence.ceiling is not None else NO_CEILING
    return swarm.Geofence(polygon=corners, floor=floor, ceiling=ceiling)


def _corners(fence: Geofence, origin: Origin) -> list[swarm.Corner] | None:
    """North and east of the origin: of the polygon, or of one inside the circle where there is only that."""
    if fence.polygon:
        places = [geo.to_ned(origin, lat, lon, origin.alt_amsl) for lat, lon in fence.polygon]
        return [(north, east) for north, east, _ in places]
    if fence.radius is None:
        return None
    angles = [math.tau * i / ROUND for i in range(ROUND)]
    return [(fence.radius * math.cos(a), fence.radius * math.sin(a)) for a in angles]
