"""When an ArduPilot arms and when it does not, and in which words it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zmav.sim.autopilots.ardupilot.sensorchecks import sensor_faults

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle


def mandatory_faults(vehicle: ArduVehicle) -> list[str]:
    """What even a forced arming is refused for."""
    boot = vehicle.boot
    if not boot.has("initialised"):
        return ["System not initialised"]
    if not boot.has("aligned"):
        return ["AHRS: EKF3 not healthy"]
    if vehicle.mode.needs_position and not vehicle.position_ok:
        return ["AHRS: waiting for home" if not boot.has("origin") else "Need Position Estimate"]
    return []


def prearm_faults(vehicle: ArduVehicle) -> list[str]:
    """What the checks that always run find, in the mode it is in; empty: the pre-arm bit of SYS_STATUS is set."""
    faults = vehicle.waking_faults()
    if not faults and not vehicle.armed:
        faults = _state_faults(vehicle)
    return faults


def _state_faults(vehicle: ArduVehicle) -> list[str]:
    """What failsafes, fence, battery, radio and mission have against it; all of them, in ArduPilot's order."""
    params, found = vehicle.params, []
    if not int(params["ARMING_CHECK"]):
        return []
    if vehicle.gcs.active:
        found.append("GCS failsafe on")
    enabled, lowest = vehicle.RADIO_PARAMS
    if params[enabled] and vehicle.rc.pwm[2] < params[lowest]:
        found.append("Throttle below failsafe")
    found += sensor_faults(vehicle)
    found += vehicle.battery.faults()
    if vehicle.rc.lost:
        found.append("Radio failsafe on")
    if vehicle.mode is vehicle.auto and not vehicle.mission.present:
        found.append("Mode requires mission")
    fence = vehicle.fence.fault()
    return [*found, fence] if fence else found


def arming_faults(vehicle: ArduVehicle, *, forced: bool) -> list[str]:
    """Why this vehicle does not arm now on the ground station's word; empty: it does."""
    faults = mandatory_faults(vehicle) if forced else prearm_faults(vehicle)
    if faults or forced:
        return faults
    if not vehicle.mode.allows_arming():
        return [f"{vehicle.mode.name} mode not armable"]
    with_throttle = vehicle.mode in (vehicle.guided, vehicle.auto)
    if not with_throttle and vehicle.rc.throttle > vehicle.mode.throttle_to_arm:
        return ["Throttle too high"]
    return _stick_faults(vehicle)


def _stick_faults(vehicle: ArduVehicle) -> list[str]:
    """Sticks that are not in the middle, where the radio is heard."""
    if not vehicle.rc.valid or not int(vehicle.params["ARMING_CHECK"]):
        return []
    sticks = (("Roll", 1, vehicle.rc.roll), ("Pitch", 2, vehicle.rc.pitch), ("Yaw", 4, vehicle.rc.yaw))
    return [f"{name} (RC{channel}) is not neutral" for name, channel, value in sticks if value != 0.0]
