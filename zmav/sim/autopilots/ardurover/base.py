"""What the modes of an ArduRover know of it: its frame, its sticks and its speeds."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.boot import STAGES, Stage
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.base import Installation
from zmav.sim.control.roversetpoints import BY_PARAM, Point, RoverHandle
from zmav.sim.dynamics.roverframe import RoverFrame

MAV_TYPE_GROUND_ROVER = 10
_TEXTS: dict[str, tuple[str, ...]] = {
    "initialised": ("Beginning INS calibration. Do not move vehicle", "ArduPilot Ready", "AHRS: DCM active"),
    "ekf_started": ("EKF3 IMU0 initialised", "EKF3 IMU1 initialised"),
    "position": ("EKF3 IMU0 is using GPS", "EKF3 IMU1 is using GPS", "AHRS: EKF3 active"),
}
ROVER_STAGES = tuple(
    Stage(stage.at, _TEXTS.get(stage.event, stage.text), stage.severity, stage.event) for stage in STAGES
)


class RoverBase(ArduVehicle, ABC):
    """One rover, without the modes that drive it."""

    FIRMWARE: ClassVar[str] = "ArduRover"
    FRAME = ""
    MAV_TYPE = MAV_TYPE_GROUND_ROVER
    NOT_SIMULATED: ClassVar[Mapping[int, str]] = {
        1: "ACRO",
        3: "STEERING",
        6: "FOLLOW",
        7: "SIMPLE",
        8: "DOCK",
        9: "CIRCLE",
        12: "SMART_RTL",
    }
    MODE_PARAM: ClassVar[str] = "MODE"
    AXES = (("y", 0, 1, -1000), ("z", 2, 1, -1000))  # the throttle goes both ways
    STAGES: ClassVar[tuple[Stage, ...]] = ROVER_STAGES
    HOME_ON_ARMING: ClassVar[bool] = False
    KEEPS_MISSION: ClassVar[bool] = True
    ARMING_TEXTS: ClassVar[tuple[str, str]] = ("Throttle armed", "Throttle disarmed")

    def __init__(self, into: Installation[RoverFrame, RoverHandle]) -> None:
        self.airframe, self.sp = into.airframe, into.setpoint
        super().__init__(into)
        for name in BY_PARAM:
            self.param_changed(name, self.params[name])

    # ---- what it knows

    @property
    @abstractmethod
    def no_radio(self) -> bool:
        """The sticks mean nothing."""

    @property
    def here(self) -> Point:
        return self.sense.north, self.sense.east

    def sticks(self) -> Point:
        """Steering (positive: clockwise) and throttle, -1 to 1, past their dead zones."""
        if self.no_radio:
            return 0.0, 0.0
        steering, throttle = self.stick(1), math.trunc(self.stick(3) * 100.0) / 100.0
        return -steering if throttle < 0.0 else steering, throttle

    def stick(self, channel: int) -> float:
        params, pwm = self.params, self.rc.pwm[channel - 1]
        low, middle, high, dead = (params[f"RC{channel}_{part}"] for part in ("MIN", "TRIM", "MAX", "DZ"))
        if abs(pwm - middle) <= dead:
            return 0.0
        beyond, span = pwm - middle, (high - middle if pwm > middle else middle - low)
        value = math.copysign((abs(beyond) - dead) / max(span - dead, 1.0), beyond)
        return min(max(value, -1.0), 1.0)

    # ---- what it can be told

    def on_disarm(self) -> None:
        self.sp.power(False)

    def watch_ground(self) -> None:
        """It is on the ground, and leaves it never."""

    def param_changed(self, name: str, value: float) -> None:
        if name in BY_PARAM:
            row, factor = BY_PARAM[name]
            self.sp.tune(row, value * factor)
