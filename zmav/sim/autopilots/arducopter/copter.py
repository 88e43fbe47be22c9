"""One ArduCopter: its state machine, from boot to disarm. What it says and hears is in :mod:`zmav.sim.protocol`."""

from __future__ import annotations

import math
from collections.abc import Callable

from zmav.sim.autopilots.arducopter.auto import Auto
from zmav.sim.autopilots.arducopter.guided import Guided
from zmav.sim.autopilots.arducopter.heading import Heading
from zmav.sim.autopilots.arducopter.modes import AltHold, Brake, Land, Loiter, Mode, Rtl, Stabilize
from zmav.sim.autopilots.arducopter.travel import Travel
from zmav.sim.autopilots.ardupilot.arming import arming_faults, prearm_faults
from zmav.sim.autopilots.ardupilot.boot import Boot, Flag, Stage
from zmav.sim.autopilots.ardupilot.failsafe import BatteryFailsafe, EkfFailsafe, GcsFailsafe, RadioFailsafe
from zmav.sim.autopilots.ardupilot.fence import Fence
from zmav.sim.autopilots.ardupilot.mission import Mission
from zmav.sim.autopilots.ardupilot.payload import Payload
from zmav.sim.autopilots.ardupilot.plan import ABSOLUTE
from zmav.sim.autopilots.ardupilot.radio import Radio
from zmav.sim.autopilots.ardupilot.rally import Rally
from zmav.sim.autopilots.items import Item
from zmav.sim.autopilots.pilot import Pilot
from zmav.sim.control.setpoints import SetpointHandle, Spool, Vector
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position, from_ned, to_ned
from zmav.sim.protocol.params import ParamStore

EMERGENCY, ALERT, CRITICAL, ERROR, WARNING, NOTICE, INFO, DEBUG = range(8)  # MAV_SEVERITY

