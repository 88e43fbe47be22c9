"""ArduCopter's failsafes: ground station, radio, battery and position estimate.

https://ardupilot.org/copter/docs/failsafe-landing-page.html; what each says and does follows ArduCopter's events.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

_STABILIZE, _ALT_HOLD, _RTL, _LAND, _BRAKE = 0, 2, 6, 9, 17
_CRITICAL, _WARNING = 2, 4
_WATCH_GCS_S = 1.0 / 3.0
# FS_OPTIONS
RADIO_AUTO, GCS_AUTO, RADIO_GUIDED, LANDING, GCS_BY_PILOT = 1, 2, 4, 8, 16


class Action(enum.IntEnum):
    """What to do; the numbers of BATT_FS_LOW_ACT and BATT_FS_CRT_ACT."""

    NONE = 0
    LAND = 1
    RTL = 2
    SMART_RTL = 3
    SMART_RTL_OR_LAND = 4
    TERMINATE = 5
    LAND_START = 6
    BRAKE_OR_LAND = 7


_BY_GCS = {1: 2, 2: 2, 3: 3, 4: 4, 5: 1, 6: 6, 7: 7}  # FS_GCS_ENABLE -> Action
_BY_THROTTLE = {1: 2, 2: 2, 3: 1, 4: 3, 5: 4, 6: 6, 7: 7}  # FS_THR_ENABLE -> Action
_MOST_URGENT_FIRST = (5, 1, 2, 4, 3, 0)  # which battery failsafe gives way to which
_LAND_URGENCY = 1


def option(copter: ArduCopter, bit: int) -> bool:
    return bool(int(copter.params["FS_OPTIONS"]) & bit)


def announce(copter: ArduCopter, what: str, done: str = "") -> None:
    copter.say(_WARNING, f"{what} Failsafe - {done}" if done else f"{what} Failsafe")


def disarms(copter: ArduCopter) -> bool:
    """On the ground a failsafe stops the motors."""
    if copter.mode.number == _STABILIZE:
        return copter.rc.throttle < 0.02 or copter.landed
    if copter.mode is copter.auto:
        return not copter.auto_armed and copter.landed
    return copter.landed


def act(copter: ArduCopter, action: int) -> None:
    """Carry out an :class:`Action`. Where SMART_RTL is meant, its stand-ins do its work: there is none here."""
    if action == Action.LAND:
        land_with_pause(copter)
    elif action == Action.RTL:
        _return_or_land(copter)
    elif action == Action.SMART_RTL:
        copter.say(_WARNING, "SmartRTL Unavailable, Trying RTL Mode")
        _return_or_land(copter)
    elif action == Action.SMART_RTL_OR_LAND:
        copter.say(_WARNING, "SmartRTL Unavailable, Using Land Mode")
        land_with_pause(copter)
    elif action == Action.TERMINATE:
        copter.disarm(forced=True)
    elif action == Action.LAND_START:
        copter.say(_WARNING, "Trying RTL Mode")
        _return_or_land(copter)
    elif action == Action.BRAKE_OR_LAND and not copter.set_mode(_BRAKE):
        copter.say(_WARNING, "Trying Land Mode")
        land_with_pause(copter)


def land_with_pause(copter: ArduCopter) -> None:
    """LAND, and four seconds for the pilot before it goes down."""
    if copter.set_mode(_LAND):
        copter.land.pause()


def _return_or_land(copter: ArduCopter) -> None:
    if not copter.set_mode(_RTL):
        land_with_pause(copter)


def _goes_on_landing(copter: ArduCopter, what: str) -> bool:
    """A landing under way is not broken off; says so and sees that it is LAND."""
    if not copter.mode.is_landing:
        return False
    if copter.battery.failed and copter.battery.urgency <= _LAND_URGENCY:
        announce(copter, f"{what} + Battery", "Continuing Landing")
    elif option(copter, LANDING):
        announce(copter, what, "Continuing Landing")
    else:
        return False
    act(copter, Action.LAND)
    return True


class GcsFailsafe:
    """Watches for the ground station (MAV_GCS_SYSID) once it was heard; off unless FS_GCS_ENABLE says so.

    Only the system id counts, whatever component it is: heartbeats, RC_CHANNELS_OVERRIDE and MANUAL_CONTROL.
    """

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self._heard: float | None = None
        self._next = copter.now
        self.active = False

    def heard(self, sysid: int) -> None:
        """Something that keeps it quiet arrived from ``sysid``; anybody's but the ground station's does not count."""
        if sysid == int(self._copter.params["MAV_GCS_SYSID"]):
            self._heard = self._copter.now

    def update(self) -> None:
        copter = self._copter
        if copter.now < self._next:
            return
        self._next = copter.now + _WATCH_GCS_S
        if copter.params["FS_GCS_ENABLE"] == 0 or self._heard is None:
            return
        silent = copter.now - self._heard > copter.params["FS_GCS_TIMEOUT"]
        if silent and not self.active:
            self.active = True
            self._begin()
        elif self.active and not silent:
            self.active = False
            copter.say(_WARNING, "GCS Failsafe Cleared")

    def _begin(self) -> None:
        copter = self._copter
        copter.rc.clear_overrides()
        if not copter.armed:
            announce(copter, "GCS")
        elif disarms(copter):
            copter.disarm(forced=True)
            announce(copter, "GCS", "Disarming")
        elif _goes_on_landing(copter, "GCS"):
            pass
        elif copter.mode is copter.auto and option(copter, GCS_AUTO):
            announce(copter, "GCS", "Continuing Auto Mode")
        elif copter.mode.by_pilot and option(copter, GCS_BY_PILOT):
            announce(copter, "GCS", "Continuing Pilot Control")
        else:
            announce(copter, "GCS")
            act(copter, _BY_GCS.get(int(copter.params["FS_GCS_ENABLE"]), Action.RTL))


class RadioFailsafe:
    """The pilot's radio is lost, or its throttle is below FS_THR_VALUE (FS_THR_ENABLE)."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter

    def changed(self, lost: bool) -> None:
        copter = self._copter
        if not lost:
            copter.say(_WARNING, "Radio Failsafe Cleared")
        elif disarms(copter):
            announce(copter, "Radio", "Disarming")
            copter.disarm(forced=True)
        elif _goes_on_landing(copter, "Radio"):
            pass
        elif copter.mode is copter.auto and option(copter, RADIO_AUTO):
            announce(copter, "Radio", "Continuing Auto")
        elif copter.takes_targets and option(copter, RADIO_GUIDED):
            announce(copter, "Radio", "Continuing Guided Mode")
        else:
            announce(copter, "Radio")
            act(copter, _BY_THROTTLE.get(int(copter.params["FS_THR_ENABLE"]), Action.LAND))


