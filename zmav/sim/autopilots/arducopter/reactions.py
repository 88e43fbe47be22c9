"""What ArduCopter does when a failsafe or its fence trips.

https://ardupilot.org/copter/docs/failsafe-landing-page.html; what each says and does follows ArduCopter's events.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots.ardupilot.failsafe import announce
from zmav.sim.autopilots.ardupilot.fence import ALWAYS_LAND, BRAKE_OR_LAND, CEILING, GIVE_UP_M
from zmav.sim.autopilots.ardupilot.reactions import DISARM, Reactions, Steps

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

_STABILIZE, _ALT_HOLD, _RTL, _LAND, _BRAKE = 0, 2, 6, 9, 17
_CRITICAL, _WARNING = 2, 4
# FS_OPTIONS
RADIO_AUTO, GCS_AUTO, RADIO_GUIDED, LANDING, GCS_BY_PILOT = 1, 2, 4, 8, 16


# The numbers of BATT_FS_LOW_ACT and BATT_FS_CRT_ACT.
LAND, RTL = 1, 2
ACTIONS: dict[int, Steps] = {
    LAND: (_LAND,),
    RTL: (_RTL, _LAND),
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

    def __init__(self, copter: ArduCopter) -> None:
        super().__init__(copter)
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
            self.act(_BY_GCS.get(int(copter.params["FS_GCS_ENABLE"]), RTL))

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
            self.act(_BY_THROTTLE.get(int(copter.params["FS_THR_ENABLE"]), LAND))

    def battery_failed(self, action: int) -> None:
        copter = self._copter
        if self._disarms():
            copter.disarm(forced=True)
            announce(copter, "Battery", "Disarming")
        elif copter.mode.is_landing and self._option(LANDING) and action:
            announce(copter, "Battery", "Continuing Landing")
            self.act(LAND)
        else:
            announce(copter, "Battery")
            self.act(action)

    def estimate_lost(self) -> None:
        copter = self._copter
        if not copter.armed:
            return
        action = int(copter.params["FS_EKF_ACTION"])
        if action == 0 or (not copter.mode.needs_position and action != 3):
            copter.say(_CRITICAL, "EKF Failsafe")
            return
        if action != 2 or copter.rc.lost or not copter.set_mode(_ALT_HOLD):
            self.act(LAND)
        copter.say(_CRITICAL, f"EKF Failsafe: changed to {copter.mode.name} Mode")

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

    def _disarms(self) -> bool:
        """On the ground a failsafe stops the motors."""
        copter = self._copter
        if copter.mode.number == _STABILIZE:
            return copter.rc.throttle < 0.02 or copter.landed
        if copter.mode is copter.auto:
            return not copter.auto_armed and copter.landed
        return copter.landed

    def enter(self, mode: int, *, by_fence: bool) -> bool:
        """Before a landing by itself the pilot has four seconds."""
        done = super().enter(mode, by_fence=by_fence)
        if done and mode == _LAND and not by_fence:
            self._copter.land.pause()
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
        self.act(LAND)
        return True
