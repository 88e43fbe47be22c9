"""What ArduPlane does when a failsafe or its fence trips.

https://ardupilot.org/plane/docs/apms-failsafe-function.html; what each says and does follows ArduPlane's events.
"""

from __future__ import annotations

from typing import ClassVar

from zmav.sim.autopilots.ardupilot.state import DISARM, INFO, WARNING, Reactions, Steps
from zmav.sim.autopilots.arduplane.modes import PlaneParts

MANUAL, CIRCLE, FBWA, AUTO, RTL, GUIDED, AUTOLAND = 0, 1, 5, 10, 11, 15, 26
STICK_MODES = {0, 5}
NAVIGATING_MODES = {10, 12, 15, 26}
# FS_SHORT_ACTN, FS_LONG_ACTN
SHORT_BEST_GUESS, SHORT_FBWA, SHORT_DISABLED = 0, 2, 3
LONG_RTL, LONG_GLIDE, LONG_PARACHUTE, LONG_AUTO, LONG_AUTOLAND = range(1, 6)
# BATT_FS_LOW_ACT
BATTERY_LAND, BATTERY_TERMINATE = 2, 3
ACTIONS: dict[int, Steps] = {1: (RTL,), BATTERY_LAND: (RTL,), BATTERY_TERMINATE: (DISARM,), 7: (AUTOLAND, RTL)}
FENCE_ACTIONS: dict[int, Steps] = {1: (RTL,), 6: (RTL,), 7: (RTL,), 8: (AUTOLAND, RTL)}
LONG_ACTIONS: dict[int, Steps] = {
    LONG_RTL: (RTL,),
    LONG_GLIDE: (FBWA,),
    LONG_PARACHUTE: (),
    LONG_AUTO: (AUTO,),
    LONG_AUTOLAND: (AUTOLAND, RTL),
}


class PlaneReactions(Reactions):
    """Losing the pilot has two steps, short and long; losing the ground station only the long one."""

    BATTERY_URGENCY: ClassVar[tuple[int, ...]] = (3, 5, 6, 4, 2, 7, 1, 0)
    ACTIONS = ACTIONS

    def __init__(self, plane: PlaneParts) -> None:
        super().__init__(plane)
        self._plane = plane
        self.reset()

    def reset(self) -> None:
        """After a reboot."""
        self.state = ""  # "short", "long" or "gcs"
        self._lost_at: float | None = None
        self._before: int | None = None
        self._mode_by_short: int | None = None
        self._pending: str = ""

    # ---- the pilot's radio

    def radio_changed(self, lost: bool) -> None:
        plane = self._plane
        plane.say(WARNING, f"Throttle failsafe {'on' if lost else 'off'}")
        self._lost_at = plane.now - plane.rc.silent_s if lost else None

    def update(self) -> None:
        """Ten times a second."""
        plane = self._plane
        if self._pending and not plane.taking_off:
            what, self._pending = self._pending, ""
            if self.state:
                self._long(what)
        lost = plane.rc.lost
        watched = int(plane.params["FS_SHORT_ACTN"]) != SHORT_DISABLED
        if self.state == "" and lost and watched and not self._landing:
            self._short()
        if self.state == "short" and not lost:
            self._short_over()
        if self.state in ("", "short") and lost and not self._landing and self._lost_at is not None:
            if plane.now - self._lost_at >= plane.params["FS_LONG_TIMEOUT"]:
                self.state = "long"
                self._long("RC Long")
        elif self.state == "long" and not lost:
            self.state, self._pending = "", ""
            plane.say(WARNING, "RC Long Failsafe Cleared")

    @property
    def _landing(self) -> bool:
        return self._plane.landing.active

    def _short(self) -> None:
        plane = self._plane
        self.state, self._before, self._lost_at = "short", plane.mode.number, plane.now
        action = int(plane.params["FS_SHORT_ACTN"])
        target = FBWA if action == SHORT_FBWA else CIRCLE
        number = plane.mode.number
        if number in STICK_MODES or (number in NAVIGATING_MODES and action != SHORT_BEST_GUESS):
            plane.set_mode(target)
        if plane.mode.number != self._before:
            self._mode_by_short = plane.mode.number
            plane.say(WARNING, f"RC Short Failsafe: switched to {plane.mode.name}")
        else:
            self._mode_by_short = None
            plane.say(WARNING, "RC Short Failsafe On")

    def _short_over(self) -> None:
        plane = self._plane
        self.state = ""
        plane.say(WARNING, "Short Failsafe Cleared")
        if self._mode_by_short == plane.mode.number and self._before is not None:
            plane.set_mode(self._before)
            plane.say(INFO, f"Flight mode {plane.mode.name} restored")

    def _long(self, what: str) -> None:
        """``what``: "RC Long" or "GCS"."""
        plane = self._plane
        plane.rc.clear_overrides()
        action, number = int(plane.params["FS_LONG_ACTN"]), plane.mode.number
        if number in STICK_MODES or number in (CIRCLE, 12, 13):
            if plane.taking_off and action not in (LONG_GLIDE, LONG_PARACHUTE):
                self._pending = what
            else:
                self.attempt(LONG_ACTIONS.get(action, (RTL,)))
        elif number == GUIDED or (number == AUTO and not self._landing):
            self.attempt(LONG_ACTIONS.get(action, ()))
        elif number == RTL and action in (LONG_AUTO, LONG_AUTOLAND):
            self.attempt(LONG_ACTIONS[action])
        plane.say(WARNING, f"{what} Failsafe On: {plane.mode.name}")

    # ---- the rest

    def gcs_lost(self) -> None:
        if self.state in ("", "short") and not self._landing:
            self.state = "gcs"
            self._long("GCS")

    def gcs_back(self) -> None:
        if self.state == "gcs":
            self.state, self._pending = "", ""
        self._plane.say(WARNING, "GCS Failsafe Off")

    def battery_failed(self, action: int) -> None:
        plane = self._plane
        landing = plane.landing.active or plane.mode.number == AUTOLAND
        if action == BATTERY_TERMINATE or not landing:
            self.act(action)

    def fence_breached(self, new: int, beyond_m: float) -> None:
        plane = self._plane
        action = int(plane.params["FENCE_ACTION"])
        if not plane.armed or plane.mode_by_fence or plane.landing.flaring:
            return
        landing = plane.mode.number == AUTOLAND or (plane.mode.number == AUTO and plane.landing.active)
        if not landing:
            self.attempt(FENCE_ACTIONS.get(action, ()), by_fence=True)
