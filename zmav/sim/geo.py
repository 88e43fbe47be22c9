"""Between degrees and metres, the way ArduPilot does it.

ArduPilot flies on a flat Earth: one degree of latitude is 111 318.845 m (a sphere of 6 378 100 m), one of longitude
that times the cosine of the latitude. The simulated world is flat in the same sense, so that a vehicle's
GLOBAL_POSITION_INT and its LOCAL_POSITION_NED agree with each other exactly as the real one's do.
Source: ardupilot.org, "Location" class (LOCATION_SCALING_FACTOR).
"""

from __future__ import annotations

import math

import msgspec

from zmav.geo import wrap_degrees

METRES_PER_DEGREE = 111_318.84502145034


class Position(msgspec.Struct, frozen=True):
    """A point: latitude and longitude in degrees (WGS84), altitude in metres AMSL."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


def to_ned(point: Position, origin: Position) -> tuple[float, float, float]:
    """``point`` as (north, east, down) metres about ``origin``."""
    north = (point.lat_deg - origin.lat_deg) * METRES_PER_DEGREE
    east = wrap_degrees(point.lon_deg - origin.lon_deg) * METRES_PER_DEGREE * _longitude_scale(origin.lat_deg)
    return north, east, origin.alt_amsl_m - point.alt_amsl_m


def from_ned(north: float, east: float, down: float, origin: Position) -> Position:
    """The point that lies (north, east, down) metres from ``origin``."""
    return Position(
        origin.lat_deg + north / METRES_PER_DEGREE,
        wrap_degrees(origin.lon_deg + east / (METRES_PER_DEGREE * _longitude_scale(origin.lat_deg))),
        origin.alt_amsl_m - down,
    )


def _longitude_scale(lat_deg: float) -> float:
    return max(math.cos(math.radians(lat_deg)), 0.01)
