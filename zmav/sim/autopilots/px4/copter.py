"""One PX4 multicopter: its commander, from boot to disarm. What it says is in :mod:`zmav.sim.protocol.px4`."""

from __future__ import annotations

from collections.abc import Callable

from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.events import Event
from zmav.sim.autopilots.px4.failsafe import Failsafe
from zmav.sim.autopilots.px4.ground import Ground, Stage
from zmav.sim.autopilots.px4.items import FenceItems, RallyItems
from zmav.sim.autopilots.px4.mission import Mission
from zmav.sim.autopilots.px4.modes import HOLD, MISSION, OFFBOARD, SWITCH, TERMINATION, Mode
from zmav.sim.autopilots.px4.navigator import Navigator
from zmav.sim.autopilots.px4.offboard import Motion, Offboard
from zmav.sim.autopilots.px4.sticks import Sticks
from zmav.sim.autopilots.px4.tuning import Tuning
from zmav.sim.control.setpoints import Axis, SetpointHandle, Spool, Vector
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.dynamics.battery import BatteryHandle
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position, from_ned
from zmav.sim.protocol.params import ParamStore

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
_STREAM_LIMITS = {"speed": "MPC_XY_VEL_MAX", "speed_up": "MPC_Z_VEL_MAX_UP", "speed_down": "MPC_Z_VEL_MAX_DN"}
_DEGREES = 3.141592653589793 / 180.0


