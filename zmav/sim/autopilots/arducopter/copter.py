"""One ArduCopter: what it has beside other ArduPilots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.arducopter.auto import Auto
from zmav.sim.autopilots.arducopter.crash import ANGLE_ERROR_DEG, CrashCheck
from zmav.sim.autopilots.arducopter.guided import Guided
from zmav.sim.autopilots.arducopter.heading import Heading
from zmav.sim.autopilots.arducopter.modes import AltHold, Brake, Land, Loiter, Rtl, Stabilize
from zmav.sim.autopilots.arducopter.reactions import CopterReactions
from zmav.sim.autopilots.arducopter.travel import Travel
from zmav.sim.autopilots.arducopter.tuning import GAINS, HIGHEST
from zmav.sim.autopilots.ardupilot.mode import Mode
from zmav.sim.autopilots.ardupilot.reactions import Reactions
from zmav.sim.autopilots.ardupilot.vehicle import INFO, ArduVehicle
from zmav.sim.control.setpoints import SetpointHandle, Spool, Vector
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position
from zmav.sim.protocol.params import ParamStore

LANDED_AFTER_S = 1.0  # of standing on the ground without thrust
SOFTENED_AFTER_S = 0.2  # of that, from which on a landing gives up its place
LOW_THRUST_SHARE = 0.65  # of the hover throttle
HARD_TOUCH = 0.25  # m/s
MAV_TYPE_QUADROTOR, MAV_TYPE_HEXAROTOR = 2, 13
HIGHEST_M = 80_000.0
# To thrust, as measured: from the order to lift off, and from arming (after which the motors stand still for 2 s).
SPOOL_UP_S, ARMING_S = 2.0, 3.2

# Parameter -> (limit of the cascade, factor to SI).
_LIMITS = {
    "WPNAV_SPEED": ("speed", 0.01),
    "WPNAV_SPEED_UP": ("speed_up", 0.01),
    "WPNAV_SPEED_DN": ("speed_down", 0.01),
    "WPNAV_ACCEL": ("accel", 0.01),
    "WPNAV_ACCEL_Z": ("accel_z", 0.01),
    "PSC_JERK_XY": ("jerk", 1.0),
    "PSC_JERK_Z": ("jerk_z", 1.0),
    "ANGLE_MAX": ("lean", 0.01 * 3.141592653589793 / 180.0),
    "ATC_SLEW_YAW": ("yaw_slew", 0.01 * 3.141592653589793 / 180.0),
}


class ArduCopter(ArduVehicle):
    """Flies one multirotor of the :class:`~zmav.sim.fleets.copter.CopterFleet`."""

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

    auto: Auto
    guided: Guided

    def __init__(
        self,
        airframe: Airframe,
        params: ParamStore,
        setpoint: SetpointHandle,
        sense: Sense,
        world: Position,
        ready_s: float,
    ) -> None:
        self.airframe = airframe
        self.MOTORS = len(airframe.rotors)
        hexa = self.MOTORS == 6
        self.MAV_TYPE = MAV_TYPE_HEXAROTOR if hexa else MAV_TYPE_QUADROTOR
        self.FRAME = "HEXA/X" if hexa else "QUAD/PLUS"
        self.sp = setpoint
        self.speeds: dict[str, float] = {}  # chosen for this mode: limits of the cascade, m/s
        self.heading = Heading(setpoint)
        super().__init__(params, sense, world, ready_s)
        for name in (*_LIMITS, *GAINS):
            self.param_changed(name, params[name])

    def make_modes(self) -> list[Mode]:
        self.travel = Travel(self)
        self.guided, self.auto, self.land, self.rtl = Guided(self), Auto(self), Land(self), Rtl(self)
        modes: list[Mode] = [kind(self) for kind in (Stabilize, AltHold, Loiter, Brake)]
        return [*modes, self.guided, self.auto, self.land, self.rtl]

    def make_reactions(self) -> Reactions:
        return CopterReactions(self)

    def on_power(self) -> None:
        self._quiet_since: float | None = None
        self._idle_since = self._landed_at = self.now
        self.crash_check = CrashCheck(self)
        self._choose_speeds()
        self.on_disarm()

    # ---- what it knows

    @property
    def taking_off(self) -> bool:
        if self.mode is self.guided:
            return self.guided.taking_off
        return self.mode is self.auto and self.auto.taking_off

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

    @property
    def hover_thrust(self) -> float:
        """Share of full thrust that carries the weight."""
        return self.airframe.hover_thrust_n / self.airframe.thrust_max_n

    # ---- what it can be told

    def mode_refusal(self, mode: Mode) -> str:
        return "in RC failsafe" if self.rc.lost and mode.manual_throttle else ""

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

    def region_of_interest(self, place: Vector | None) -> None:
        """Look at a point of the world's NED; None: no longer. With a gimbal that turns, the nose is left alone."""
        if self.payload.gimbal.present:
            self.payload.gimbal.point(place)
        elif place is None:
            self.heading.hold(self.sense.yaw)
            self.heading.along(self.params["WP_YAW_BEHAVIOR"], self.sense.yaw)
        else:
            self.heading.watch(place[0], place[1])

    def spool(self) -> bool:
        """Motors up in the air, idle on the ground. True in the air."""
        self.sp.spool(Spool.IDLE if self.landed else Spool.FLY)
        return not self.landed

    def arm(self, *, forced: bool = False) -> bool:
        if self.armed:
            return True
        self._idle_since = self.now
        return super().arm(forced=forced)

    def on_disarm(self) -> None:
        self.sp.spool(Spool.OFF)

    def take_off(self, height: float) -> bool:
        """Rise to ``height`` metres above home: GUIDED, armed and on the ground only."""
        ready = self.armed and self.landed and self.mode is self.guided and self.position_ok
        if not ready or not 0.0 < height < HIGHEST_M:
            return False
        down = self.home_world[2] - height
        if down > self.sense.down - 0.1:
            return False
        self.auto_armed = True
        self.guided.take_off(down)
        return True

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if sense.impact > HARD_TOUCH:
            self.say(INFO, f"SIM Hit ground at {sense.impact:.6f} m/s")
        if self.armed:
            self.heading.update(sense, dt)

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.crash_check.update(dt)
        if self.armed:
            if self.rc.throttle > 0.03:
                self.auto_armed = True
            elif self.mode.manual_throttle and self.rc.valid:
                self.auto_armed = False

    def watch_ground(self) -> None:
        self._watch_contact()
        self._disarm_idle()

    def _watch_contact(self) -> None:
        """Landed: on the ground with hardly any thrust for a while. In the air: once the ground is left."""
        sense = self.sense
        if self.landed:
            if not sense.contact and sense.throttle > 0.5 * self.airframe.hover_throttle:
                self.landed = False
                self._quiet_since = None
            return
        quiet = sense.throttle < LOW_THRUST_SHARE * self.airframe.hover_throttle and abs(sense.vd) < 1.0
        if sense.contact and quiet and self.crash_check.off_deg <= ANGLE_ERROR_DEG:
            self._quiet_since = self.now if self._quiet_since is None else self._quiet_since
            if self.now - self._quiet_since >= LANDED_AFTER_S:
                self.landed = True
                self._idle_since = self._landed_at = self.now
        else:
            self._quiet_since = None

    def _disarm_idle(self) -> None:
        """Disarm after a landing, and after DISARM_DELAY of standing armed with the throttle down."""
        lands = isinstance(self.mode, (Land, Rtl))  # whatever the throttle stick says
        if not self.landed or self.taking_off or (self.rc.throttle > 0.05 and not lands):
            self._idle_since = self.now
            return
        delay = self.params["DISARM_DELAY"]
        if lands:
            delay = LANDED_AFTER_S
        elif delay <= 0:
            return
        if self.now - self._idle_since >= delay:
            self.disarm()

    def param_changed(self, name: str, value: float) -> None:
        if name in GAINS:
            gain, axes, factor = GAINS[name]
            self.sp.tune(gain, axes, min(max(value * factor, 0.0), HIGHEST))
        if name in _LIMITS:
            limit, factor = _LIMITS[name]
            if limit in self.speeds:
                self.change_speed(limit, value * factor)
            else:
                self.sp.limit(limit, value * factor)
