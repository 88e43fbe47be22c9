"""What ArduCopter does when a failsafe or its fence trips.

https://ardupilot.org/copter/docs/failsafe-landing-page.html; what each says and does follows ArduCopter's events.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots.ardupilot.failsafe import announce
from zmav.sim.autopilots.ardupilot.fence import ALWAYS_LAND, BRAKE_OR_LAND, CEILING, GIVE_UP_M
from zmav.sim.autopilots.ardupilot.reactions import Reactions

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

_STABILIZE, _ALT_HOLD, _RTL, _LAND, _BRAKE = 0, 2, 6, 9, 17
_CRITICAL, _WARNING = 2, 4
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
_LAND_URGENCY = 1


class CopterReactions(Reactions):
    """By the numbers and texts of ArduCopter."""

    BATTERY_URGENCY: ClassVar[tuple[int, ...]] = (5, 1, 2, 4, 3, 0)

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter

    def gps_glitched(self, on: bool) -> None:
        self._copter.say(_CRITICAL, "GPS Glitch or Compass error" if on else "Glitch cleared")

    def lane_switched(self, lane: int) -> None:
        self._copter.say(_WARNING, f"EKF primary changed:{lane}")

    # ---- what trips

    def gcs_back(self) -> None:
        self._copter.say(_WARNING, "GCS Failsafe Cleared")

    def gcs_lost(self) -> None:
        copter = self._copter
        if not copter.armed:
            announce(copter, "GCS")
        elif self._disarms():
            copter.disarm(forced=True)
            announce(copter, "GCS", "Disarming")
        elif self._goes_on_landing("GCS"):
            pass
        elif copter.mode is copter.auto and self._option(GCS_AUTO):
            announce(copter, "GCS", "Continuing Auto Mode")
        elif copter.mode.by_pilot and self._option(GCS_BY_PILOT):
            announce(copter, "GCS", "Continuing Pilot Control")
        else:
            announce(copter, "GCS")
            self._act(_BY_GCS.get(int(copter.params["FS_GCS_ENABLE"]), Action.RTL))

    def radio_changed(self, lost: bool) -> None:
        copter = self._copter
        if not lost:
            copter.say(_WARNING, "Radio Failsafe Cleared")
        elif self._disarms():
            announce(copter, "Radio", "Disarming")
            copter.disarm(forced=True)
        elif self._goes_on_landing("Radio"):
            pass
        elif copter.mode is copter.auto and self._option(RADIO_AUTO):
            announce(copter, "Radio", "Continuing Auto")
        elif copter.takes_targets and self._option(RADIO_GUIDED):
            announce(copter, "Radio", "Continuing Guided Mode")
        else:
            announce(copter, "Radio")
            self._act(_BY_THROTTLE.get(int(copter.params["FS_THR_ENABLE"]), Action.LAND))

    def battery_failed(self, action: int) -> None:
        copter = self._copter
        if self._disarms():
            copter.disarm(forced=True)
            announce(copter, "Battery", "Disarming")
        elif copter.mode.is_landing and self._option(LANDING) and action != Action.NONE:
            announce(copter, "Battery", "Continuing Landing")
            self._act(Action.LAND)
        else:
            announce(copter, "Battery")
            self._act(action)

    def estimate_lost(self) -> None:
        copter = self._copter
        if not copter.armed:
            return
        action = int(copter.params["FS_EKF_ACTION"])
        if action == 0 or (not copter.mode.needs_position and action != 3):
            copter.say(_CRITICAL, "EKF Failsafe")
            return
        if action != 2 or copter.rc.lost or not copter.set_mode(_ALT_HOLD):
            self._land_with_pause()
        copter.say(_CRITICAL, f"EKF Failsafe: changed to {copter.mode.name} Mode")

    def fence_breached(self, new: int, beyond_m: float) -> None:
        copter = self._copter
        action = int(copter.params["FENCE_ACTION"])
        thrown = copter.mode.manual_throttle and copter.rc.throttle < 0.02
        if copter.landed or (thrown and not copter.fence.breached & CEILING):
            copter.disarm(forced=True)
            return
        if beyond_m > GIVE_UP_M or action in (ALWAYS_LAND, 5):  # 5: by its own way, or land
            tries: tuple[int, ...] = (_LAND,)
        elif action == BRAKE_OR_LAND:
            tries = (_BRAKE, _LAND)
        else:
            tries = (_RTL, _LAND)
        for number in tries:
            if copter.set_mode(number, by_fence=True):
                return

    # ---- what is done

    def _option(self, bit: int) -> bool:
        return bool(int(self._copter.params["FS_OPTIONS"]) & bit)

    def _disarms(self) -> bool:
        """On the ground a failsafe stops the motors."""
        copter = self._copter
        if copter.mode.number == _STABILIZE:
            return copter.rc.throttle < 0.02 or copter.landed
        if copter.mode is copter.auto:
            return not copter.auto_armed and copter.landed
        return copter.landed

    def _act(self, action: int) -> None:
        """Carry out an :class:`Action`."""
        copter = self._copter
        if action == Action.LAND:
            self._land_with_pause()
        elif action == Action.RTL:
            self._return_or_land()
        elif action == Action.SMART_RTL:
            copter.say(_WARNING, "SmartRTL Unavailable, Trying RTL Mode")
            self._return_or_land()
        elif action == Action.SMART_RTL_OR_LAND:
            copter.say(_WARNING, "SmartRTL Unavailable, Using Land Mode")
            self._land_with_pause()
        elif action == Action.TERMINATE:
            copter.disarm(forced=True)
        elif action == Action.LAND_START:
            copter.say(_WARNING, "Trying RTL Mode")
            self._return_or_land()
        elif action == Action.BRAKE_OR_LAND and not copter.set_mode(_BRAKE):
            copter.say(_WARNING, "Trying Land Mode")
            self._land_with_pause()

    def _land_with_pause(self) -> None:
        """LAND, and four seconds for the pilot before it goes down."""
        if self._copter.set_mode(_LAND):
            self._copter.land.pause()

    def _return_or_land(self) -> None:
        if not self._copter.set_mode(_RTL):
            self._land_with_pause()

    def _goes_on_landing(self, what: str) -> bool:
        """A landing under way is not broken off; says so and sees that it is LAND."""
        copter = self._copter
        if not copter.mode.is_landing:
            return False
        if copter.battery.failed and copter.battery.urgency <= _LAND_URGENCY:
            announce(copter, f"{what} + Battery", "Continuing Landing")
        elif self._option(LANDING):
            announce(copter, what, "Continuing Landing")
        else:
            return False
        self._act(Action.LAND)
        return True
