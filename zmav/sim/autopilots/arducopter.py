"""One ArduCopter: its state machine, from boot to disarm. What it says and hears is in :mod:`zmav.sim.protocol`."""

from __future__ import annotations

from collections.abc import Callable

from zmav.sim.autopilots.arming import arming_faults, prearm_faults
from zmav.sim.autopilots.boot import Boot, Stage
from zmav.sim.autopilots.failsafe import GcsFailsafe
from zmav.sim.autopilots.guided import Guided
from zmav.sim.autopilots.heading import Heading
from zmav.sim.autopilots.modes import AltHold, Auto, Brake, Land, Loiter, Mode, Rtl, Stabilize
from zmav.sim.autopilots.pilot import Pilot
from zmav.sim.control.setpoints import SetpointHandle, Spool, Vector
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.fleet import Sense
from zmav.sim.geo import Position, from_ned
from zmav.sim.protocol.params import ParamStore

EMERGENCY, ALERT, CRITICAL, ERROR, WARNING, NOTICE, INFO, DEBUG = range(8)  # MAV_SEVERITY

LANDED_AFTER_S = 1.0  # of standing on the ground without thrust
LOW_THRUST_SHARE = 0.65  # of the hover throttle
PREARM_REMINDER_S = 30.0
HARD_TOUCH = 0.25  # m/s
HIGHEST_M = 80_000.0

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


