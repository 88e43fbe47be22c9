"""The Earth's magnetic field as a tilted dipole: the first three Gauss coefficients of IGRF-13 (epoch 2020).

Source: Alken et al., "International Geomagnetic Reference Field: the thirteenth generation", Earth, Planets and
Space 73:49, 2021. Good to some ten degrees in direction, which is all that a simulated compass without errors needs.
"""

from __future__ import annotations

import math

_G10, _G11, _H11 = -0.294048, -0.014509, 0.046525  # gauss


def earth_field(lat_deg: float, lon_deg: float) -> tuple[float, float, float]:
    """North, east and down parts of the field at sea level, gauss."""
    colat, lon = math.radians(90.0 - lat_deg), math.radians(lon_deg)
    across = _G11 * math.cos(lon) + _H11 * math.sin(lon)
    north = -_G10 * math.sin(colat) + across * math.cos(colat)
    east = _G11 * math.sin(lon) - _H11 * math.cos(lon)
    down = -2.0 * (_G10 * math.cos(colat) + across * math.sin(colat))
    return north, east, down