class BatteryFailsafe:
    """Low and critical: voltage for BATT_LOW_TIMER seconds, or capacity left; each acts once, until a reboot."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self._level = 0
        self._since: dict[str, float] = {}
        self.urgency = len(_MOST_URGENT_FIRST)

    @property
    def failed(self) -> bool:
        return self._level > 0

    def faults(self) -> list[str]:
        """Why arming is refused for the battery's sake."""
        params = self._copter.params
        checks = (
            (0 < self._copter.voltage < params["BATT_ARM_VOLT"], "below minimum arming voltage"),
            (params["BATT_ARM_MAH"] > 0 and self._left < params["BATT_ARM_MAH"], "below minimum arming capacity"),
            (self._low_voltage("LOW"), "low voltage failsafe"),
            (self._low_capacity("LOW"), "low capacity failsafe"),
            (self._low_voltage("CRT"), "critical voltage failsafe"),
            (self._low_capacity("CRT"), "critical capacity failsafe"),
            (0 < params["BATT_LOW_MAH"] <= params["BATT_CRT_MAH"], "capacity failsafe critical >= low"),
            (0 < params["BATT_LOW_VOLT"] <= params["BATT_CRT_VOLT"], "voltage failsafe critical >= low"),
        )
        found = next((f"Battery 1 {text}" for failed, text in checks if failed), "")
        return [each for each in (found, "Battery failsafe" if self.failed else "") if each]

    @property
    def _left(self) -> float:
        return self._copter.params["BATT_CAPACITY"] - self._copter.consumed_mah

    def _low_voltage(self, level: str) -> bool:
        return 0 < self._copter.voltage < self._copter.params[f"BATT_{level}_VOLT"]

    def _low_capacity(self, level: str) -> bool:
        least = self._copter.params[f"BATT_{level}_MAH"]
        return least > 0 and self._left < least

    def _lasting(self, level: str) -> bool:
        if not self._low_voltage(level):
            self._since.pop(level, None)
            return False
        since = self._since.setdefault(level, self._copter.now)
        timer = self._copter.params["BATT_LOW_TIMER"]
        return timer > 0 and self._copter.now - since > timer

    def update(self) -> None:
        copter = self._copter
        if not copter.armed:
            return
        critical = self._lasting("CRT") or self._low_capacity("CRT")
        low = self._lasting("LOW") or self._low_capacity("LOW")
        level = 2 if critical else 1 if low else 0
        if level <= self._level:
            return
        self._level = level
        word, name = ("critical", "CRT") if critical else ("low", "LOW")
        volts, used = copter.voltage, copter.consumed_mah
        copter.say(_WARNING, f"Battery 1 is {word} {volts:.2f}V used {used:.0f} mAh")
        action = int(copter.params[f"BATT_FS_{name}_ACT"])
        known = action in _MOST_URGENT_FIRST
        urgency = _MOST_URGENT_FIRST.index(action) if known else len(_MOST_URGENT_FIRST)
        if urgency <= self.urgency:
            self.urgency = urgency
            self._begin(action)

    def _begin(self, action: int) -> None:
        copter = self._copter
        if disarms(copter):
            copter.disarm(forced=True)
            announce(copter, "Battery", "Disarming")
        elif copter.mode.is_landing and option(copter, LANDING) and action != Action.NONE:
            announce(copter, "Battery", "Continuing Landing")
            act(copter, Action.LAND)
        else:
            announce(copter, "Battery")
            act(copter, action)


class EkfFailsafe:
    """The position estimate is gone for a second, after there was one (FS_EKF_ACTION)."""

    ITERATIONS = 10

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self._count = 0
        self._ever = False
        self.active = False

    def update(self) -> None:
        """Ten times a second."""
        copter = self._copter
        good = copter.position_ok
        self._ever |= good
        if not self._ever or copter.params["FS_EKF_THRESH"] <= 0:
            self._count, self.active = 0, False
        elif not good:
            if not self.active:
                self._count += 1
                if self._count >= self.ITERATIONS:
                    self.active = True
                    copter.say(_CRITICAL, "EKF variance")
                    self._begin()
        elif self._count > 0:
            self._count -= 1
            if self.active and self._count == 0:
                self.active = False
                copter.say(_CRITICAL, "EKF Failsafe Cleared")

    def _begin(self) -> None:
        copter = self._copter
        if not copter.armed:
            return
        action = int(copter.params["FS_EKF_ACTION"])
        if action == 0 or (not copter.mode.needs_position and action != 3):
            copter.say(_CRITICAL, "EKF Failsafe")
            return
        if action != 2 or copter.rc.lost or not copter.set_mode(_ALT_HOLD):
            land_with_pause(copter)
        copter.say(_CRITICAL, f"EKF Failsafe: changed to {copter.mode.name} Mode")
