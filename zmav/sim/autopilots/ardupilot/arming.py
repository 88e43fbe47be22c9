"""When an ArduPilot arms and when it does not, and in which words it says so.

https://ardupilot.org/copter/docs/common-prearm-safety-checks.html
"""

from __future__ import annotations

from abc import ABC

from zmav.sim.autopilots.ardupilot.ekf import Ekf3
from zmav.sim.autopilots.ardupilot.failsafe import BatteryFailsafe, EkfFailsafe, GcsFailsafe
from zmav.sim.autopilots.ardupilot.fence import Fence
from zmav.sim.autopilots.ardupilot.radio import Radio
from zmav.sim.autopilots.ardupilot.state import VehicleState

MAGFIELD_MG = 100.0  # the default of ARMING_MAGTHRESH


class ArmingChecks(VehicleState, ABC):
    """A vehicle with the parts that its checks look at."""

    rc: Radio
    gcs: GcsFailsafe
    battery: BatteryFailsafe
    ekf: EkfFailsafe
    filter: Ekf3
    fence: Fence

    def mandatory_faults(self) -> list[str]:
        """What even a forced arming is refused for."""
        boot = self.boot
        if not boot.has("initialised"):
            return ["System not initialised"]
        if not boot.has("aligned"):
            return ["AHRS: EKF3 not healthy"]
        if self.mode.needs_position and not self.position_ok:
            return ["AHRS: waiting for home" if not boot.has("origin") else "Need Position Estimate"]
        return []

    def waking_faults(self) -> list[str]:
        """What is not ready yet after a boot, as arming is told."""
        faults = self.mandatory_faults()
        return faults if faults or self.boot.has("prearm") else ["AHRS not healthy"]

    def prearm_faults(self) -> list[str]:
        """What the checks that always run find, in the mode it is in; empty: the pre-arm bit of SYS_STATUS is set."""
        faults = self.waking_faults()
        return faults if faults or self.armed or not int(self.params["ARMING_CHECK"]) else self._state_faults()

    def _state_faults(self) -> list[str]:
        """What failsafes, fence, battery, radio and mission have against it; all of them, in ArduPilot's order."""
        enabled, lowest = self.RADIO_PARAMS
        low = self.params[enabled] and self.rc.pwm[2] < self.params[lowest]
        return [
            *(["GCS failsafe on"] if self.gcs.active else []),
            *(["Throttle below failsafe"] if low else []),
            *self._sensor_faults(),
            *self.battery.faults(),
            *(["Radio failsafe on"] if self.rc.lost else []),
            *(["Mode requires mission"] if self.mode is self.auto and not self.mission.present else []),
            *self.fence.faults(),
        ]

    def arming_faults(self, *, forced: bool) -> list[str]:
        """Why this vehicle does not arm now on the ground station's word; empty: it does."""
        faults = self.mandatory_faults() if forced else self.prearm_faults()
        if faults or forced:
            return faults
        if not self.mode.allows_arming():
            return [f"{self.mode.name} mode not armable"]
        with_throttle = self.mode in (self.guided, self.auto)
        if not with_throttle and self.rc.throttle > self.mode.throttle_to_arm:
            return ["Throttle too high"]
        if not self.rc.valid or not int(self.params["ARMING_CHECK"]):
            return []
        sticks = (("Roll", 1, self.rc.roll), ("Pitch", 2, self.rc.pitch), ("Yaw", 4, self.rc.yaw))
        return [f"{name} (RC{channel}) is not neutral" for name, channel, value in sticks if value != 0.0]

    def _sensor_faults(self) -> list[str]:
        """Of the sensors, and of the filter that trusts or doubts them; in ArduPilot's order."""
        belief = self.filter.belief
        if belief is None or not (belief.troubled or belief.led):
            return []
        off = belief.field_difference_mg
        checks = (
            (belief.baro_lost, "Baro: not healthy"),
            (belief.compass_lost, "Compass not healthy"),
            (
                not belief.compass_lost and off > MAGFIELD_MG,
                f"Check mag field (xy diff:{off:.0f}>{MAGFIELD_MG:.0f})",
            ),
            (not belief.has_fix, "GPS 1: Bad fix"),
        )
        found = [text for failed, text in checks if failed]
        return found + self._filter_faults() if self.mode.needs_position else found

    def _filter_faults(self) -> list[str]:
        """In modes that need a position."""
        if self.filter.glitching:
            return ["GPS glitching"]
        limit, ratios = self.filter.threshold, self.filter.ratios
        doubted = [name for name in ("compass", "position", "velocity", "height") if 0.0 < limit <= ratios[name]]
        return [f"EKF {name} variance" for name in doubted[:1]]
