"""What the arming checks find with the sensors, and with the navigation filter that trusts or doubts them.

https://ardupilot.org/copter/docs/common-prearm-safety-checks.html
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

MAGFIELD_MG = 100.0  # the default of ARMING_MAGTHRESH


def sensor_faults(vehicle: ArduVehicle) -> list[str]:
    """In ArduPilot's order; empty where all is well."""
    belief = vehicle.filter.belief
    if belief is None or not (belief.troubled or belief.led):
        return []
    found = []
    if belief.baro_lost:
        found.append("Baro: not healthy")
    if belief.compass_lost:
        found.append("Compass not healthy")
    elif belief.field_difference_mg > MAGFIELD_MG:
        found.append(f"Check mag field (xy diff:{belief.field_difference_mg:.0f}>{MAGFIELD_MG:.0f})")
    if not belief.has_fix:
        found.append("GPS 1: Bad fix")
    if vehicle.mode.needs_position:
        found += _filter_faults(vehicle)
    return found


def _filter_faults(vehicle: ArduVehicle) -> list[str]:
    """In modes that need a position."""
    if vehicle.filter.glitching:
        return ["GPS glitching"]
    limit = vehicle.filter.threshold
    if limit > 0.0:
        for name in ("compass", "position", "velocity", "height"):
            if vehicle.filter.ratios[name] >= limit:
                return [f"EKF {name} variance"]
    return []
