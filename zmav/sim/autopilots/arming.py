"""When an ArduCopter arms and when it does not, and in which words it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter import ArduCopter


def mandatory_faults(copter: ArduCopter) -> list[str]:
    """What even a forced arming is refused for."""
    boot = copter.boot
    if not boot.has("initialised"):
        return ["System not initialised"]
    if not boot.has("aligned"):
        return ["AHRS: EKF3 not healthy"]
    if copter.mode.needs_position and not copter.position_ok:
        return ["AHRS: waiting for home" if not boot.has("origin") else "Need Position Estimate"]
    return []


def prearm_faults(copter: ArduCopter) -> list[str]:
    """What the checks that always run find, in the mode it is in; empty: the pre-arm bit of SYS_STATUS is set."""
    faults = mandatory_faults(copter)
    if not faults and not copter.boot.has("prearm"):
        faults = ["AHRS not healthy"]
    return faults


def arming_faults(copter: ArduCopter, *, forced: bool) -> list[str]:
    """Why this vehicle does not arm now on the ground station's word; empty: it does."""
    faults = mandatory_faults(copter) if forced else prearm_faults(copter)
    if faults or forced:
        return faults
    if not copter.mode.armable:
        return [f"{copter.mode.name} mode not armable"]
    if copter.mode is not copter.guided and copter.pilot.throttle > copter.mode.throttle_to_arm:
        return ["Throttle too high"]
    return []
