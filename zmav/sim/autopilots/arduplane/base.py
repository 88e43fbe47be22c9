"""What the modes of an ArduPlane know of it: its speeds, its sticks and its limits."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.boot import Stage as BootStage
from zmav.sim.autopilots.ardupilot.state import INFO
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.base import Installation
from zmav.sim.control.planetargets import GAINS, PlaneHandle, Stage
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.wing import Wing

INITIALISING = 16
TURN = 5  # ticks: how often modes set their targets
SURE_ARMED, SURE_DISARMED = 0.1, 0.9  # of the belief to fly
_BOTH = ("0", "1")


def _each(text: str, *filters: str) -> tuple[str, ...]:
    return tuple(f"{name} IMU{imu} {text.format(imu=imu)}" for name in filters for imu in _BOTH)


PLANE_STAGES: tuple[BootStage, ...] = (
    BootStage(0.0, ("Ground start",)),
    BootStage(0.0, ("Skipping INS calibration",), severity=1),
    BootStage(0.0, ("Calibrating barometer",)),
    BootStage(0.1, ("RCInput: decoding UDP (Pulses)",), severity=7),
    BootStage(1.6, ("Barometer 1 calibration complete", "Barometer 2 calibration complete")),
    BootStage(1.6, ("Airspeed 1 calibration started",)),
    BootStage(1.6, ("ArduPilot Ready", "AHRS: DCM active"), event="initialised"),
    BootStage(1.62, ("Throttle failsafe off",), severity=4),
    BootStage(3.28, ("Airspeed 1 calibrated",), event="airspeed"),
    BootStage(8.93, ("GPS 1: probing for u-blox at 230400 baud", "GPS 1: detected u-blox")),
    BootStage(9.38, _each("MAG0 initial yaw alignment complete", "EKF2"), event="gps"),
    BootStage(10.14, _each("initialised", "EKF3"), event="ekf_started"),
    BootStage(12.02, _each("tilt alignment complete", "EKF3"), event="aligned"),
    BootStage(12.1, _each("MAG0 initial yaw alignment complete", "EKF3")),
    BootStage(14.62, _each("tilt alignment complete", "EKF2")),
    BootStage(19.34, (*_each("origin set", "EKF2"), *_each("origin set", "EKF3")), event="origin"),
    BootStage(20.36, (*_each("is using GPS", "EKF3"), "AHRS: EKF3 active"), event="position"),
    BootStage(22.9, event="prearm"),
)


class PlaneBase(ArduVehicle, ABC):
    """One plane, without the modes that fly it."""

    FIRMWARE: ClassVar[str] = "ArduPlane"
    FRAME = ""
    MAV_TYPE = 1
    NOT_SIMULATED: ClassVar[Mapping[int, str]] = {
        2: "STABILIZE",
        3: "TRAINING",
        4: "ACRO",
        6: "FBWB",
        7: "CRUISE",
        8: "AUTOTUNE",
        14: "AVOID_ADSB",
        24: "THERMAL",
    }
    STAGES: ClassVar[tuple[BootStage, ...]] = PLANE_STAGES
    KEEPS_MISSION: ClassVar[bool] = True
    ARMING_TEXTS: ClassVar[tuple[str, str]] = ("Throttle armed", "Throttle disarmed")
    RADIO_PARAMS: ClassVar[tuple[str, str]] = ("THR_FAILSAFE", "THR_FS_VALUE")
    GCS_PARAMS: ClassVar[tuple[str, str]] = ("FS_GCS_ENABL", "FS_LONG_TIMEOUT")

    def __init__(self, into: Installation[Wing, PlaneHandle]) -> None:
        self.airframe, self.sp = into.airframe, into.setpoint
        self.eas2tas = self.sp.eas2tas
        super().__init__(into)
        for name in GAINS:
            if name in self.params:
                self.sp.gain(name, self.params[name])

    def on_power(self) -> None:
        self._flying = 0.0
        self.flying_since = self.last_flying = self.now
        self.throttle_suppressed = self.taken_off = True
        self.takeoff_direction: float | None = None
        self.airspeed_chosen: float | None = None
        self.sp.off()

    def on_disarm(self) -> None:
        self.sp.off()
        self._flying = 0.0
        self.airspeed_chosen = self.takeoff_direction = None
        self.throttle_suppressed = True

    def waking_faults(self) -> list[str]:
        """In ArduPlane's words and order."""
        has = self.boot.has
        if not has("initialised"):
            return ["System not initialised"]
        if has("prearm"):
            return [] if self.armed or self.mode.armable else [f"{self.mode.name} mode not armable"]
        checks = (
            (True, "Gyros inconsistent" if has("aligned") else "Accels inconsistent"),
            (not has("ekf_started"), "AHRS: waiting for home"),
            (not has("airspeed"), "Airspeed: 1 pre-flight calibration in progress"),
        )
        return [text for failed, text in checks if failed]

    def param_changed(self, name: str, value: float) -> None:
        if name in GAINS:
            self.sp.gain(name, value)

    def change_speed(self, limit: str, value: float) -> None:
        """A plane has one speed: see :meth:`ask_speed`."""
        if limit == "speed":
            self.ask_speed(0, value)

    def ask_speed(self, kind: int, value: float) -> bool:
        """DO_CHANGE_SPEED: an airspeed (SPEED_TYPE 0; -2 is the usual one), or a least ground speed (1)."""
        params = self.params
        if kind == 0 and value == -2.0:
            self.airspeed_chosen = None
        elif kind == 0 and params["AIRSPEED_MIN"] <= value <= params["AIRSPEED_MAX"]:
            self.airspeed_chosen = value
            self.say(INFO, f"Set airspeed {int(value)} m/s")
        elif kind == 1:
            self.say(INFO, f"Set groundspeed {int(value)}")
            self.params.set("MIN_GROUNDSPEED", min(max(value, 0.0), params["AIRSPEED_MAX"]))
        else:
            return False
        return True

    # ---- what it knows

    @property
    def here(self) -> Vector:
        s = self.sense
        return s.north, s.east, s.down

    @property
    def groundspeed(self) -> float:
        return math.hypot(self.sense.vn, self.sense.ve)

    @property
    def eas(self) -> float:
        """Equivalent airspeed, m/s."""
        return self.sense.airspeed / self.eas2tas

    @property
    def flying(self) -> bool:
        return self._flying >= (SURE_ARMED if self.armed else SURE_DISARMED)

    @property
    def cruise(self) -> float:
        """The usual airspeed, equivalent, m/s."""
        return self.params["AIRSPEED_CRUISE"]

    @property
    def airspeed_wanted(self) -> float:
        """In modes that navigate: what was chosen, and enough against the wind (MIN_GROUNDSPEED)."""
        params = self.params
        speed = self.airspeed_chosen or self.cruise
        if params["MIN_GROUNDSPEED"] > 0:
            s = self.sense
            along = s.vn * math.cos(s.yaw) + s.ve * math.sin(s.yaw)
            speed += max(params["MIN_GROUNDSPEED"] - along, 0.0)
        return min(max(speed, params["AIRSPEED_MIN"]), params["AIRSPEED_MAX"])

    # ---- the pilot's sticks, in the middle without a radio

    @property
    def stick_roll(self) -> float:
        return 0.0 if self.rc.lost else self.rc.roll

    @property
    def stick_pitch(self) -> float:
        """Positive: nose up."""
        return 0.0 if self.rc.lost else -self.rc.pitch

    @property
    def stick_yaw(self) -> float:
        return 0.0 if self.rc.lost else self.rc.yaw

    @property
    def stick_throttle(self) -> float:
        return 0.0 if self.rc.lost or not self.armed else self.rc.throttle * self.params["THR_MAX"] * 0.01

    # ---- flying

    def disarm_after_landing(self) -> bool:
        """LAND_DISARMDELAY seconds after it stopped flying; whether that was now."""
        delay = self.params["LAND_DISARMDELAY"]
        due = self.armed and delay > 0 and not self.flying and self.now - self.last_flying >= delay
        if due:
            self.disarm(forced=True)
            self.say(INFO, "Auto disarmed")
        return due

    def fly_height(self, height: float, airspeed: float, stage: Stage = Stage.NORMAL, ground: float = 0.0) -> None:
        """Hold a height (m over the world's origin) and an equivalent airspeed."""
        self.sp.energy(height, airspeed)
        self.sp.stage(stage, ground)
        self.limit()
        if self.throttle_suppressed or stage is Stage.FLARE:
            self.sp.power(0.0)

    def limit(
        self, *, roll: float | None = None, pitch_min: float | None = None, throttle: tuple[float, float] | None = None
    ) -> None:
        """How far navigation may go: the parameters, or less."""
        params = self.params
        most = math.radians(params["ROLL_LIMIT_DEG"])
        low, high = math.radians(params["PTCH_LIM_MIN_DEG"]), math.radians(params["PTCH_LIM_MAX_DEG"])
        self.sp.limits(
            roll=most if roll is None else min(roll, most),
            pitch=(low if pitch_min is None else pitch_min, high),
            throttle=throttle or (params["THR_MIN"] * 0.01, params["THR_MAX"] * 0.01),
        )

    @property
    def on_turn(self) -> bool:
        """It is time for new targets."""
        return self._ticks % TURN == 0