class Px4Copter:
    """Modes, arming, landing and failsafes of one vehicle.

    ``wanted`` is the mode asked for, ``mode`` the one that flies: a failsafe's, where one acts. The world calls
    :meth:`update` at every tick. ``say``, ``beat`` and ``announce`` are the protocol's, and so is ``event``.
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
        self.origin_world: Vector = (sense.true_north, sense.true_east, sense.true_down)  # of the EKF
        self.home_world: Vector = self.origin_world
        self.now = 0.0
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.beat: Callable[[], None] = lambda: None
        self.announce: Callable[[], None] = lambda: None
        self.event: Callable[[Event, bytes], None] = lambda event, arguments: None
        self.tuning = Tuning(params, setpoint, airframe)
        self.power = BatteryHandle.bench()
        self._ready_s = min(ready_s, REAL_READY_S)
        self.mission = Mission(self)  # what is kept over a reboot, as the parameters are
        self.fence, self.rally = FenceItems(), RallyItems()
        self.power_on()

    def power_on(self) -> None:
        """Start from nothing, as after a reset."""
        self.booted_at = self.now
        self.armed = False
        self.armed_at = 0.0
        self._consumed_before = self.power.consumed_mah
        self.cruise_speed: float | None = None
        self.wanted: Mode = HOLD
        self.mode: Mode = HOLD
        self._after_disarm: Mode = HOLD
        self.sticks = Sticks(self)
        self._switch = self.sticks.pilot.switch
        self.offboard = Offboard(self)
        self.navigator = Navigator(self)
        self.failsafe = Failsafe(self)
        self.ground = Ground(self)
        self._stood_since = self.now
        self._flew = False
        self._stream_reported = False
        self.sp.spool(Spool.OFF)
        self.sp.limit("lean", self.params["MPC_TILTMAX_AIR"] * _DEGREES)

    def plug(self, power: BatteryHandle) -> None:
        """Take the battery of the body that it sits in."""
        self.power = power

    # ---- what it knows

    @property
    def consumed_mah(self) -> float:
        """Since its own boot."""
        return self.power.consumed_mah - self._consumed_before

    @property
    def uptime(self) -> float:
        """Seconds since its own boot."""
        return self.now - self.booted_at

    @property
    def position_ok(self) -> bool:
        """The estimator holds a position, and home is set."""
        return self.uptime >= HOME_SHARE * self._ready_s

    @property
    def landed(self) -> bool:
        return self.ground.landed

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
        return self.place((self.sense.north, self.sense.east, self.sense.down))

    def place(self, world: Vector) -> Position:
        """A point of the world's NED, in degrees."""
        return from_ned(*world, self.world)

    @property
    def checks_ok(self) -> bool:
        """The pre-arm bit: what the mode asked for needs is there, and in flight nothing is lost."""
        if self.uptime < self._ready_s:
            return False
        if self.wanted is OFFBOARD and not self.offboard.alive:
            return False
        if self.params["NAV_DLL_ACT"] and self.failsafe.ground_lost:
            return False
        if self.wanted is MISSION and not self.mission.able:
            return False
        return self.position_ok or not self.wanted.position

    @property
    def system_status(self) -> int:
        """MAV_STATE: critical in a failsafe, active when armed, standby when ready to arm, else not ready."""
        if self.armed:
            return 5 if self.failsafe.active else 4
        return 3 if self.checks_ok else 0

    # ---- what it can be told

    def set_mode(self, mode: Mode) -> bool:
        """Ask for a mode; disarmed any will do, armed only one that can fly now."""
        if self.armed and not self._can_fly(mode):
            self.say(2, f"Switching to {mode.name.capitalize()} is currently not available\t")
            return False
        if self.wanted is TERMINATION:
            return False
        self.wanted = mode
        if mode.arms:
            self._after_disarm = mode
        if not self.failsafe.active:
            self._fly_in(mode)
        return True

    def _can_fly(self, mode: Mode) -> bool:
        if mode is OFFBOARD:
            return self.offboard.alive
        if mode is MISSION and not self.mission.able:
            return False
        return (self.position_ok or not mode.position) and (self.sticks.alive or not mode.manual)

    def arm(self, *, forced: bool = False) -> bool:
        """Arm the motors; the reason of a refusal goes out as an event."""
        if self.armed:
            return True
        able = self.checks_ok and self.wanted.arms and (self.sticks.alive or not self.wanted.manual)
        if not (able or forced):
            self._tell(events.ARM_DENIED)
            return False
        self.armed, self.armed_at, self._flew = True, self.now, False
        self._stood_since = self.now
        self.home_world = (self.sense.north, self.sense.east, self.sense.down)
        self.failsafe.armed()
        self._tell(events.ARMED, bytes([events.EXTERNAL]))
        self._fly_in(self.wanted)
        return True

    def disarm(self, *, forced: bool = False, reason: int = events.EXTERNAL) -> bool:
        """Stop the motors; refused in the air unless forced."""
        if not self.armed:
            return True
        if not (self.landed or forced):
            return False
        self.armed = False
        self.ground.reset()
        self.failsafe.reset()
        self.wanted = self.mode = self._after_disarm
        self.offboard.wish = None
        self.sp.spool(Spool.OFF)
        self.sp.raw(False)
        self.event(events.DISARMED, bytes([reason]))
        self.say(6, events.DISARM_TEXTS[reason])
        return True

    def stop_here(self) -> None:
        """Brake to a stop and stay there, nose as it is."""
        self.sp.raw(False)
        self.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.sp.heading(self.sense.yaw)

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        """One tick of the commander."""
        self.now, self.sense = now, sense
        self._follow_switch()
        self._report_checks()
        if not self.armed:
            return
        self._take_over()
        flying = self.failsafe.mode(self.wanted)
        if flying is None:
            self.disarm(forced=True)
            return
        if flying is not self.mode:
            self._fly_in(flying)
        self._control()
        self.ground.update(descends=self._descends())
        self._disarm_idle()

    def _fly_in(self, mode: Mode) -> None:
        self.mode = mode
        if mode is OFFBOARD:
            self.offboard.enter()
        else:
            self.navigator.enter(mode)

    def _control(self) -> None:
        """Hand this tick's targets to the controllers; on the ground the motors idle until something lifts it."""
        stage = self.ground.stage
        if stage is Stage.STANDING and self._lifts():
            self.ground.lift(at_once=(self.mode is OFFBOARD and self.offboard.by_thrust) or self.mode.manual)
            stage = self.ground.stage
        if stage in (Stage.STANDING, Stage.RAMP):
            self.sp.spool(Spool.IDLE)
        elif stage is Stage.TOUCHED:
            self.sp.spool(Spool.IDLE)
            if self._lifts():
                self.ground.lift(at_once=True)
        elif self.mode is TERMINATION:
            self.sp.spool(Spool.OFF)
        elif self.mode is OFFBOARD:
            self._limit(_STREAM_LIMITS)
            self.offboard.fly()
        elif self.mode.manual:
            self.sticks.fly(self.mode)
        else:
            self.navigator.fly()

    def _lifts(self) -> bool:
        if self.mode is OFFBOARD:
            return self.offboard.lifts
        return self.sticks.lifts(self.mode) if self.mode.manual else self.navigator.lifts

    def _descends(self) -> bool:
        """What is asked for ends at the ground."""
        if self.mode is OFFBOARD:
            wish = self.offboard.wish
            if isinstance(wish, Motion):
                z, vz = wish.pos[2], wish.vel[2]
                return (z is not None and z > self.sense.down + 0.1) or (z is None and vz is not None and vz > 0.1)
            return wish is not None and wish.thrust < 0.6 * self.hover_thrust
        if self.mode.manual:
            return not self.sticks.alive or self.sticks.descends(self.mode)
        return self.navigator.descends

    def _limit(self, table: dict[str, str]) -> None:
        for limit, param in table.items():
            self.sp.limit(limit, self.params[param])

    def limit_auto(self) -> None:
        """The limits of the AUTO modes, with the speed that DO_CHANGE_SPEED asked for."""
        self._limit(_AUTO_LIMITS)
        if self.cruise_speed is not None:
            self.sp.limit("speed", min(self.cruise_speed, self.params["MPC_XY_VEL_MAX"]))

    def _follow_switch(self) -> None:
        """A turn of the pilot's mode switch changes the mode, where there is a radio."""
        switch = self.sticks.pilot.switch
        if switch != self._switch:
            self._switch = switch
            mode = SWITCH.get(int(self.params[f"COM_FLTMODE{switch}"]))
            if self.sticks.radio and mode is not None:
                self.set_mode(mode)

    def _take_over(self) -> None:
        """A pilot who moves the sticks gets POSCTL (COM_RC_OVERRIDE: 1 in AUTO modes, 2 in OFFBOARD)."""
        bit = 1 if self.wanted.auto else 2 if self.wanted is OFFBOARD else 0
        if int(self.params["COM_RC_OVERRIDE"]) & bit and not self.landed and self.sticks.moved:
            self.say(6, "Pilot took over using sticks\t")
            self.set_mode(SWITCH[2])

    def _disarm_idle(self) -> None:
        """Disarm COM_DISARM_LAND after a landing, COM_DISARM_PRFLT after arming without a takeoff."""
        if not self.landed or self.ground.stage is not Stage.STANDING:
            self._stood_since = self.now
            return
        landed = self._flew
        delay = self.params["COM_DISARM_LAND" if landed else "COM_DISARM_PRFLT"]
        if delay > 0.0 and self.now - self._stood_since >= delay:
            self.disarm(reason=events.LANDING if landed else events.PREFLIGHT)

    # ---- what its parts tell it

    def took_off(self) -> None:
        self._flew = True
        self._tell(events.TAKEOFF_DETECTED)

    def touched_down(self) -> None:
        self.mission.touched_down()
        self._tell(events.LANDING_DETECTED)

    def takeoff_done(self) -> None:
        """COM_TAKEOFF_ACT 0: hold."""
        self.set_mode(HOLD)

    def default_takeoff(self, height: float) -> None:
        self.event(events.DEFAULT_TAKEOFF, events.float_argument(height))
        self.say(6, f"Using default takeoff altitude: {height:.1f} m\t")

    def failsafe_began(self) -> None:
        self._tell(events.FAILSAFE, bytes([0, 0, 6, 0, 2]))

    def _report_checks(self) -> None:
        """The arming report goes out whenever it changes: here, when the stream comes or goes."""
        alive = self.offboard.alive
        if alive is not self._stream_reported:
            self._stream_reported = alive
            for event, arguments in events.arming_report(offboard_lost=not alive):
                self.event(event, arguments)

    def _tell(self, event: Event, arguments: bytes = b"") -> None:
        self.event(event, arguments)
        if event.text:
            self.say(event.severity, event.text)
