"""The International Standard Atmosphere below 11 km, and what a pitot tube makes of it.

Source: ISO 2533:1975; a lapse of 6.5 K/km from 288.15 K and 1013.25 hPa at sea level.
"""

from __future__ import annotations

SEA_LEVEL_HPA = 1013.25
SEA_LEVEL_K = 288.15
LAPSE_K_PER_M = 0.0065
_EXPONENT = 5.25588
_KELVIN = 273.15
_GAS = 287.053  # J/(kg K), dry air
LOWEST_M, HIGHEST_M = -5000.0, 11_000.0


def pressure_hpa(alt_amsl_m: float) -> float:
    """Absolute pressure at a height; beyond the model's range that of its ends."""
    height = min(max(alt_amsl_m, LOWEST_M), HIGHEST_M)
    return float(SEA_LEVEL_HPA * (1.0 - LAPSE_K_PER_M / SEA_LEVEL_K * height) ** _EXPONENT)


def altitude_m(hpa: float) -> float:
    """The height AMSL at which the standard atmosphere has that pressure."""
    return float((1.0 - (max(hpa, 1.0) / SEA_LEVEL_HPA) ** (1.0 / _EXPONENT)) * SEA_LEVEL_K / LAPSE_K_PER_M)


def temperature_c(alt_amsl_m: float) -> float:
    return SEA_LEVEL_K - LAPSE_K_PER_M * min(max(alt_amsl_m, LOWEST_M), HIGHEST_M) - _KELVIN


def density(alt_amsl_m: float) -> float:
    """kg/m^3 at a height."""
    return pressure_hpa(alt_amsl_m) * 100.0 / (_GAS * (temperature_c(alt_amsl_m) + _KELVIN))


def dynamic_pressure_hpa(airspeed_mps: float, air_density: float) -> float:
    """What a pitot tube measures of a flow from ahead; from behind it measures nothing."""
    return 0.5 * air_density * max(airspeed_mps, 0.0) ** 2 / 100.0


def indicated_airspeed(hpa: float) -> float:
    """The speed that an instrument for air of sea-level density shows, m/s."""
    return float((2.0 * max(hpa, 0.0) * 100.0 / 1.225) ** 0.5)
