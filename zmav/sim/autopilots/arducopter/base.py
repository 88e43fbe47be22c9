"""What the modes of an ArduCopter know of it: its limits, its nose, and how it stands."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.base import Installation
from zmav.sim.control.setpoints import Axis, SetpointHandle, Spool
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.fleets.base import Sense

LANDED_AFTER_S = 1.0  # of standing on the ground without thrust
SOFTENED_AFTER_S = 0.2  # of that, from which on a landing gives up its place
MAV_TYPE_QUADROTOR, MAV_TYPE_HEXAROTOR = 2, 13
LOOK_SHARE = 0.05  # of the allowed speed: slower motion does not turn the nose
# To thrust, as measured: from the order to lift off, and from arming (after which the motors stand still for 2 s).
SPOOL_UP_S, ARMING_S = 2.0, 3.2

# Parameter -> (gain, its rows, gain for each unit of the parameter): the gains at the defaults are those that fly as a
# real one was measured to. https://ardupilot.org/copter/docs/parameters.html (ATC_, PSC_)
GAINS: dict[str, tuple[str, tuple[int, ...], float]] = {
    "PSC_POSXY_P": ("pos_p", (0, 1), 1.0),
    "PSC_POSZ_P": ("pos_p", (2,), 1.0),
    "PSC_VELXY_P": ("vel_p", (0, 1), 1.0),
    "PSC_VELXY_I": ("vel_i", (0, 1), 1.0),
    "PSC_VELZ_P": ("vel_p", (2,), 1.0),
    "PSC_ACCZ_I": ("vel_i", (2,), 1.0),
    "ATC_ANG_RLL_P": ("angle_p", (0,), 6.0 / 4.5),
    "ATC_ANG_PIT_P": ("angle_p", (1,), 6.0 / 4.5),
    "ATC_ANG_YAW_P": ("angle_p", (2,), 3.0 / 4.5),
    "ATC_RAT_RLL_P": ("rate_p", (0,), 18.0 / 0.135),
    "ATC_RAT_PIT_P": ("rate_p", (1,), 18.0 / 0.135),
    "ATC_RAT_YAW_P": ("rate_p", (2,), 7.0 / 0.3),
    "ATC_RAT_RLL_I": ("rate_i", (0,), 8.0 / 0.135),
    "ATC_RAT_PIT_I": ("rate_i", (1,), 8.0 / 0.135),
    "ATC_RAT_YAW_I": ("rate_i", (2,), 1.0 / 0.02),
}
# Parameter -> (limit of the cascade, factor to SI).
_LIMITS = {
    "WPNAV_SPEED": ("speed", 0.01),
    "WPNAV_SPEED_UP": ("speed_up", 0.01),
    "WPNAV_SPEED_DN": ("speed_down", 0.01),
    "WPNAV_ACCEL": ("accel", 0.01),
    "WPNAV_ACCEL_Z": ("accel_z", 0.01),
    "PSC_JERK_XY": ("jerk", 1.0),
    "PSC_JERK_Z": ("jerk_z", 1.0),
    "ANGLE_MAX": ("lean", math.radians(0.01)),
    "ATC_SLEW_YAW": ("yaw_slew", math.radians(0.01)),
}


class Heading:
    """Where a copter that flies by itself points its nose: ArduCopter's "auto yaw"."""

    def __init__(self, setpoint: SetpointHandle) -> None:
        self._sp = setpoint
        self._along = False

    def hold(self, yaw: float) -> None:
        """Turn to ``yaw`` (radians) and keep it."""
        self._along = False
        self._sp.heading(yaw)

    def turn(self, rate: float) -> None:
        """Turn at ``rate`` rad/s until told otherwise."""
        self._along = False
        self._sp.turn(rate)

    def along(self, behavior: float, yaw: float) -> None:
        """The default of WP_YAW_BEHAVIOR: 0 keeps the nose where it is, anything else looks where it flies."""
        if behavior == 0:
            self.hold(yaw)
        elif not self._along:
            self._along = True
            self._sp.heading(yaw)

    def update(self, sense: Sense) -> None:
        """Once a tick, while the motors run."""
        if self._along:
            speed = math.hypot(sense.ref_vn, sense.ref_ve)
            if speed > LOOK_SHARE * self._sp.limit_of("speed"):
                self._sp.heading(math.atan2(sense.ref_ve, sense.ref_vn))


