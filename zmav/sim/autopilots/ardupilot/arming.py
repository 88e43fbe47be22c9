"""When an ArduCopter arms and when it does not, and in which words it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter


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
    if not faults and not copter.armed:
        faults = _state_faults(copter)
    return faults


def _state_faults(copter: ArduCopter) -> list[str]:
    """What failsafes, fence, battery, radio and mission have against it; all of them, in ArduCopter's order."""
    params, found = copter.params, []
    if not int(params["ARMING_CHECK"]):
        return []
    if copter.gcs.active:
        found.append("GCS failsafe on")
    if params["FS_THR_ENABLE"] and copter.rc.pwm[2] < params["FS_THR_VALUE"]:
        found.append("Throttle below failsafe")
    found += copter.battery.faults()
    if copter.rc.lost:
        found.append("Radio failsafe on")
    if copter.mode is copter.auto and not copter.mission.present:
        found.append("Mode requires mission")
    fence = copter.fence.fault()
    return [*found, fence] if fence else found


def arming_faults(copter: ArduCopter, *, forced: bool) -> list[str]:
    """Why this vehicle does not arm now on the ground station's word; empty: it does."""
    faults = mandatory_faults(copter) if forced else prearm_faults(copter)
    if faults or forced:
        return faults
    if not copter.mode.allows_arming():
        return [f"{copter.mode.name} mode not armable"]
    with_throttle = copter.mode in (copter.guided, copter.auto)
    if not with_throttle and copter.rc.throttle > copter.mode.throttle_to_arm:
        return ["Throttle too high"]
    return _stick_faults(copter)


def _stick_faults(copter: ArduCopter) -> list[str]:
    """Sticks that are not in the middle, where the radio is heard."""
    if not copter.rc.valid or not int(copter.params["ARMING_CHECK"]):
        return []
    sticks = (("Roll", 1, copter.rc.roll), ("Pitch", 2, copter.rc.pitch), ("Yaw", 4, copter.rc.yaw))
    return [f"{name} (RC{channel}) is not neutral" for name, channel, value in sticks if value != 0.0]
