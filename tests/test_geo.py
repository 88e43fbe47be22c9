"""Local frames: there and back, against the exact geometry of the ellipsoid, and across the antimeridian."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav import geo
from zmav.wire import Origin, Vector

A, E2 = 6378137.0, 6.69437999014e-3
EARTH = 6_371_000.0

origins = st.builds(
    Origin,
    lat_deg=st.floats(-85.0, 85.0),
    lon_deg=st.floats(-180.0, 180.0),
    alt_amsl=st.floats(-400.0, 5000.0),
)
metres = st.floats(-10_000.0, 10_000.0)
points = st.tuples(metres, metres, st.floats(-3000.0, 3000.0))


def ecef(lat_deg: float, lon_deg: float, height: float) -> Vector:
    """Earth-centred coordinates of a place, from the textbook."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    level = (n + height) * math.cos(lat)
    return level * math.cos(lon), level * math.sin(lon), (n * (1.0 - E2) + height) * math.sin(lat)


def exact(origin: Origin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """North and east of a place on the plane that touches the ellipsoid at the origin."""
    here, there = ecef(origin.lat_deg, origin.lon_deg, 0.0), ecef(lat_deg, lon_deg, 0.0)
    x, y, z = (b - a for a, b in zip(here, there, strict=True))
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    out = math.cos(lon) * x + math.sin(lon) * y
    return -math.sin(lat) * out + math.cos(lat) * z, -math.sin(lon) * x + math.cos(lon) * y


@given(origins, points)
def test_there_and_back(origin: Origin, ned: Vector) -> None:
    lat, lon, alt = geo.to_global(origin, ned)
    assert -180.0 <= lon < 180.0
    assert geo.to_ned(origin, lat, lon, alt) == pytest.approx(ned, abs=1e-4)


@given(origins, st.floats(1.0, 10_000.0), st.floats(0.0, 2.0 * math.pi))
def test_as_near_the_tangent_plane_as_is_promised(origin: Origin, distance: float, bearing: float) -> None:
    ned = (distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    lat, lon, _ = geo.to_global(origin, ned)
    off = math.dist(exact(origin, lat, lon), ned[:2])
    curvature = distance**2 * math.tan(math.radians(abs(origin.lat_deg))) / EARTH
    assert off <= curvature + distance**3 / EARTH**2 + 1e-3


def test_a_known_place() -> None:
    """A second of latitude is 30.9 m at 50 degrees, a second of longitude 19.9 m."""
    origin = Origin(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0)
    second = 1.0 / 3600.0
    assert geo.to_ned(origin, 50.0 + second, 8.0 + second, 130.0) == pytest.approx((30.894, 19.919, -30.0), abs=0.005)


@pytest.mark.parametrize(("home", "away"), [(179.9999, -179.9999), (-179.9999, 179.9999), (180.0, -179.9998)])
def test_across_the_antimeridian(home: float, away: float) -> None:
    origin = Origin(lat_deg=-17.0, lon_deg=home, alt_amsl=0.0)
    north, east, _ = geo.to_ned(origin, -17.0, away, 0.0)
    assert north == 0.0
    assert abs(east) == pytest.approx(21.3, abs=0.1)
    assert (east > 0.0) is (away < 0.0)
    lat, lon, _ = geo.to_global(origin, (0.0, east, 0.0))
    assert (lat, lon) == pytest.approx((-17.0, away), abs=1e-9)


def test_distances() -> None:
    assert geo.horizontal_distance(50.0, 8.0, 50.0, 8.0) == 0.0
    assert geo.horizontal_distance(50.0, 179.99995, 50.0, -179.99995) == pytest.approx(7.17, abs=0.01)


@given(origins)
def test_a_place_is_told_in_the_fleet_s_frame_by_a_near_one(origin: Origin) -> None:
    known, local = Origin(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_amsl=100.0), (30.0, -20.0, -5.0)
    lat, lon, alt = geo.to_global(known, (7.0, 3.0, -2.0))
    fields = {"lat": round(lat * 1e7), "lon": round(lon * 1e7), "alt": round(alt * 1e3)}
    assert geo.in_fleet_frame(known, local, fields) == pytest.approx((37.0, -17.0, -7.0), abs=0.02)