class ArduCopter:
    """Modes, arming, landing and failsafes of one vehicle.

    The world calls :meth:`update` at every autopilot tick with the time and what the vehicle senses.
    ``say(severity, text)`` and ``beat()`` (a heartbeat out of turn) are the protocol's, and so is ``announce()``,
    which sends home and origin.
    """

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
        self.params = params
        self.sp = setpoint
        self.sense = sense
        self.world = world  # the origin of the world's NED
        self.origin_world: Vector = (
            sense.true_north,
            sense.true_east,
            sense.true_down,
        )  # of the EKF, in the world's NED
        self.home_world: Vector = self.origin_world
        self.now = 0.0
        self.pilot = Pilot()
        self.heading = Heading(setpoint)
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.beat: Callable[[], None] = lambda: None
        self.announce: Callable[[], None] = lambda: None
        self.guided = Guided(self)
        modes: list[Mode] = [m(self) for m in (Stabilize, AltHold, Auto, Loiter, Rtl, Land, Brake)]
        self.modes: dict[int, Mode] = {m.number: m for m in [*modes, self.guided]}
        self._ready_s = ready_s
        self.power_on()
        for name in _LIMITS:
            self._param_changed(name, params[name])
        params.changed = self._param_changed

    def power_on(self) -> None:
        """Start from nothing, as after a reset: not armed, no estimate yet."""
        self.booted_at = self.now
        self.boot = Boot(self._ready_s)
        self.armed = False
        self.landed = True
        self.failsafe = False
        switched = self.modes.get(int(self.params[f"FLTMODE{self.pilot.switch}"]))
        self.mode: Mode = switched or self.modes[0]
        self.gcs = GcsFailsafe(self)
        self.consumed_mah = 0.0
        self._switch = self.pilot.switch
        self._quiet_since: float | None = None
        self._idle_since = self.now
        self._reminded = self.now
        self.sp.spool(Spool.OFF)

    # ---- what it knows

    @property
    def uptime(self) -> float:
        """Seconds since its own boot."""
        return self.now - self.booted_at

    @property
    def position_ok(self) -> bool:
        """The EKF holds a position good enough to fly by."""
        return self.boot.has("position")

    @property
    def hover_thrust(self) -> float:
        """Share of full thrust that carries the weight."""
        return self.airframe.hover_thrust_n / self.airframe.thrust_max_n

    @property
    def local(self) -> Vector:
        """Position about the EKF origin, metres NED."""
        o, s = self.origin_world, self.sense
        return s.north - o[0], s.east - o[1], s.down - o[2]

    @property
    def position(self) -> Position:
        return from_ned(self.sense.north, self.sense.east, self.sense.down, self.world)

    def place(self, world: Vector) -> Position:
        """A point of the world's NED, in degrees."""
        return from_ned(*world, self.world)

    @property
    def system_status(self) -> int:
        """MAV_STATE: boot, critical (failsafe), standby (landed) or active."""
        if not self.boot.has("initialised"):
            return 1
        if self.failsafe:
            return 5
        return 3 if self.landed else 4

    # ---- what it can be told

    def set_mode(self, number: int) -> bool:
        """Change mode; says why where it does not."""
        mode = self.modes.get(number)
        if mode is None:
            self.say(WARNING, f"No such mode {number}")
            return False
        if mode is self.mode:
            return True
        if self.armed:
            refusal = mode.refusal()
            if not refusal and mode.needs_position and not self.position_ok:
                refusal = "requires position"
            if refusal:
                self.say(WARNING, f"Mode change to {mode.name} failed: {refusal}")
                return False
        self.mode = mode
        self.sp.limit("speed", self.params["WPNAV_SPEED"] * 0.01)
        mode.enter()
        self.beat()
        return True

    def arm(self, *, forced: bool = False) -> bool:
        """Arm the motors; says why where it does not. ``forced`` skips all checks but the mandatory ones."""
        if self.armed:
            return True
        faults = arming_faults(self, forced=forced)
        for fault in faults:
            self.say(CRITICAL, f"Arm: {fault}")
        if faults:
            return False
        self.armed = True
        self._idle_since = self.now
        if self.boot.has("origin"):
            self.home_world = (self.sense.north, self.sense.east, self.sense.down)
            self.announce()
        self.say(INFO, "Arming motors")
        self.mode.enter()
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """Stop the motors; refused in the air unless forced."""
        if not self.armed:
            return True
        if not self.landed and not forced:
            return False
        self.armed = False
        self.failsafe = False
        self.landed = True
        self.sp.spool(Spool.OFF)
        self.say(INFO, "Disarming motors")
        return True

    def take_off(self, height: float) -> bool:
        """Rise to ``height`` metres above home: GUIDED, armed and on the ground only."""
        ready = self.armed and self.landed and self.mode is self.guided and self.position_ok
        if not ready or not 0.0 < height < HIGHEST_M:
            return False
        down = self.home_world[2] - height
        if down > self.sense.down - 0.1:
            return False
        self.guided.take_off(down)
        return True

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        """One tick of the state machine."""
        self.now, self.sense = now, sense
        for stage in self.boot.advance(self.uptime):
            self._wake(stage)
        self._follow_switch()
        self.consumed_mah += sense.current_a * dt / 3.6
        if sense.impact > HARD_TOUCH:
            self.say(INFO, f"SIM Hit ground at {sense.impact:.6f} m/s")
        self.gcs.update()
        if not self.armed:
            self._remind()
            return
        self._watch_ground()
        self._disarm_idle()
        if self.armed:
            self.mode.update()
            self.heading.update(sense)

    def _wake(self, stage: Stage) -> None:
        for text in stage.text:
            self.say(stage.severity, text)
        if stage.event == "origin":
            self.announce()
            self.say(INFO, f"Field Elevation Set: {self.place(self.home_world).alt_amsl_m:.0f}m")

    def _follow_switch(self) -> None:
        """A turn of the pilot's mode switch changes the mode."""
        switch = self.pilot.switch
        if switch != self._switch:
            self._switch = switch
            self.set_mode(int(self.params[f"FLTMODE{switch}"]))

    def _watch_ground(self) -> None:
        """Landed: on the ground with hardly any thrust for a while. In the air: once the ground is left."""
        sense = self.sense
        if self.landed:
            if not sense.contact and sense.throttle > 0.5 * self.airframe.hover_throttle:
                self.landed = False
                self._quiet_since = None
            return
        if sense.contact and sense.throttle < LOW_THRUST_SHARE * self.airframe.hover_throttle and abs(sense.vd) < 1.0:
            self._quiet_since = self.now if self._quiet_since is None else self._quiet_since
            if self.now - self._quiet_since >= LANDED_AFTER_S:
                self.landed = True
                self._idle_since = self.now
        else:
            self._quiet_since = None

    def _disarm_idle(self) -> None:
        """Disarm after a landing, and after DISARM_DELAY of standing armed with the throttle down."""
        busy = not self.landed or (self.guided.taking_off and self.mode is self.guided)
        if busy or (self.mode.by_pilot and self.pilot.throttle > 0.05):
            self._idle_since = self.now
            return
        delay = self.params["DISARM_DELAY"]
        if isinstance(self.mode, (Land, Rtl)):
            delay = LANDED_AFTER_S
        elif delay <= 0:
            return
        if self.now - self._idle_since >= delay:
            self.disarm()

    def _remind(self) -> None:
        """Say every half minute why arming would be refused."""
        if self.boot.has("initialised") and self.now - self._reminded >= PREARM_REMINDER_S:
            self._reminded = self.now
            for fault in prearm_faults(self):
                self.say(CRITICAL, f"PreArm: {fault}")

    def _param_changed(self, name: str, value: float) -> None:
        if name in _LIMITS:
            limit, factor = _LIMITS[name]
            self.sp.limit(limit, value * factor)
