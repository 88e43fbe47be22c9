"""One ArduRover: its modes and failsafes, put together."""

from __future__ import annotations

from zmav.sim.autopilots.ardupilot.state import CRITICAL, INFO, Mode, Reactions
from zmav.sim.autopilots.ardurover.auto import Auto
from zmav.sim.autopilots.ardurover.base import RoverBase
from zmav.sim.autopilots.ardurover.failsafe import Failsafe, GcsWatch, RoverReactions
from zmav.sim.autopilots.ardurover.modes import Guided, Hold, Initialising, Loiter, Manual, RoverMode, Rtl
from zmav.sim.autopilots.ardurover.travel import Travel
from zmav.sim.fleets.base import Sense

CALIBRATING, STANDBY, ACTIVE, CRITICAL_STATE = 2, 3, 4, 5  # MAV_STATE
HOME_EVERY_S, HOME_MOVED_M = 1.0, 0.5
RADIO_EVERY = 2  # ticks
MIDDLE = 1500


class ArduRover(RoverBase):
    """Drives one rover of the :class:`~zmav.sim.fleets.rover.RoverFleet`."""

    auto: Auto
    guided: Guided

    def make_modes(self) -> list[Mode]:
        self.pilot.pwm[2] = self.pilot.pwm[3] = MIDDLE
        travel = Travel(self)
        rtl, loiter = Rtl(self, travel), Loiter(self, travel)
        self.initialising = Initialising(self, travel)
        self.guided, self.auto = Guided(self, travel), Auto(self, travel, rtl, loiter)
        return [Manual(self, travel), Hold(self, travel), rtl, loiter, self.initialising, self.guided, self.auto]

    def make_reactions(self) -> Reactions:
        self.rover_reactions = RoverReactions(self)
        return self.rover_reactions

    def on_power(self) -> None:
        self.mode = self.initialising
        watched = GcsWatch(self, self.rc)
        self.gcs = watched
        self.failsafes = Failsafe(self, self.rover_reactions, watched)
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
    def no_radio(self) -> bool:
        return self.failsafes.no_radio

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

    # ---- what it can be told

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
        faults = self.mandatory_faults() if forced else self._arming_faults()
        for fault in faults:
            self.say(CRITICAL, f"Arm: {fault}")
        if faults:
            return False
        self.armed, self.ever_armed, self.landed = True, True, False
        self._armed_at = self.now
        self.say(INFO, self.ARMING_TEXTS[0])
        self.sp.power(True)
        self.mode.on_arming()
        return True

    def _arming_faults(self) -> list[str]:
        faults = self.prearm_faults()
        if not faults and not self.mode.armable:
            faults = ["Mode not armable"]
        if faults or not int(self.params["ARMING_CHECK"]) or self.no_radio:
            return faults
        sticks = (("Roll", 1), ("Throttle", 3))
        return [f"{name} (RC{channel}) is not neutral" for name, channel in sticks if self.stick(channel)]

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
        if not self.armed and self.now >= self._home_due and not self._home_locked:
            self._home_due = self.now + HOME_EVERY_S
            if self.boot.has("origin") and self.from_home >= HOME_MOVED_M:
                self.move_home(None)