class CopterBase(ArduVehicle, ABC):
    """One copter, without the modes that fly it."""

    FIRMWARE: ClassVar[str] = "ArduCopter"
    NOT_SIMULATED: ClassVar[Mapping[int, str]] = {
        1: "ACRO",
        7: "CIRCLE",
        11: "DRIFT",
        13: "SPORT",
        14: "FLIP",
        15: "AUTOTUNE",
        16: "POSHOLD",
        18: "THROW",
        19: "AVOID_ADSB",
        20: "GUIDED_NOGPS",
        21: "SMARTRTL",
        22: "FLOWHOLD",
        23: "FOLLOW",
        24: "ZIGZAG",
        25: "SYSTEMID",
        26: "AUTOROTATE",
        27: "AUTO RTL",
        28: "TURTLE",
    }

    def __init__(self, into: Installation[Airframe, SetpointHandle]) -> None:
        self.airframe, self.sp = into.airframe, into.setpoint
        self.MOTORS = len(self.airframe.rotors)
        hexa = self.MOTORS == 6
        self.MAV_TYPE = MAV_TYPE_HEXAROTOR if hexa else MAV_TYPE_QUADROTOR
        self.FRAME = "HEXA/X" if hexa else "QUAD/PLUS"
        self.speeds: dict[str, float] = {}  # chosen for this mode: limits of the cascade, m/s
        self.heading = Heading(self.sp)
        super().__init__(into)
        for name in (*_LIMITS, *GAINS):
            self.param_changed(name, self.params[name])

    def on_power(self) -> None:
        self._quiet_since: float | None = None
        self._idle_since = self._landed_at = self.now
        self._choose_speeds()
        self.on_disarm()

    # ---- what it knows

    @property
    def touched(self) -> bool:
        """It may have landed: what has touched the ground must not lean against the wind until it falls over."""
        return self._quiet_since is not None and self.now - self._quiet_since >= SOFTENED_AFTER_S

    @property
    def settled(self) -> bool:
        """It has stood on the ground for a moment."""
        return self.landed and self.now - self._landed_at >= LANDED_AFTER_S

    @property
    def spun_up_at(self) -> float:
        """When it has thrust, if it is to lift off now."""
        return max(self.now + SPOOL_UP_S, self._armed_at + ARMING_S)

    # ---- what it can be told

    def mode_changed(self) -> None:
        self.sp.raw(False)
        self._choose_speeds()

    def _choose_speeds(self) -> None:
        """Back to the parameters: what was chosen for one mode does not outlive it."""
        for name, (limit, factor) in _LIMITS.items():
            if limit.startswith("speed"):
                self.change_speed(limit, self.params[name] * factor)

    def change_speed(self, limit: str, value: float) -> None:
        """Fly with another speed, m/s: "speed", "speed_up" or "speed_down"."""
        self.speeds[limit] = max(value, 0.1)
        self.sp.limit(limit, value)

    def stop_here(self) -> None:
        """Brake to a stop and stay there, nose as it is."""
        self.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.heading.hold(self.sense.yaw)

    def spool(self) -> bool:
        """Motors up in the air, idle on the ground. True in the air."""
        self.sp.spool(Spool.IDLE if self.landed else Spool.FLY)
        return not self.landed

    def on_arm(self) -> None:
        self._idle_since = self.now

    def on_disarm(self) -> None:
        self.sp.spool(Spool.OFF)

    def param_changed(self, name: str, value: float) -> None:
        if name in GAINS:
            gain, axes, factor = GAINS[name]
            self.sp.tune(gain, axes, value * factor)
        if name in _LIMITS:
            limit, factor = _LIMITS[name]
            if limit in self.speeds:
                self.change_speed(limit, value * factor)
            else:
                self.sp.limit(limit, value * factor)
