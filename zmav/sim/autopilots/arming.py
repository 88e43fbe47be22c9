"""When an ArduCopter arms and when it does not, and in which words it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter import ArduCopter


def prearm_faults(copter: ArduCopter) -> list[str]:
    """What the checks that always run would refuse arming for; empty: the pre-arm bit of SYS_STATUS is set."""
    boot = copter.boot
    if not boot.has("initialised"):
        return ["System not initialised"]
    faults = []
    if not boot.has("aligned"):
        faults.append("AHRS: not using configured AHRS type")
    if not boot.has("origin"):
        faults.append("AHRS: waiting for home")
    elif not boot.has("prearm"):
        faults.append("Gyros inconsistent")
    if copter.pilot.throttle > 0.1 and not copter.mode.by_pilot:
        faults.append("Throttle too high")
    return faults


def arming_faults(copter: ArduCopter) -> list[str]:
    """Why this vehicle does not arm now, in its current mode; empty: it does."""
    if not copter.mode.armable:
        return ["Mode not armable"]
    faults = prearm_faults(copter)
    if faults:
        return faults
    if copter.mode.needs_position and not copter.position_ok:
        return ["Need Position Estimate"]
    return []
