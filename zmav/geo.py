"""Where things are: WGS84 and a local north-east-down frame about a declared origin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from zmav.wire import GlobalPosition, Origin, Vector

_A = 6378137.0
_E2 = 6.69437999014e-3


def _metres_per_radian(lat: float) -> tuple[float, float]:
    """Metres a radian of latitude and of longitude at ``lat`` (radians): the WGS84 radii of curvature."""
    w = 1.0 - _E2 * math.sin(lat) ** 2
    return _A * (1.0 - _E2) / w**1.5, _A / math.sqrt(w) * math.cos(lat)


def wrap_degrees(angle: float) -> float:
    """Brought into [-180, 180)."""
    return (angle + 180.0) % 360.0 - 180.0


def to_ned(origin: Origin | GlobalPosition, lat_deg: float, lon_deg: float, alt_amsl: float) -> Vector:
    """North, east, down in metres about ``origin``, by the radii of curvature there; down by altitude.

    A straight map, the same for everybody in the fleet. The true tangent plane differs at a distance d by up to
    d²·tan(latitude)/R: at 50° by a decimetre at 1 km, and by 11 m at 10 km.
    """
    north, east = _metres_per_radian(math.radians(origin.lat_deg))
    dlon = wrap_degrees(lon_deg - origin.lon_deg)
    return (
        math.radians(lat_deg - origin.lat_deg) * north,
        math.radians(dlon) * east,
        origin.alt_amsl - alt_amsl,
    )


def to_global(origin: Origin | GlobalPosition, ned: Vector) -> tuple[float, float, float]:
    """Latitude and longitude in degrees and altitude AMSL in metres of a local point: the inverse of :func:`to_ned`."""
    north, east = _metres_per_radian(math.radians(origin.lat_deg))
    lon = origin.lon_deg + math.degrees(ned[1] / east)
    return (
        origin.lat_deg + math.degrees(ned[0] / north),
        wrap_degrees(lon),
        origin.alt_amsl - ned[2],
    )


def to_ecef(lat_deg: float, lon_deg: float, height: float) -> Vector:
    """Earth-centred, earth-fixed, m; ``height`` is above the ellipsoid, m."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    radius = _A / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    level = (radius + height) * math.cos(lat)
    return level * math.cos(lon), level * math.sin(lon), (radius * (1.0 - _E2) + height) * math.sin(lat)


def from_ecef(place: Vector) -> Vector:
    """Latitude and longitude in degrees, and m above the ellipsoid: the inverse of :func:`to_ecef`."""
    x, y, z = place
    level, lat = math.hypot(x, y), math.atan2(z, math.hypot(x, y) * (1.0 - _E2))
    for _ in range(4):
        radius = _A / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
        lat = math.atan2(z + _E2 * radius * math.sin(lat), level)
    height = level * math.cos(lat) + z * math.sin(lat) - _A * math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    return math.degrees(lat), math.degrees(math.atan2(y, x)), height


def in_fleet_frame(known: GlobalPosition | Origin, local: Vector, fields: Mapping[str, Any]) -> Vector:
    """Where a GLOBAL_POSITION_INT (``fields``: lat and lon in 1e-7 degrees, alt in mm AMSL) is in the fleet's frame,
    by a near place that is known as WGS84 and there: a vehicle's state has both.
    """
    north, east, down = to_ned(known, fields["lat"] / 1e7, fields["lon"] / 1e7, fields["alt"] / 1e3)
    return local[0] + north, local[1] + east, local[2] + down


def plus(a: Vector, b: Vector, times: float) -> Vector:
    """``a`` and so many times ``b``."""
    return a[0] + b[0] * times, a[1] + b[1] * times, a[2] + b[2] * times


def between(a: Vector, b: Vector, share: float) -> Vector:
    """The point a share of the way from ``a`` to ``b``."""
    return a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share


def horizontal_distance(lat1_deg: float, lon1_deg: float, lat2_deg: float, lon2_deg: float) -> float:
    """Metres over the ground between two near points."""
    north, east, _ = to_ned(Origin(lat_deg=lat1_deg, lon_deg=lon1_deg, alt_amsl=0.0), lat2_deg, lon2_deg, 0.0)
    return math.hypot(north, east)
