"""One ArduPlane: its modes, put together, and what it takes for flying."""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.boot import Stage as BootStage
from zmav.sim.autopilots.ardupilot.state import INFO, Mode
from zmav.sim.autopilots.arduplane import modes
from zmav.sim.autopilots.arduplane.auto import Auto, AutoLand
from zmav.sim.autopilots.arduplane.base import INITIALISING
from zmav.sim.autopilots.arduplane.landing import Landing
from zmav.sim.autopilots.arduplane.launch import Launch
from zmav.sim.autopilots.arduplane.modes import Guided, PlaneMode, PlaneParts
from zmav.sim.autopilots.arduplane.reactions import PlaneReactions
from zmav.sim.autopilots.arduplane.way import Way
from zmav.sim.fleets.base import Sense

QUADPLANE_MODES = frozenset((17, 18, 19, 20, 21, 22, 23, 25))
FLYING_EVERY = 20  # ticks: how often it asks itself whether it flies
FLYING_KEEP = 0.85  # of that belief, a low-pass filter
MOVING = 1.5  # m/s
FAST_ENOUGH = 0.75  # of AIRSPEED_MIN, to fly
LAUNCHED_M, LAUNCHED_SPEED = 10.0, 5.0  # what ends the suppression of the engine
IN_AIR_S, IN_AIR_M = 5.0, 5.0
COURSE_SPEED = 5.0


class ArduPlane(PlaneParts):
    """Modes, arming, takeoff, landing and failsafes of one plane."""

    auto: Auto
    guided: Guided
    mode: PlaneMode
    reactions: PlaneReactions

    def make_modes(self) -> list[Mode]:
        self.way, self.launch = Way(self), Launch(self)
        self.landing = Landing(self, self.way)
        self.guided, self.auto = Guided(self), Auto(self)
        self.autoland, self.initialising = AutoLand(self), modes.Initialising(self)
        kinds: tuple[type[PlaneMode], ...] = (
            modes.Manual,
            modes.Circle,
            modes.FlyByWireA,
            modes.Rtl,
            modes.Loiter,
            modes.Takeoff,
        )
        return [*(kind(self) for kind in kinds), self.initialising, self.guided, self.auto, self.autoland]

    def make_reactions(self) -> PlaneReactions:
        return PlaneReactions(self)

    def on_power(self) -> None:
        super().on_power()
        self.way.power_on()
        self.launch.reset()
        self.landing.stop()
        self.reactions.reset()
        self._chosen_mode = self.mode
        self.mode = self.initialising

    def _wake(self, stage: BootStage) -> None:
        super()._wake(stage)
        if stage.event == "initialised" and self.mode.number == INITIALISING:
            self.set_mode(self._chosen_mode.number)

    def on_disarm(self) -> None:
        super().on_disarm()
        self.launch.reset()

    @property
    def taking_off(self) -> bool:
        if self.mode is self.auto:
            return self.auto.taking_off
        return isinstance(self.mode, modes.Takeoff) and self.mode.rising

    @property
    def system_status(self) -> int:
        """MAV_STATE: calibrating, critical (failsafe), standby (not flying) or active."""
        if self.mode.number == INITIALISING:
            return 2
        if self.reactions.state or self.rc.lost or self.battery.failed or self.ekf.active:
            return 5
        return 4 if self.flying else 3

    # ---- what it can be told

    def set_mode(self, number: int, *, by_fence: bool = False) -> bool:
        """Change mode; says why where it does not."""
        if number in QUADPLANE_MODES:
            self.say(INFO, "Q_ENABLE 0")
            return False
        return super().set_mode(number, by_fence=by_fence)

    def refusal_text(self, mode: Mode, why: str) -> str:
        fenced = why == "in fence recovery"
        return f"Mode change to {mode.name} denied, {why}" if fenced else "Flight mode change failed"

    def mode_changed(self) -> None:
        if not self.flying:
            self.throttle_suppressed = True

    # ---- what it does by itself

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.reactions.update()

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if self._ticks % FLYING_EVERY == 0:
            self._believe_flying()
        if self.on_turn:
            moves = self._flying > 0.0 or not self.throttle_suppressed or self.rc.throttle > 0.0
            self.sp.flying(self.armed and moves)

    def watch_ground(self) -> None:
        """The engine stays off until the launch; AUTOLAND's direction is that of the first course flown."""
        if self.throttle_suppressed and self.on_turn:
            self.throttle_suppressed = not self._launched()
        captures = self.takeoff_direction is None and (self.mode.captures_direction or self.taking_off)
        if captures and self.flying and self.groundspeed > COURSE_SPEED:
            course = math.atan2(self.sense.ve, self.sense.vn) + math.radians(self.params["AUTOLAND_DIR_OFF"])
            self.takeoff_direction = course
            self.say(INFO, f"Autoland direction= {int(math.degrees(course) % 360.0)}")

    def _launched(self) -> bool:
        """Whether the engine may run, in a mode that runs it by itself."""
        if not self.mode.auto_throttle:
            return True
        moving = self.groundspeed >= LAUNCHED_SPEED
        if isinstance(self.mode, modes.Takeoff) or (self.mode is self.auto and not self.taken_off):
            long = self.flying and self.now - self.flying_since > IN_AIR_S
            if long and self.height > IN_AIR_M and moving and abs(self.sense.pitch) < math.radians(30.0):
                return True
            return self.launch.released()
        return abs(self.height) >= LAUNCHED_M or (moving and self.eas >= LAUNCHED_SPEED)

    def _believe_flying(self) -> None:
        """Five times a second: moving through the air, or over the ground, is flying."""
        fast = self.eas >= FAST_ENOUGH * max(self.params["AIRSPEED_MIN"], 2.0)
        moving = self.gps_ok and self.groundspeed >= MOVING
        now = (fast or moving) if self.armed else (fast and moving)
        if self.armed and self.landing.active and self.landing.leg == 1 and self.sense.vd > 0.2:
            now = True
        if not self.armed and self.landing.flaring:
            now = False
        before = self.flying
        self._flying = FLYING_KEEP * self._flying + (1.0 - FLYING_KEEP) * now
        if self.flying:
            self.last_flying = self.now
            if not before:
                self.flying_since = self.now
        self.landed = not self.flying
