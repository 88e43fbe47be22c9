"""What ArduCopter does when a failsafe or its fence trips.

https://ardupilot.org/copter/docs/failsafe-landing-page.html; what each says and does follows ArduCopter's events.
"""

from __future__ import annotations

from typing import ClassVar

from zmav.sim.autopilots.arducopter.base import CopterBase
from zmav.sim.autopilots.arducopter.modes import Land
from zmav.sim.autopilots.ardupilot.failsafe import announce
from zmav.sim.autopilots.ardupilot.fence import ALWAYS_LAND, BRAKE_OR_LAND, CEILING, GIVE_UP_M
from zmav.sim.autopilots.ardupilot.state import CRITICAL, DISARM, WARNING, Reactions, Steps

_STABILIZE, _ALT_HOLD, _RTL, _LAND, _BRAKE = 0, 2, 6, 9, 17
# FS_OPTIONS
RADIO_AUTO, GCS_AUTO, RADIO_GUIDED, LANDING, GCS_BY_PILOT = 1, 2, 4, 8, 16


# The numbers of BATT_FS_LOW_ACT and BATT_FS_CRT_ACT.
TO_LAND, TO_RTL = 1, 2
ACTIONS: dict[int, Steps] = {
    TO_LAND: (_LAND,),
    TO_RTL: (_RTL, _LAND),
    3: ("SmartRTL Unavailable, Trying RTL Mode", _RTL, _LAND),
    4: ("SmartRTL Unavailable, Using Land Mode", _LAND),
    5: (DISARM,),
    6: ("Trying RTL Mode", _RTL, _LAND),  # a landing of the mission
    7: (_BRAKE, "Trying Land Mode", _LAND),
}
FENCE_ACTIONS: dict[int, Steps] = {ALWAYS_LAND: (_LAND,), BRAKE_OR_LAND: (_BRAKE, _LAND), 5: (_LAND,)}
_BY_GCS = {1: 2, 2: 2, 3: 3, 4: 4, 5: 1, 6: 6, 7: 7}  # FS_GCS_ENABLE -> Action
_BY_THROTTLE = {1: 2, 2: 2, 3: 1, 4: 3, 5: 4, 6: 6, 7: 7}  # FS_THR_ENABLE -> Action
_LAND_URGENCY = 1


class CopterReactions(Reactions):
    """By the numbers and texts of ArduCopter."""

    BATTERY_URGENCY: ClassVar[tuple[int, ...]] = (5, 1, 2, 4, 3, 0)
    ACTIONS = ACTIONS

    def __init__(self, copter: CopterBase, land: Land) -> None:
        super().__init__(copter)
        self._copter, self._land = copter, land

    def gps_glitched(self, on: bool) -> None:
        self._copter.say(CRITICAL, "GPS Glitch or Compass error" if on else "Glitch cleared")

    def lane_switched(self, lane: int) -> None:
        self._copter.say(WARNING, f"EKF primary changed:{lane}")

    # ---- what trips

    def gcs_back(self) -> None:
        self._copter.say(WARNING, "GCS Failsafe Cleared")

    def gcs_lost(self) -> None:
        copter = self._copter
        if not copter.armed:
            announce(copter, "GCS")
        elif not self._goes_on(
            "GCS",
            (copter.mode is copter.auto and self._option(GCS_AUTO), "Continuing Auto Mode"),
            (copter.mode.by_pilot and self._option(GCS_BY_PILOT), "Continuing Pilot Control"),
        ):
            self.act(_BY_GCS.get(int(copter.params["FS_GCS_ENABLE"]), TO_RTL))

    def radio_changed(self, lost: bool) -> None:
        copter = self._copter
        if not lost:
            copter.say(WARNING, "Radio Failsafe Cleared")
        elif not self._goes_on(
            "Radio",
            (copter.mode is copter.auto and self._option(RADIO_AUTO), "Continuing Auto"),
            (copter.takes_targets and self._option(RADIO_GUIDED), "Continuing Guided Mode"),
        ):
            self.act(_BY_THROTTLE.get(int(copter.params["FS_THR_ENABLE"]), TO_LAND))

    def _goes_on(self, what: str, *exceptions: tuple[bool, str]) -> bool:
        """Announce a lost link; whether that is all, since it stands, lands already, or may go on as it is."""
        if self._stands(what) or self._goes_on_landing(what):
            return True
        text = next((text for holds, text in exceptions if holds), "")
        announce(self._copter, what, text)
        return bool(text)

    def battery_failed(self, action: int) -> None:
        copter = self._copter
        if self._stands("Battery"):
            return
        if copter.mode.is_landing and self._option(LANDING) and action:
            announce(copter, "Battery", "Continuing Landing")
            self.act(TO_LAND)
        else:
            announce(copter, "Battery")
            self.act(action)

    def estimate_lost(self) -> None:
        copter = self._copter
        if not copter.armed:
            return
        action = int(copter.params["FS_EKF_ACTION"])
        if action == 0 or (not copter.mode.needs_position and action != 3):
            copter.say(CRITICAL, "EKF Failsafe")
            return
        if action != 2 or copter.rc.lost or not copter.set_mode(_ALT_HOLD):
            self.act(TO_LAND)
        copter.say(CRITICAL, f"EKF Failsafe: changed to {copter.mode.name} Mode")

    def fence_breached(self, new: int, beyond_m: float) -> None:
        copter = self._copter
        action = int(copter.params["FENCE_ACTION"])
        thrown = copter.mode.manual_throttle and copter.rc.throttle < 0.02
        if copter.landed or (thrown and not copter.fence.breached & CEILING):
            copter.disarm(forced=True)
            return
        steps = (_LAND,) if beyond_m > GIVE_UP_M else FENCE_ACTIONS.get(action, (_RTL, _LAND))
        self.attempt(steps, by_fence=True)

    # ---- what is done

    def _option(self, bit: int) -> bool:
        return bool(int(self._copter.params["FS_OPTIONS"]) & bit)

    def _stands(self, what: str) -> bool:
        """On the ground a failsafe stops the motors."""
        copter = self._copter
        if copter.mode.number == _STABILIZE:
            stands = copter.rc.throttle < 0.02 or copter.landed
        else:
            stands = copter.landed and not (copter.mode is copter.auto and copter.auto_armed)
        if stands:
            announce(copter, what, "Disarming")
            copter.disarm(forced=True)
        return stands

    def enter(self, mode: int, *, by_fence: bool) -> bool:
        """Before a landing by itself the pilot has four seconds."""
        done = super().enter(mode, by_fence=by_fence)
        if done and mode == _LAND and not by_fence:
            self._land.pause()
        return done

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
        self.act(TO_LAND)
        return True
