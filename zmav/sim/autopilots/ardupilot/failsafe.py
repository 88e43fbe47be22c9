"""ArduPilot's failsafes: when the ground station, the battery or the position estimate is taken for lost. What is done
then is the kind of vehicle's: :mod:`.reactions`.

https://ardupilot.org/copter/docs/failsafe-landing-page.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.ekf import Ekf3
from zmav.sim.autopilots.ardupilot.radio import Radio
from zmav.sim.autopilots.ardupilot.state import CRITICAL, WARNING, VehicleState

_WATCH_GCS_S = 1.0 / 3.0


def announce(vehicle: VehicleState, what: str, done: str = "") -> None:
    vehicle.say(WARNING, f"{what} Failsafe - {done}" if done else f"{what} Failsafe")


class GcsFailsafe:
    """Watches for the ground station (MAV_GCS_SYSID) once it was heard; off unless FS_GCS_ENABLE says so.

    Only the system id counts, whatever component it is: heartbeats, RC_CHANNELS_OVERRIDE and MANUAL_CONTROL.
    """

    def __init__(self, vehicle: VehicleState, rc: Radio, *, acts: bool = True) -> None:
        """``acts``: it does something by itself, and is not only asked."""
        self._vehicle, self._rc, self._acts = vehicle, rc, acts
        self._heard: float | None = None
        self._next = vehicle.now
        self.active = False

    def heard(self, sysid: int) -> None:
        """Something that keeps it quiet arrived from ``sysid``; anybody's but the ground station's does not count."""
        if sysid == int(self._vehicle.params["MAV_GCS_SYSID"]):
            self._heard = self._vehicle.now

    @property
    def silent(self) -> bool:
        """It was heard once, and is not any more."""
        timeout = self._vehicle.params[self._vehicle.GCS_PARAMS[1]]
        return self._heard is not None and self._vehicle.now - self._heard > timeout

    def update(self) -> None:
        vehicle = self._vehicle
        if vehicle.now < self._next or not self._acts:
            return
        self._next = vehicle.now + _WATCH_GCS_S
        if vehicle.params[vehicle.GCS_PARAMS[0]] == 0 or self._heard is None or self.silent is self.active:
            return
        self.active = not self.active
        if self.active:
            self._rc.clear_overrides()
            vehicle.reactions.gcs_lost()
        else:
            vehicle.reactions.gcs_back()


class BatteryFailsafe:
    """Low and critical: voltage for BATT_LOW_TIMER seconds, or capacity left; each acts once, until a reboot."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self._level = 0
        self._since: dict[str, float] = {}
        self.urgency = len(vehicle.reactions.BATTERY_URGENCY)

    @property
    def failed(self) -> bool:
        return self._level > 0

    def faults(self) -> list[str]:
        """Why arming is refused for the battery's sake."""
        params = self._vehicle.params
        checks = [
            (0 < self._vehicle.voltage < params["BATT_ARM_VOLT"], "below minimum arming voltage"),
            (params["BATT_ARM_MAH"] > 0 and self._left < params["BATT_ARM_MAH"], "below minimum arming capacity"),
        ]
        for level, word in (("LOW", "low"), ("CRT", "critical")):
            checks.append((self._low_voltage(level), f"{word} voltage failsafe"))
            checks.append((self._low_capacity(level), f"{word} capacity failsafe"))
        for kind, word in (("VOLT", "voltage"), ("MAH", "capacity")):
            low, critical = params[f"BATT_LOW_{kind}"], params[f"BATT_CRT_{kind}"]
            checks.append((0 < low <= critical, f"{word} failsafe critical >= low"))
        found = [f"Battery 1 {text}" for failed, text in checks if failed][:1]
        return [*found, "Battery failsafe"] if self.failed else found

    @property
    def _left(self) -> float:
        return self._vehicle.params["BATT_CAPACITY"] - self._vehicle.consumed_mah

    def _low_voltage(self, level: str) -> bool:
        return 0 < self._vehicle.voltage < self._vehicle.params[f"BATT_{level}_VOLT"]

    def _low_capacity(self, level: str) -> bool:
        least = self._vehicle.params[f"BATT_{level}_MAH"]
        return least > 0 and self._left < least

    def _lasting(self, level: str) -> bool:
        if not self._low_voltage(level):
            self._since.pop(level, None)
            return False
        since = self._since.setdefault(level, self._vehicle.now)
        timer = self._vehicle.params["BATT_LOW_TIMER"]
        return timer > 0 and self._vehicle.now - since > timer

    def update(self) -> None:
        vehicle = self._vehicle
        if not vehicle.armed:
            return
        critical = self._lasting("CRT") or self._low_capacity("CRT")
        low = self._lasting("LOW") or self._low_capacity("LOW")
        level = 2 if critical else 1 if low else 0
        if level <= self._level:
            return
        self._level = level
        word, name = ("critical", "CRT") if critical else ("low", "LOW")
        volts, used = vehicle.voltage, vehicle.consumed_mah
        vehicle.say(WARNING, f"Battery 1 is {word} {volts:.2f}V used {used:.0f} mAh")
        action = int(vehicle.params[f"BATT_FS_{name}_ACT"])
        order = vehicle.reactions.BATTERY_URGENCY
        urgency = order.index(action) if action in order else len(order)
        if urgency <= self.urgency:
            self.urgency = urgency
            vehicle.reactions.battery_failed(action)


class EkfFailsafe:
    """The position estimate is gone, or doubted on several sides, for a second, after there was a good one
    (FS_EKF_THRESH, FS_EKF_ACTION).
    """

    ITERATIONS = 10
    SAID_EVERY_S = 30.0

    def __init__(self, vehicle: VehicleState, navigation: Ekf3) -> None:
        self._vehicle, self._filter = vehicle, navigation
        self._count = 0
        self._ever = False
        self._said = -math.inf
        self.active = False

    def update(self) -> None:
        """Ten times a second."""
        vehicle = self._vehicle
        good = vehicle.position_ok and not self._filter.beyond
        self._ever |= good
        if not self._ever or vehicle.params["FS_EKF_THRESH"] <= 0:
            self._count, self.active = 0, False
        elif not good:
            if not self.active:
                self._count += 1
                if self._count >= self.ITERATIONS:
                    self.active = True
                    if vehicle.now - self._said > self.SAID_EVERY_S:
                        self._said = vehicle.now
                        vehicle.say(CRITICAL, "EKF variance")
                    vehicle.reactions.estimate_lost()
        elif self._count > 0:
            self._count -= 1
            if self.active and self._count == 0:
                self.active = False
                vehicle.say(CRITICAL, "EKF Failsafe Cleared")