LANDED_AFTER_S = 1.0  # of standing on the ground without thrust
LOW_THRUST_SHARE = 0.65  # of the hover throttle
PREARM_REMINDER_S = 30.0
HARD_TOUCH = 0.25  # m/s
HIGHEST_M = 80_000.0
FENCE_EVERY, SLOW_EVERY = 4, 10  # ticks
NAV_WAYPOINT, NAV_LAND, NAV_TAKEOFF = 16, 21, 22  # MAV_CMD
MOST_VOLTS = 60.0
# To thrust, as measured: from the order to lift off, and from arming (after which the motors stand still for 2 s).
SPOOL_UP_S, ARMING_S = 2.0, 3.2
SITL_BATTERY_V = 12.6  # the default of SIM_BATT_VOLTAGE
# Without a GPS, as measured: how long the position is still good, and how long the filter tries to go on.
GPS_COAST_S, GPS_AIDED_S = 7.0, 14.7

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
        self.dt = 0.01
        self.speeds: dict[str, float] = {}  # chosen for this mode: limits of the cascade, m/s
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.beat: Callable[[], None] = lambda: None
        self.announce: Callable[[], None] = lambda: None
        self.report: Callable[[str], None] = lambda name: None  # a message of the reports, on every link
        self.reached: Callable[[int], None] = lambda seq: None  # a mission item
        self.learned: Callable[[str], None] = lambda name: None  # a parameter that it set by itself
        self.unix_s: Callable[[], float] = lambda: self.now
        self._ready_s = ready_s
        self._power()
        self._ticks = 0
        self.pilot = Pilot()
        self.rc = Radio(self, self.pilot)
        self.radio_failsafe = RadioFailsafe(self)
        self.heading = Heading(setpoint)
        self.travel = Travel(self)
        self.rally, self.fence, self.payload = Rally(self), Fence(self), Payload(self)
        self.mission = Mission(self._home_item, params.__getitem__, lambda severity, text: self.say(severity, text))
        self.mission.armed = lambda: self.armed
        self.mission.sized = lambda count: self.sized("MIS_TOTAL", count)
        self.guided, self.auto, self.land, self.rtl = Guided(self), Auto(self), Land(self), Rtl(self)
        self.mission.performer = self.auto
        modes: list[Mode] = [m(self) for m in (Stabilize, AltHold, Loiter, Brake)]
        modes += [self.guided, self.auto, self.land, self.rtl]
        self.modes: dict[int, Mode] = {m.number: m for m in modes}
        self.armed = False
        self.power_on()
        for name in _LIMITS:
            self._param_changed(name, params[name])
        params.changed = self._param_changed

    def _power(self) -> None:
        """The battery that the airframe has, where nobody chose another."""
        if abs(self.params["SIM_BATT_VOLTAGE"] - SITL_BATTERY_V) < 1e-3:
            self.params.set("SIM_BATT_VOLTAGE", self.airframe.battery_v)

    def power_on(self) -> None:
        """Start from nothing, as after a reset: not armed, no estimate yet. Missions, fences and points are kept."""
        self.booted_at = self.now
        self.boot = Boot(self._ready_s)
        self.armed = self.auto_armed = False
        self.landed = True
        self.mode_by_fence = False
        self.rc = Radio(self, self.pilot)
        switched = self.modes.get(int(self.params[f"FLTMODE{self.pilot.switch}"]))
        self.mode: Mode = switched or self.modes[0]
        self.gcs, self.battery, self.ekf = GcsFailsafe(self), BatteryFailsafe(self), EkfFailsafe(self)
        self.mission.power_on()
        self.fence.power_on()
        self.payload.power_on()
        self.consumed_mah = 0.0
        self._home_locked = False
        self._switch, self._switch_pwm = self.pilot.switch, self.pilot.pwm[4]
        self._quiet_since: float | None = None
        self._idle_since = self._landed_at = self._armed_at = self.now
        self._reminded = self.now
        self._gps_lost: float | None = None
        self._choose_speeds()
        self.sp.spool(Spool.OFF)

    # ---- what it knows

    @property
    def uptime(self) -> float:
        """Seconds since its own boot."""
        return self.now - self.booted_at

    @property
    def position_ok(self) -> bool:
        """The EKF holds a position good enough to fly by."""
        return self.boot.has("position") and (self._gps_lost is None or self.now - self._gps_lost < GPS_COAST_S)

    @property
    def ekf_flags(self) -> Flag:
        """EKF_STATUS_REPORT.flags; without a position as before there was one."""
        if self.boot.has("position") and not self.position_ok and self._gps_lost is not None:
            flags = self.boot.flags_without_position
            return flags if self.now - self._gps_lost > GPS_AIDED_S else flags & ~Flag.CONST_POS_MODE
        return self.boot.ekf_flags

    @property
    def gps_ok(self) -> bool:
        return self.boot.has("gps") and self._gps_lost is None

    @property
    def failsafe(self) -> bool:
        """Any of them is on."""
        return self.rc.lost or self.gcs.active or self.battery.failed or self.ekf.active

    @property
    def voltage(self) -> float:
        return min(max(self.params["SIM_BATT_VOLTAGE"], 0.0), MOST_VOLTS)

    @property
    def takes_targets(self) -> bool:
        """Somebody outside may steer: GUIDED, or a mission that lets them."""
        return self.mode is self.guided or (self.mode is self.auto and self.auto.takes_targets)

    @property
    def taking_off(self) -> bool:
        """On its way up by itself."""
        if self.mode is self.guided:
            return self.guided.taking_off
        return self.mode is self.auto and self.auto.taking_off

    @property
    def settled(self) -> bool:
        """It has stood on the ground for a moment."""
        return self.landed and self.now - self._landed_at >= LANDED_AFTER_S

    @property
    def spun_up_at(self) -> float:
        """When it has thrust, if it is to lift off now."""
        return max(self.now + SPOOL_UP_S, self._armed_at + ARMING_S)

    @property
    def height(self) -> float:
        """Above home, m."""
        return self.home_world[2] - self.sense.down

    @property
    def from_home(self) -> float:
        """Over the ground, m."""
        return math.hypot(self.sense.north - self.home_world[0], self.sense.east - self.home_world[1])

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

    def place_of(self, item: Item, default: Vector | None) -> Vector:
        """Where a mission item is, in the world's NED; what it leaves open (zeros) is as in ``default``."""
        north, east, down = to_ned(Position(item.x * 1e-7, item.y * 1e-7, item.z), self.world)
        if item.frame not in ABSOLUTE:
            down = self.home_world[2] - item.z
        if default is None:
            return north, east, down
        if item.here:
            north, east = default[0], default[1]
        return north, east, default[2] if item.z == 0 else down

    def _home_item(self) -> Item:
        if not self.boot.has("origin"):
            return Item(command=NAV_WAYPOINT, frame=0)
        home = self.place(self.home_world)
        x, y = round(home.lat_deg * 1e7), round(home.lon_deg * 1e7)
        return Item(command=NAV_WAYPOINT, frame=0, x=x, y=y, z=round(home.alt_amsl_m, 2))

    @property
    def system_status(self) -> int:
        """MAV_STATE: boot, critical (failsafe), standby (landed) or active."""
        if not self.boot.has("initialised"):
            return 1
        if self.failsafe:
            return 5
        return 3 if self.landed else 4

    # ---- what it can be told

    def set_mode(self, number: int, *, by_fence: bool = False) -> bool:
        """Change mode; says why where it does not."""
        mode = self.modes.get(number)
        if mode is None:
            self.say(WARNING, f"No such mode {number}")
            return False
        if mode is self.mode:
            self.mode_by_fence = by_fence
            return True
        refusal = self._mode_refusal(mode)
        if refusal:
            self.say(WARNING, f"Mode change to {mode.name} failed: {refusal}")
            return False
        self.mode.leave()
        self.sp.raw(False)
        self.mode, self.mode_by_fence = mode, by_fence
        self._choose_speeds()
        mode.enter()
        self.beat()
        self.fence.mode_changed()
        return True

    def _mode_refusal(self, mode: Mode) -> str:
        if self.armed and mode.needs_position and not self.position_ok:
            return "requires position"
        if self.armed and self.fence.blocks_mode_change:
            return "in fence recovery"
        if self.rc.lost and mode.manual_throttle:
            return "in RC failsafe"
        return mode.refusal() if self.armed else ""

    def _choose_speeds(self) -> None:
        """Back to the parameters: what was chosen for one mode does not outlive it."""
        for name, (limit, factor) in _LIMITS.items():
            if limit.startswith("speed"):
                self.change_speed(limit, self.params[name] * factor)

    def change_speed(self, limit: str, value: float) -> None:
        """Fly with another speed, m/s: "speed", "speed_up" or "speed_down"."""
        self.speeds[limit] = max(value, 0.1)
        self.sp.limit(limit, value)

    def move_home(self, place: Vector | None, *, lock: bool = False) -> bool:
        """Home is there (the world's NED) or, with None, here; False before there is an origin."""
        if not self.boot.has("origin"):
            return False
        self.home_world = place or (self.sense.north, self.sense.east, self.sense.down)
        self._home_locked |= lock
        self.mission.keep_home()
        self.announce()
        return True

    def region_of_interest(self, place: Vector | None) -> None:
        """Look at a point of the world's NED; None: no longer. With a gimbal that turns, the nose is left alone."""
        if self.payload.gimbal.present:
            self.payload.gimbal.point(place)
        elif place is None:
            self.heading.hold(self.sense.yaw)
            self.heading.along(self.params["WP_YAW_BEHAVIOR"], self.sense.yaw)
        else:
            self.heading.watch(place[0], place[1])

    def save_waypoint(self) -> None:
        """The pilot's switch adds where it is to the mission: a takeoff first, a landing with the throttle down."""
        low = self.rc.throttle < 0.03
        if self.mode is self.auto or not self.armed or (low and not self.mission.present):
            return
        here = self.position
        place = Item(
            command=NAV_LAND if low else NAV_WAYPOINT,
            x=round(here.lat_deg * 1e7),
            y=round(here.lon_deg * 1e7),
            z=self.height,
        )
        if not self.mission.present:
            self.mission.add(Item(command=NAV_TAKEOFF, z=max(self.height, 1.0)))
        self.mission.add(place)

    def sized(self, param: str, count: int) -> None:
        """A list has another length; the parameter says so."""
        if self.params[param] != count:
            self.params.set(param, count)
            self.learned(param)

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
        self._idle_since = self._armed_at = self.now
        if not self._home_locked:
            self.move_home(None)
        self.say(INFO, "Arming motors")
        self.fence.on_arming()
        self.mode.on_arming()
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """Stop the motors; refused in the air unless forced."""
        if not self.armed:
            return True
        if not self.landed and not forced:
            return False
        self.armed = self.auto_armed = False
        self.landed = True
        self.sp.spool(Spool.OFF)
        self.say(INFO, "Disarming motors")
        self.mission.reset()
        return True

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
        """One tick of the state machine."""
        self.now, self.sense, self.dt = now, sense, dt
        for stage in self.boot.advance(self.uptime):
            self._wake(stage)
        self.rc.update()
        self.follow_switch()
        self.consumed_mah += sense.current_a * dt / 3.6
        if sense.impact > HARD_TOUCH:
            self.say(INFO, f"SIM Hit ground at {sense.impact:.6f} m/s")
        self._ticks += 1
        if self._ticks % FENCE_EVERY == 0:
            self.fence.update()
        if self._ticks % SLOW_EVERY == 0:
            self._watch(dt * SLOW_EVERY)
        if not self.armed:
            self._remind()
            self.mode.idle()
            return
        self._watch_ground()
        self._disarm_idle()
        if self.armed:
            self.mode.update()
            self.heading.update(sense, dt)

    def _watch(self, dt: float) -> None:
        """Ten times a second."""
        gps = self.params["SIM_GPS1_ENABLE"] > 0
        self._gps_lost = None if gps else self.now if self._gps_lost is None else self._gps_lost
        self.gcs.update()
        self.battery.update()
        self.ekf.update()
        self.payload.update(dt)
        if self.boot.has("initialised"):
            self.rc.read_switches()
        if self.armed:
            if self.rc.throttle > 0.03:
                self.auto_armed = True
            elif self.mode.manual_throttle and self.rc.valid:
                self.auto_armed = False

    def _wake(self, stage: Stage) -> None:
        for text in stage.text:
            self.say(stage.severity, text)
        if stage.event == "origin":
            self.move_home(None)
            self.say(INFO, f"Field Elevation Set: {self.place(self.home_world).alt_amsl_m:.0f}m")

    def follow_switch(self, *, force: bool = False) -> None:
        """A turn of the pilot's mode switch changes the mode; ``force``: as if it had just been turned."""
        pwm = self.rc.pwm[4]
        if (pwm == self._switch_pwm and not force) or self.rc.lost:
            return
        self._switch_pwm = pwm
        switch = self.rc.switch
        if switch != self._switch or force:
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
                self._idle_since = self._landed_at = self.now
        else:
            self._quiet_since = None

    def _disarm_idle(self) -> None:
        """Disarm after a landing, and after DISARM_DELAY of standing armed with the throttle down."""
        if not self.landed or self.taking_off or self.rc.throttle > 0.05:
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
            if limit in self.speeds:
                self.change_speed(limit, value * factor)
            else:
                self.sp.limit(limit, value * factor)
