"""One ArduRover: its modes and failsafes, put together."""

from __future__ import annotations

from zmav.sim.autopilots.ardupilot.failsafe import GcsFailsafe
from zmav.sim.autopilots.ardupilot.state import Mode
from zmav.sim.autopilots.ardurover.auto import Auto
from zmav.sim.autopilots.ardurover.base import RoverBase
from zmav.sim.autopilots.ardurover.failsafe import RoverReactions
from zmav.sim.autopilots.ardurover.modes import Guided, Hold, Initialising, Loiter, Manual, RoverMode, Rtl
from zmav.sim.autopilots.ardurover.travel import Travel
from zmav.sim.fleets.base import Sense

CALIBRATING, STANDBY, ACTIVE, CRITICAL_STATE = 2, 3, 4, 5  # MAV_STATE
HOME_EVERY_S, HOME_MOVED_M = 1.0, 0.5
MIDDLE = 1500


class ArduRover(RoverBase):
    """Drives one rover of the :class:`~zmav.sim.fleets.rover.RoverFleet`."""

    auto: Auto
    guided: Guided
    mode: RoverMode
    reactions: RoverReactions

    def make_modes(self) -> list[Mode]:
        self.pilot.pwm[2] = self.pilot.pwm[3] = MIDDLE
        travel = Travel(self)
        rtl, loiter = Rtl(self, travel), Loiter(self, travel)
        self.initialising = Initialising(self, travel)
        self.guided, self.auto = Guided(self, travel), Auto(self, travel, rtl, loiter)
        return [Manual(self, travel), Hold(self, travel), rtl, loiter, self.initialising, self.guided, self.auto]

    def make_reactions(self) -> RoverReactions:
        return RoverReactions(self)

    def on_power(self) -> None:
        self.mode = self.initialising
        self.gcs = GcsFailsafe(self, self.rc, acts=False)
        self.reactions.reset()
        self.ever_armed = False
        self._home_due = self.now
        self.sp.power(False)
        self.sp.coast()

    # ---- what it knows

    @property
    def no_radio(self) -> bool:
        return self.reactions.no_radio

    @property
    def failsafe(self) -> bool:
        return bool(self.reactions.triggered) or self.ekf.active

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return CRITICAL_STATE
        if self.mode is self.initialising:
            return CALIBRATING
        return STANDBY if isinstance(self.mode, Hold) else ACTIVE

    # ---- what it can be told

    def refusal_text(self, mode: Mode, why: str) -> str:
        return "Flight mode change failed"

    def change_speed(self, limit: str, value: float) -> None:
        if limit == "speed":
            self.mode.set_speed(value)

    def arming_faults(self, *, forced: bool) -> list[str]:
        faults = self.mandatory_faults() if forced else self.prearm_faults()
        if faults or forced:
            return faults
        if not self.mode.armable:
            return ["Mode not armable"]
        if not int(self.params["ARMING_CHECK"]) or self.no_radio:
            return []
        sticks = (("Roll", 1), ("Throttle", 3))
        return [f"{name} (RC{channel}) is not neutral" for name, channel in sticks if self.stick(channel)]

    def on_arm(self) -> None:
        self.ever_armed, self.landed = True, False
        self.sp.power(True)

    def disarm(self, *, forced: bool = False) -> bool:
        """A rover may be disarmed wherever it is."""
        return super().disarm(forced=True)

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if self.mode is self.initialising and self.boot.has("initialised"):
            self.set_mode(int(self.params["INITIAL_MODE"]))
            self.follow_switch()
        self.reactions.watch_radio()

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.reactions.watch_gcs()
        if not self.armed and self.now >= self._home_due and not self._home_locked:
            self._home_due = self.now + HOME_EVERY_S
            if self.boot.has("origin") and self.from_home >= HOME_MOVED_M:
                self.move_home(None)
