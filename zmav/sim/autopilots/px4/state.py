"""What the parts of a PX4 know of their vehicle; they are put together in :mod:`.copter`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from zmav.sim.autopilots.base import Autopilot, Installation
from zmav.sim.autopilots.px4.events import Event
from zmav.sim.autopilots.px4.modes import HOLD, Mode
from zmav.sim.autopilots.px4.tuning import Tuning
from zmav.sim.control.setpoints import Axis, SetpointHandle
from zmav.sim.dynamics.airframe import Airframe

REAL_READY_S = 4.0  # from boot to arming, as measured: it is not slower where an ArduPilot beside it is
HOME_SHARE = 0.9  # of that, home is known
_AUTO_LIMITS = {
    "speed": "MPC_XY_CRUISE",
    "speed_up": "MPC_Z_V_AUTO_UP",
    "speed_down": "MPC_Z_V_AUTO_DN",
    "accel": "MPC_ACC_HOR",
    "accel_z": "MPC_ACC_DOWN_MAX",
    "jerk": "MPC_JERK_AUTO",
    "jerk_z": "MPC_JERK_AUTO",
}


class Px4State(Autopilot, ABC):
    """One vehicle, as its parts see it. ``wanted`` is the mode asked for, ``mode`` the one that flies: a failsafe's,
    where one acts. ``event`` is the protocol's.
    """

    def __init__(self, into: Installation[Airframe, SetpointHandle]) -> None:
        super().__init__(into)
        self.airframe, self.sp = into.airframe, into.setpoint
        self.event: Callable[[Event, bytes], None] = lambda event, arguments: None
        self.tuning = Tuning(self.params, self.sp, self.airframe)
        self._ready_s = min(into.ready_s, REAL_READY_S)
        self.wanted: Mode = HOLD
        self.mode: Mode = HOLD
        self.armed_at = 0.0
        self.intents = 0  # how often a mode was asked for
        self.cruise_speed: float | None = None
        self.make_parts()
        self.power_on()

    @abstractmethod
    def make_parts(self) -> None:
        """Make those that are kept over a reboot."""

    @abstractmethod
    def power_on(self) -> None:
        """Start from nothing, as after a reset."""

    @property
    def booted(self) -> bool:
        """All its parts have begun."""
        return self.uptime >= self._ready_s

    @property
    def has_home(self) -> bool:
        """There has been a position since boot: home is set."""
        return self.uptime >= HOME_SHARE * self._ready_s

    @property
    @abstractmethod
    def position_ok(self) -> bool:
        """The estimator holds a position."""

    @property
    @abstractmethod
    def landed(self) -> bool:
        """On the ground, as the land detector has it."""

    @property
    @abstractmethod
    def flies(self) -> bool:
        """OFFBOARD has the vehicle, off the ground."""

    @abstractmethod
    def set_mode(self, mode: Mode) -> bool:
        """Ask for a mode; disarmed any will do, armed only one that can fly now."""

    @abstractmethod
    def took_off(self) -> None:
        """The land detector saw it leave the ground."""

    @abstractmethod
    def touched_down(self) -> None:
        """The land detector has it on the ground."""

    def stop_here(self) -> None:
        """Brake to a stop and stay there, nose as it is."""
        self.sp.raw(False)
        self.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.sp.heading(self.sense.yaw)

    def limit(self, table: dict[str, str]) -> None:
        for limit, param in table.items():
            self.sp.limit(limit, self.params[param])

    def limit_auto(self) -> None:
        """The limits of the AUTO modes, with the speed that DO_CHANGE_SPEED asked for."""
        self.limit(_AUTO_LIMITS)
        if self.cruise_speed is not None:
            self.sp.limit("speed", min(self.cruise_speed, self.params["MPC_XY_VEL_MAX"]))

    def tell(self, event: Event, arguments: bytes = b"") -> None:
        """An event, and its words to ground stations."""
        self.event(event, arguments)
        if event.text:
            self.say(event.severity, event.text)
