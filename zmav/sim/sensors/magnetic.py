"""The Earth's magnetic field by the World Magnetic Model, as autopilots have it in their tables of declination.

Source: Chulliat et al., "The US/UK World Magnetic Model for 2025-2030", NOAA National Centers for Environmental
Information: equations 4 to 19 of the technical report, at sea level and with the coefficients of its epoch, whose
change in a year (a fifth of a degree at most places) is left out.
"""

from __future__ import annotations

import functools
import math
from importlib import resources

import numpy as np

from zmav.sim.arrays import Array

_RADIUS_KM = 6371.2  # to which the coefficients refer
_AXIS_KM, _ECCENTRICITY_2 = 6378.137, 0.00669437999014  # of the WGS-84 ellipsoid
_GAUSS_PER_NT = 1e-5


@functools.cache
def earth_field(lat_deg: float, lon_deg: float) -> tuple[float, float, float]:
    """North, east and down parts of the field at sea level, gauss."""
    lat, lon = math.radians(min(max(lat_deg, -89.999), 89.999)), math.radians(lon_deg)
    curvature = _AXIS_KM / math.sqrt(1.0 - _ECCENTRICITY_2 * math.sin(lat) ** 2)
    across, along = curvature * math.cos(lat), curvature * (1.0 - _ECCENTRICITY_2) * math.sin(lat)
    radius, centric = math.hypot(across, along), math.atan2(along, across)
    g, h = _coefficients()
    legendre, slope = _legendre(len(g) - 1, centric)
    north = east = down = 0.0
    for n in range(1, len(g)):
        order = np.arange(n + 1)
        cos, sin = np.cos(order * lon), np.sin(order * lon)
        scale = (_RADIUS_KM / radius) ** (n + 2)
        strength = g[n, : n + 1] * cos + h[n, : n + 1] * sin
        turned = order * (g[n, : n + 1] * sin - h[n, : n + 1] * cos)
        north -= scale * float(strength @ slope[n, : n + 1])
        east += scale * float(turned @ legendre[n, : n + 1]) / math.cos(centric)
        down -= (n + 1) * scale * float(strength @ legendre[n, : n + 1])
    # From the sphere's axes to the ellipsoid's.
    tilt = centric - lat
    level = north * math.cos(tilt) - down * math.sin(tilt)
    plumb = north * math.sin(tilt) + down * math.cos(tilt)
    return level * _GAUSS_PER_NT, east * _GAUSS_PER_NT, plumb * _GAUSS_PER_NT


@functools.cache
def _coefficients() -> tuple[Array, Array]:
    """g and h by degree and order, nT."""
    text = resources.files("zmav.sim").joinpath("data", "wmm2025.cof").read_text(encoding="ascii")
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    most = max(int(row[0]) for row in rows)
    g, h = np.zeros((most + 1, most + 1)), np.zeros((most + 1, most + 1))
    for n, m, g_nm, h_nm in rows:
        g[int(n), int(m)], h[int(n), int(m)] = float(g_nm), float(h_nm)
    return g, h


def _legendre(most: int, lat: float) -> tuple[Array, Array]:
    """Schmidt's quasi-normalised functions of the sine of a latitude, and their derivatives by the latitude, by degree
    and order.
    """
    s, c = math.sin(lat), math.cos(lat)
    p, d = np.zeros((most + 1, most + 1)), np.zeros((most + 1, most + 1))
    p[0, 0] = 1.0
    for n in range(1, most + 1):
        root = 1.0 if n == 1 else math.sqrt((2 * n - 1) / (2 * n))
        p[n, n] = root * c * p[n - 1, n - 1]
        d[n, n] = root * (c * d[n - 1, n - 1] - s * p[n - 1, n - 1])
        for m in range(n):
            below = math.sqrt((n - 1) ** 2 - m**2) if n > 1 and m < n - 1 else 0.0
            norm = math.sqrt(n**2 - m**2)
            lower, lower_slope = (p[n - 2, m], d[n - 2, m]) if n > 1 else (0.0, 0.0)
            p[n, m] = ((2 * n - 1) * s * p[n - 1, m] - below * lower) / norm
            d[n, m] = ((2 * n - 1) * (s * d[n - 1, m] + c * p[n - 1, m]) - below * lower_slope) / norm
    return p, d
