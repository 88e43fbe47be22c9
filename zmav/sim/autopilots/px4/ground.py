"""Leaving the ground and coming back to it: spooling up, the takeoff ramp, and the land detector's three stages.

Times were measured on PX4 1.16; parameters: COM_SPOOLUP_TIME, MPC_TKO_RAMP_T.
"""

from __future__ import annotations

import enum

from zmav.sim.autopilots.px4.state import Px4State

DETECTED_S = 0.9  # into the ramp the land detector takes the vehicle for flying
CONTACT_S = 0.35  # from the touch to "ground contact", when the thrust is taken away
LANDED_S = 2.4  # from there to "landed"
STILL_MPS = 0.6


class Stage(enum.Enum):
    STANDING = "standing"
    RAMP = "ramp"  # the motors get what they need to lift
    FLYING = "flying"
    TOUCHED = "touched"  # on the ground again, without thrust, not yet taken for landed


class LandDetector:
    """One vehicle's stage between standing and flying."""

    def __init__(self, copter: Px4State) -> None:
        self._copter = copter
        self.stage = Stage.STANDING
        self.landed = True
        self._since = 0.0
        self._quiet_since: float | None = None

    def reset(self) -> None:
        """On the ground, motors off."""
        self.stage, self.landed, self._quiet_since = Stage.STANDING, True, None

    def lift(self, *, at_once: bool) -> None:
        """A standing vehicle is asked to fly; ``at_once``: the one who asks gives the thrust himself."""
        copter = self._copter
        if self.stage is Stage.TOUCHED:
            self.stage = Stage.FLYING
        elif self.stage is Stage.STANDING and copter.now >= copter.armed_at + copter.params["COM_SPOOLUP_TIME"]:
            self._since = copter.now
            self.stage = Stage.FLYING if at_once else Stage.RAMP

    def update(self, *, descends: bool) -> None:
        """Once a tick while armed; ``descends``: nothing but the ground would end this."""
        copter = self._copter
        if self.stage is Stage.RAMP and copter.now - self._since >= copter.params["MPC_TKO_RAMP_T"]:
            self.stage = Stage.FLYING
        self._detect_takeoff()
        if self.stage is Stage.FLYING and not self.landed:
            self._detect_touch(descends)
        elif self.stage is Stage.TOUCHED:
            self._detect_landing()

    def _detect_takeoff(self) -> None:
        if not self.landed:
            return
        ramped = self.stage is Stage.RAMP and self._copter.now - self._since >= DETECTED_S
        if ramped or (self.stage is Stage.FLYING and not self._copter.sense.contact):
            self.landed = False
            self._copter.took_off()

    def _detect_touch(self, descends: bool) -> None:
        sense, now = self._copter.sense, self._copter.now
        if not (sense.contact and descends and abs(sense.vd) < STILL_MPS):
            self._quiet_since = None
            return
        self._quiet_since = now if self._quiet_since is None else self._quiet_since
        if now - self._quiet_since >= CONTACT_S:
            self.stage, self._since, self._quiet_since = Stage.TOUCHED, now, None

    def _detect_landing(self) -> None:
        copter = self._copter
        if not copter.sense.contact:
            self.stage = Stage.FLYING
        elif copter.now - self._since >= LANDED_S:
            self.stage, self.landed = Stage.STANDING, True
            copter.touched_down()
