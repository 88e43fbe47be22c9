"""ArduCopter's ground-station failsafe: https://ardupilot.org/copter/docs/gcs-failsafe.html"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter import ArduCopter

_RTL, _LAND, _BRAKE = 6, 9, 17
# FS_GCS_ENABLE -> mode; where SMART_RTL is meant, RTL does its work.
_ACTIONS = {1: _RTL, 3: _RTL, 4: _RTL, 5: _LAND, 6: _RTL, 7: _BRAKE}
_CONTINUE_IN_PILOT_MODES = 16  # FS_OPTIONS
_WARNING = 4


class GcsFailsafe:
    """Watches for heartbeats of the ground station (MAV_GCS_SYSID) once there has been one; off unless FS_GCS_ENABLE
    says so.
    """

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self._heard: float | None = None
        self._active = False

    def heard(self, sysid: int) -> None:
        """A heartbeat arrived from ``sysid``; anybody's but the ground station's does not count."""
        if sysid == int(self._copter.params["MAV_GCS_SYSID"]):
            self._heard = self._copter.now

    def update(self) -> None:
        copter = self._copter
        action = _ACTIONS.get(int(copter.params["FS_GCS_ENABLE"]))
        if action is None or self._heard is None:
            return
        silent = copter.now - self._heard > copter.params["FS_GCS_TIMEOUT"]
        if silent and not self._active:
            self._active = True
            if copter.armed:
                self._act(action)
        elif self._active and not silent:
            self._active = False
            copter.failsafe = False
            copter.say(_WARNING, "GCS Failsafe Cleared")

    def _act(self, action: int) -> None:
        copter = self._copter
        copter.failsafe = True
        copter.say(_WARNING, "GCS Failsafe")
        if copter.landed:
            copter.disarm()
        elif copter.mode.by_pilot and int(copter.params["FS_OPTIONS"]) & _CONTINUE_IN_PILOT_MODES:
            copter.say(_WARNING, "GCS Failsafe - Continuing Pilot Control")
        elif not copter.set_mode(action):
            copter.set_mode(_LAND)
