"""What PX4 does when a link is lost: the offboard stream, the ground station, the pilot's radio.

https://docs.px4.io/v1.16/en/config/safety.html. The measured case: the stream lost without a radio shows POSCTL with
system status 5 (critical), sinks at MPC_LAND_SPEED and disarms.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

from zmav.sim.autopilots.px4.modes import (
    ALTCTL,
    HOLD,
    LAND,
    MISSION,
    OFFBOARD,
    POSCTL,
    RTL,
    STABILIZED,
    TERMINATION,
    Mode,
)

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

# COM_OBL_RC_ACT -> the mode that takes over; 7 disarms.
OFFBOARD_LOSS: dict[int, Mode] = {0: POSCTL, 1: ALTCTL, 2: STABILIZED, 3: RTL, 4: LAND, 5: HOLD, 6: TERMINATION}
# NAV_RCL_ACT, NAV_DLL_ACT -> mode; 0 nothing, 6 disarms.
LINK_LOSS: dict[int, Mode] = {1: HOLD, 2: RTL, 3: LAND, 5: TERMINATION}
DISARM_NOW = {"COM_OBL_RC_ACT": 7, "NAV_RCL_ACT": 6, "NAV_DLL_ACT": 6}


class Cause(enum.Enum):
    OFFBOARD = "offboard stream"
    PILOT = "manual control"
    GROUND = "ground station"


class Failsafe:
    """Decides which mode flies instead of the one that was asked for."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self.cause: Cause | None = None
        self._ground_heard: float | None = None
        self._pilot_at_arming = False
        self._since = 0.0

    @property
    def active(self) -> bool:
        return self.cause is not None

    def reset(self) -> None:
        self.cause = None

    def armed(self) -> None:
        """The pilot's radio counts only where it was there at arming, or since."""
        self._pilot_at_arming = self._copter.sticks.alive

    def ground_spoke(self) -> None:
        """A heartbeat of a ground station (MAV_TYPE_GCS)."""
        self._ground_heard = self._copter.now

    @property
    def ground_lost(self) -> bool:
        copter = self._copter
        heard = -math.inf if self._ground_heard is None else self._ground_heard
        return copter.now - heard > float(copter.params["COM_DL_LOSS_T"])

    def mode(self, wanted: Mode) -> Mode | None:
        """The mode to fly while ``wanted`` is asked for; None: disarm at once."""
        copter = self._copter
        self._pilot_at_arming |= copter.sticks.alive
        if wanted is OFFBOARD and not copter.offboard.alive:
            return self._act(Cause.OFFBOARD, "COM_OBL_RC_ACT", OFFBOARD_LOSS, wanted, delay=0.0)
        delay = float(copter.params["COM_FAIL_ACT_T"])
        if self._pilot_at_arming and not copter.sticks.alive and not self._pilot_optional(wanted):
            return self._act(Cause.PILOT, "NAV_RCL_ACT", LINK_LOSS, wanted, delay)
        # A landing goes on whoever is lost.
        if self._ground_heard is not None and self.ground_lost and wanted is not LAND:
            return self._act(Cause.GROUND, "NAV_DLL_ACT", LINK_LOSS, wanted, delay)
        self.cause = None
        return wanted

    def _pilot_optional(self, wanted: Mode) -> bool:
        """COM_RCL_EXCEPT: modes that go on without a pilot."""
        bit = 1 if wanted is MISSION else 2 if wanted.auto else 4 if wanted is OFFBOARD else 0
        return bool(int(self._copter.params["COM_RCL_EXCEPT"]) & bit)

    def _act(self, cause: Cause, param: str, modes: dict[int, Mode], wanted: Mode, delay: float) -> Mode | None:
        copter = self._copter
        action = int(copter.params[param])
        if cause is not Cause.OFFBOARD and action not in modes and action != DISARM_NOW[param]:
            self.cause = None
            return wanted
        if self.cause is not cause:
            self.cause, self._since = cause, copter.now
            copter.failsafe_began()
        if copter.now - self._since < delay:
            return HOLD  # time for the pilot to take over
        if action == DISARM_NOW[param]:
            return None
        return modes.get(action, POSCTL)
