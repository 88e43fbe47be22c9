"""One ArduRover: what it has beside other ArduPilots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.arming import mandatory_faults, prearm_faults
from zmav.sim.autopilots.ardupilot.boot import STAGES, Stage
from zmav.sim.autopilots.ardupilot.mode import Mode
from zmav.sim.autopilots.ardupilot.reactions import Reactions
from zmav.sim.autopilots.ardupilot.vehicle import CRITICAL, INFO, ArduVehicle
from zmav.sim.autopilots.ardurover.auto import Auto
from zmav.sim.autopilots.ardurover.failsafe import Failsafe, GcsWatch, RoverReactions
from zmav.sim.autopilots.ardurover.guided import Guided
from zmav.sim.autopilots.ardurover.modes import Hold, Initialising, Loiter, Manual, RoverMode, Rtl
from zmav.sim.autopilots.ardurover.travel import Travel
from zmav.sim.control.roversetpoints import BY_PARAM, Point, RoverHandle
from zmav.sim.dynamics.roverframe import RoverFrame
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position
from zmav.sim.protocol.params import ParamStore, defaults

MAV_TYPE_GROUND_ROVER = 10
CALIBRATING, STANDBY, ACTIVE, CRITICAL_STATE = 2, 3, 4, 5  # MAV_STATE
FASTEST = 30.0  # m/s
HOME_EVERY_S, HOME_MOVED_M = 1.0, 0.5
RADIO_EVERY = 2  # ticks
MIDDLE = 1500
TWO_PADDLES, SAME_WAY_BACK = 1, 3  # PILOT_STEER_TYPE
# How who builds a skid-steered rover sets it up: throttle left and right, its speeds, and the turn rate's feed-forward.
SKID = {
    "SERVO1_FUNCTION": 73.0,
    "SERVO3_FUNCTION": 74.0,
    "CRUISE_SPEED": 2.0,
    "CRUISE_THROTTLE": 46.0,
    "WP_SPEED": 2.0,
    "ATC_STR_RAT_FF": 0.2,
}

_TEXTS: dict[str, tuple[str, ...]] = {
    "initialised": ("Beginning INS calibration. Do not move vehicle", "ArduPilot Ready", "AHRS: DCM active"),
    "ekf_started": ("EKF3 IMU0 initialised", "EKF3 IMU1 initialised"),
    "position": ("EKF3 IMU0 is using GPS", "EKF3 IMU1 is using GPS", "AHRS: EKF3 active"),
}
ROVER_STAGES = tuple(
    Stage(stage.at, _TEXTS.get(stage.event, stage.text), stage.severity, stage.event) for stage in STAGES
)


class ArduRover(ArduVehicle):
    """Drives one rover of the :class:`~zmav.sim.fleets.rover.RoverFleet`."""

    FIRMWARE: ClassVar[str] = "ArduRover"
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
    STAGES: ClassVar[tuple[Stage, ...]] = ROVER_STAGES
    ARMING_TEXTS: ClassVar[tuple[str, str]] = ("Throttle armed", "Throttle disarmed")

    auto: Auto
    guided: Guided

    def __init__(
        self,
        frame: RoverFrame,
        params: ParamStore,
        setpoint: RoverHandle,
        sense: Sense,
        world: Position,
        ready_s: float,
    ) -> None:
        self.frame = self.airframe = frame
        self.MAV_TYPE = MAV_TYPE_GROUND_ROVER
        self.FRAME = ""
        self.sp = setpoint
        if frame.skid:
            stock = {name: value for name, value, _ in defaults("ardurover")}
            for name, value in SKID.items():
                if abs(params[name] - stock[name]) < 1e-6:  # nobody chose another
                    params.set(name, value)
        super().__init__(params, sense, world, ready_s)
        for name in BY_PARAM:
            self.param_changed(name, params[name])

    def make_modes(self) -> list[Mode]:
        self.pilot.pwm[2] = self.pilot.pwm[3] = MIDDLE
        self.travel = Travel(self)
        self.rtl, self.loiter = Rtl(self), Loiter(self)
        self.initialising = Initialising(self)
        self.guided, self.auto = Guided(self), Auto(self)
        return [Manual(self), Hold(self), self.rtl, self.loiter, self.initialising, self.guided, self.auto]

    def make_reactions(self) -> Reactions:
        self.rover_reactions = RoverReactions(self)
        return self.rover_reactions

    def on_power(self) -> None:
        self.mode = self.initialising
        self.watched = GcsWatch(self)
        self.gcs = self.watched
        self.failsafes = Failsafe(self)
        self.ever_armed = False
        self._home_due = self.now
        self.sp.power(False)
        self.sp.coast()

    # ---- what it knows

    @property
    def driving_mode(self) -> RoverMode:
        """The mode, with what a rover's has."""
        assert isinstance(self.mode, RoverMode)
        return self.mode

    @property
    def takes_targets(self) -> bool:
        return self.driving_mode.guided

    @property
    def failsafe(self) -> bool:
        return bool(self.failsafes.triggered) or self.ekf.active

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return CRITICAL_STATE
        if self.mode is self.initialising:
            return CALIBRATING
        return STANDBY if isinstance(self.mode, Hold) else ACTIVE

    @property
    def speed_ahead(self) -> float:
        """m/s over the ground, along the nose."""
        s = self.sense
        return s.vn * math.cos(s.yaw) + s.ve * math.sin(s.yaw)

    @property
    def fastest(self) -> float:
        """m/s that full stick stands for."""
        params = self.params
        throttle = params["CRUISE_THROTTLE"] * 0.01
        if not 0.05 <= throttle <= 1.0:
            speed = params["CRUISE_SPEED"]
        else:
            speed = params["SPEED_MAX"] if params["SPEED_MAX"] > 0 else params["CRUISE_SPEED"] / throttle
        return min(max(speed, 0.0), FASTEST)

    def seen_point(self) -> Point:
        """The moving point that the controllers keep to."""
        return self.sp.point()

    # ---- the sticks

    def raw_sticks(self) -> Point:
        """Steering and throttle, -1 to 1, past their dead zones."""
        if self.failsafes.no_radio:
            return 0.0, 0.0
        steering, throttle = self._stick(1), self._stick(3)
        if int(self.params["PILOT_STEER_TYPE"]) == TWO_PADDLES:
            return 0.5 * (steering - throttle), 0.5 * (steering + throttle)
        return steering, throttle

    def sticks(self) -> Point:
        """Steering (positive: clockwise) and throttle, in the steps that they are read in."""
        steering, throttle = self.raw_sticks()
        kind = int(self.params["PILOT_STEER_TYPE"])
        throttle = math.trunc(throttle * 100.0) / 100.0
        return (-steering if throttle < 0.0 and kind not in (TWO_PADDLES, SAME_WAY_BACK) else steering), throttle

    def _stick(self, channel: int) -> float:
        params, pwm = self.params, self.rc.pwm[channel - 1]
        low, middle, high, dead = (params[f"RC{channel}_{part}"] for part in ("MIN", "TRIM", "MAX", "DZ"))
        if pwm > middle + dead:
            value = (pwm - middle - dead) / max(high - middle - dead, 1.0)
        elif pwm < middle - dead:
            value = (pwm - middle + dead) / max(middle - dead - low, 1.0)
        else:
            value = 0.0
        value = min(max(value, -1.0), 1.0)
        return -value if params[f"RC{channel}_REVERSED"] else value

    def nudged(self, speed: float) -> float:
        """A speed of its own choice, or more in the same direction where the throttle stick asks for that."""
        if not 5.0 <= self.params["CRUISE_THROTTLE"] <= 100.0:
            return speed
        asked = self.sticks()[1] * self.fastest
        return min(speed, asked) if speed < 0.0 else max(speed, asked)

    # ---- what it can be told

    def stop(self) -> None:
        """A controlled stop without a turn."""
        self.sp.stop()

    def mode_refusal(self, mode: Mode) -> str:
        return mode.blocked() if isinstance(mode, RoverMode) else ""

    def refusal_text(self, mode: Mode, why: str) -> str:
        return "Flight mode change failed"

    def change_speed(self, limit: str, value: float) -> None:
        if limit == "speed":
            self.driving_mode.set_speed(value)

    def arm(self, *, forced: bool = False) -> bool:
        if self.armed:
            return True
        faults = mandatory_faults(self) if forced else self._arming_faults()
        for fault in faults:
            self.say(CRITICAL, f"Arm: {fault}")
        if faults:
            return False
        self.armed, self.ever_armed, self.landed = True, True, False
        self._armed_at = self.now
        self.say(INFO, self.ARMING_TEXTS[0])
        self.sp.power(True)
        self.fence.on_arming()
        self.mode.on_arming()
        return True

    def _arming_faults(self) -> list[str]:
        faults = prearm_faults(self)
        if not faults and not self.mode.armable:
            faults = ["Mode not armable"]
        if faults or not int(self.params["ARMING_CHECK"]) or self.failsafes.no_radio:
            return faults
        sticks = (("Roll", 1), ("Throttle", 3))
        return [f"{name} (RC{channel}) is not neutral" for name, channel in sticks if self._stick(channel)]

    def disarm(self, *, forced: bool = False) -> bool:
        """A rover may be disarmed wherever it is; AUTO keeps its place in the mission."""
        if not self.armed:
            return True
        self.armed = self.auto_armed = False
        self.landed = True
        self.on_disarm()
        self.say(INFO, self.ARMING_TEXTS[1])
        if self.mode is not self.auto:
            self.mission.reset()
        return True

    def on_disarm(self) -> None:
        self.sp.power(False)

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if self.mode is self.initialising and self.boot.has("initialised"):
            self.set_mode(int(self.params["INITIAL_MODE"]))
            self.follow_switch()
        if self._ticks % RADIO_EVERY == 0:
            self.failsafes.watch_radio()

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.failsafes.watch_gcs()
        self.failsafes.watch_crash()
        if not self.armed and self.now >= self._home_due and not self._home_locked:
            self._home_due = self.now + HOME_EVERY_S
            if self.boot.has("origin") and self.from_home >= HOME_MOVED_M:
                self.move_home(None)

    def watch_ground(self) -> None:
        """It is on the ground, and leaves it never."""

    def param_changed(self, name: str, value: float) -> None:
        if name in BY_PARAM:
            row, factor = BY_PARAM[name]
            self.sp.tune(row, value * factor)
