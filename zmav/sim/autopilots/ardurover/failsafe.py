"""ArduRover's failsafes: when the radio and the ground station are taken for lost, and what it does then, about a low
battery, a lost position and a fence.

https://ardupilot.org/rover/docs/rover-failsafes.html
"""

from __future__ import annotations

from typing import ClassVar

from zmav.sim.autopilots.ardupilot.fence import GIVE_UP_M
from zmav.sim.autopilots.ardupilot.state import CRITICAL, DISARM, INFO, WARNING, Reactions, Steps
from zmav.sim.autopilots.ardurover.base import RoverBase

RADIO, GCS = 1, 2  # what fails
NO_PULSES_S = 0.5
CONTINUE_MISSION = 2  # FS_THR_ENABLE, FS_GCS_ENABLE
ACTIVE_IN_HOLD = 1  # FS_OPTIONS
_HOLD, _LOITER, _RTL = 4, 5, 11


# FS_ACTION, FENCE_ACTION, BATT_FS_LOW_ACT and BATT_FS_CRT_ACT. 3 and 4 ask for SMART_RTL first.
RTL, HOLD, TERMINATE = 1, 2, 5
ACTIONS: dict[int, Steps] = {
    RTL: (_RTL, _HOLD),
    HOLD: (_HOLD,),
    3: (_RTL, _HOLD),
    4: (_HOLD,),
    TERMINATE: (DISARM,),
    6: (_LOITER, _HOLD),
}


class RoverReactions(Reactions):
    """What it does; and of radio and ground station when: what fails for FS_TIMEOUT seconds triggers FS_ACTION, once
    until all is well.

    Whichever of the two is looked at first after that time gives the failsafe its name, as in ArduRover: the radio is
    looked at five times as often.
    """

    BATTERY_URGENCY: ClassVar[tuple[int, ...]] = (TERMINATE, HOLD, RTL, 3, 4, 0)
    ACTIONS = ACTIONS

    def __init__(self, rover: RoverBase) -> None:
        super().__init__(rover)
        self._rover = rover
        self.reset()

    def reset(self) -> None:
        """After a reboot."""
        self._bits = 0
        self._since = 0.0
        self.triggered = 0

    def estimate_lost(self) -> None:
        """FS_EKF_ACTION: 1 holds, 2 says it only."""
        rover, action = self._rover, int(self._rover.params["FS_EKF_ACTION"])
        if not rover.mode.needs_position or action == 0:
            return
        if action != 2:
            rover.set_mode(_HOLD)
        rover.say(CRITICAL, "EKF failsafe")

    def fence_breached(self, new: int, beyond_m: float) -> None:
        rover = self._rover
        if rover.armed:
            action = int(rover.params["FENCE_ACTION"]) if beyond_m <= GIVE_UP_M else HOLD
            self.attempt(self.ACTIONS.get(action, ()), by_fence=True)

    @property
    def no_radio(self) -> bool:
        """The sticks mean nothing."""
        return bool(self._bits & RADIO)

    def watch_radio(self) -> None:
        """Fifty times a second."""
        rover = self._rover
        if rover.params["FS_THR_ENABLE"]:
            low = rover.rc.pwm[2] < rover.params["FS_THR_VALUE"]
            self._note(RADIO, "Radio", low or rover.rc.silent_s > NO_PULSES_S)

    def watch_gcs(self) -> None:
        """Ten times a second."""
        if self._rover.params["FS_GCS_ENABLE"]:
            self._note(GCS, "GCS", self._rover.gcs.silent)

    def _note(self, kind: int, name: str, failed: bool) -> None:
        rover, before = self._rover, self._bits
        self._bits = before | kind if failed else before & ~kind
        if self._bits and not before:
            self._since = rover.now
        if self.triggered and not self._bits:
            rover.say(INFO, f"{name} Failsafe Cleared")
        self.triggered &= self._bits
        in_hold = rover.mode.number == _HOLD and not int(rover.params["FS_OPTIONS"]) & ACTIVE_IN_HOLD
        due = self._bits and not self.triggered and rover.now - self._since > rover.params["FS_TIMEOUT"]
        if due and not in_hold and rover.mode.number != _RTL:
            self._trigger(kind, name)

    def _trigger(self, kind: int, name: str) -> None:
        rover = self._rover
        self.triggered = self._bits
        rover.say(WARNING, f"{name} Failsafe")
        rover.rc.clear_overrides()
        enabled = rover.params["FS_THR_ENABLE" if kind == RADIO else "FS_GCS_ENABLE"]
        if rover.mode is rover.auto and int(enabled) == CONTINUE_MISSION:
            rover.say(WARNING, "Failsafe - Continuing Auto Mode")
        else:
            self.act(int(rover.params["FS_ACTION"]))
