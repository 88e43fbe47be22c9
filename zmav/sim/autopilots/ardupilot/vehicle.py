"""An ArduPilot's state machine, from boot to disarm: what copters, rovers and planes have in common.

A kind of vehicle adds its modes, its reactions to failsafes, and what it means to stand, to arm and to leave the
ground. What it says and hears is in :mod:`zmav.sim.protocol.ardupilot`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from zmav.sim.autopilots.ardupilot.arming import ArmingChecks
from zmav.sim.autopilots.ardupilot.boot import Boot, Flag, Stage
from zmav.sim.autopilots.ardupilot.camera import Camera
from zmav.sim.autopilots.ardupilot.ekf import Ekf3
from zmav.sim.autopilots.ardupilot.failsafe import BatteryFailsafe, EkfFailsafe, GcsFailsafe
from zmav.sim.autopilots.ardupilot.fence import Fence, Rally
from zmav.sim.autopilots.ardupilot.mission import Mission
from zmav.sim.autopilots.ardupilot.radio import Radio
from zmav.sim.autopilots.ardupilot.state import CRITICAL, INFO, WARNING, Mode, Reactions
from zmav.sim.autopilots.ardupilot.terrain import Terrain
from zmav.sim.autopilots.base import Installation
from zmav.sim.autopilots.items import Item
from zmav.sim.autopilots.pilot import Pilot
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.battery import BatteryHandle
from zmav.sim.fleets.base import Sense

PREARM_REMINDER_S = 30.0
TICK_S = 0.01
HARD_TOUCH = 0.25  # m/s
FENCE_EVERY, SLOW_EVERY = 4, 10  # ticks
NAV_WAYPOINT = 16  # MAV_CMD
SITL_BATTERY_V = 12.6  # the default of SIM_BATT_VOLTAGE
OUTPUTS = 16
FREE_FUNCTIONS = frozenset((0, 1, 22, 23, 28, *range(51, 67)))  # SERVOn_FUNCTION that DO_SET_SERVO may set


class ArduVehicle(ArmingChecks, ABC):
    """Modes, arming and failsafes of one vehicle.

    The world calls :meth:`update` at every autopilot tick with the time and what the vehicle senses. ``report(name)``,
    ``reached(seq)`` and ``learned(param)`` are the protocol's.
    """

    FIRMWARE: ClassVar[str]
    """as the banner has it: "ArduCopter" """
    FRAME: str
    """the banner's last line, such as "QUAD/PLUS"; empty for none"""
    MAV_TYPE: int
    MOTORS: int = 1
    """that share the battery's current"""
    MODE_PARAM: ClassVar[str] = "FLTMODE"
    """of the mode switch: this and 1 to 6, and with _CH its channel"""
    HOME_ON_ARMING: ClassVar[bool] = True
    """home is where it is armed"""
    KEEPS_MISSION: ClassVar[bool] = False
    """disarmed in AUTO it keeps its place in the mission"""
    ARMING_TEXTS: ClassVar[tuple[str, str]] = ("Arming motors", "Disarming motors")

    def __init__(self, into: Installation[Any, Any]) -> None:
        super().__init__(into)
        params = self.params
        self.dt = 0.01
        self.report: Callable[[str], None] = lambda name: None  # a message of the reports, on every link
        self.reached: Callable[[int], None] = lambda seq: None  # a mission item
        self.learned: Callable[[str], None] = lambda name: None  # a parameter that it set by itself
        self.filter = Ekf3(self)
        self._ready_s = into.ready_s
        self._ticks = 0
        self.pilot = Pilot()
        self.camera = Camera(self)
        self.terrain = Terrain(self)
        self.fence = Fence(self)
        self.rally = Rally(self, self.fence)
        self.modes: dict[int, Mode] = {mode.number: mode for mode in self.make_modes()}
        self.mission = Mission(
            self.auto,
            self._home_item,
            params.__getitem__,
            say=lambda severity, text: self.say(severity, text),
            sized=lambda count: self.sized("MIS_TOTAL", count),
            armed=lambda: self.armed,
        )
        self.reactions = self.make_reactions()
        self.power_on()
        params.watch(self.param_changed)
        params.watch(self._battery_changed)

    def above_home(self, north: float, east: float) -> float:
        return self.terrain.above_home(north, east)

    # ---- what a kind of vehicle says

    @abstractmethod
    def make_modes(self) -> list[Mode]:
        """All modes, the one without a switch first; sets ``self.auto`` and ``self.guided``."""

    @abstractmethod
    def make_reactions(self) -> Reactions:
        """What it does in a failsafe."""

    @abstractmethod
    def on_power(self) -> None:
        """Start from nothing what only this kind has; the outputs are off."""

    @abstractmethod
    def on_disarm(self) -> None:
        """The motors are to stop."""

    @abstractmethod
    def watch_ground(self) -> None:
        """Once a tick while armed: keep ``landed`` true to what is, and disarm where its rules say so."""

    @abstractmethod
    def param_changed(self, name: str, value: float) -> None:
        """A parameter has another value."""

    @abstractmethod
    def change_speed(self, limit: str, value: float) -> None:
        """Go with another speed, m/s: "speed", "speed_up" or "speed_down"."""

    def refusal_text(self, mode: Mode, why: str) -> str:
        """What is said where a mode is not entered."""
        return f"Mode change to {mode.name} failed: {why}"

    def mode_changed(self) -> None:
        """Another mode was chosen and is about to be entered."""

    def on_arm(self) -> None:
        """The motors were armed just now."""

    # ---- power

    def plug(self, power: BatteryHandle) -> None:
        """Take the battery of the body that it sits in; SIM_BATT_VOLTAGE and SIM_BATT_CAP_AH say what it is like."""
        self.power = power
        params = self.params
        if abs(params["SIM_BATT_VOLTAGE"] - SITL_BATTERY_V) < 1e-3 and params["SIM_BATT_CAP_AH"] == 0:
            # Nobody chose another than the body's own.
            params.set("SIM_BATT_VOLTAGE", power.pack.full_v)
            params.set("SIM_BATT_CAP_AH", power.pack.capacity_mah * 1e-3)
            if power.pack.capacity_mah > 0:
                params.set("BATT_CAPACITY", power.pack.capacity_mah)
        self._fit_battery()

    def _battery_changed(self, name: str, value: float) -> None:
        if name in ("SIM_BATT_VOLTAGE", "SIM_BATT_CAP_AH"):
            self._fit_battery()

    def _fit_battery(self) -> None:
        volts, capacity = self.params["SIM_BATT_VOLTAGE"], max(self.params["SIM_BATT_CAP_AH"], 0.0) * 1e3
        self.power.fit(volts=volts, capacity_mah=capacity)

    def power_on(self) -> None:
        """Start from nothing, as after a reset: not armed, no estimate yet. Missions, fences and points are kept."""
        self.booted_at = self.now
        self.boot = Boot(self._ready_s, self.STAGES)
        self.armed = self.auto_armed = False
        self.landed = True
        self.mode_by_fence = False
        self.rc = Radio(self, self.pilot)
        self.pilot.switch_channel = self.rc.switch_channel = self._switch_channel
        switched = self.modes.get(int(self.params[f"{self.MODE_PARAM}{self.pilot.switch}"]))
        self.mode: Mode = switched or next(iter(self.modes.values()))
        self.gcs, self.battery, self.ekf = (
            GcsFailsafe(self, self.rc),
            BatteryFailsafe(self),
            EkfFailsafe(self, self.filter),
        )
        self.mission.power_on()
        self.camera.power_on()
        self.fence.power_on()
        self.servos = [0] * OUTPUTS  # pulse widths that DO_SET_SERVO set, us
        self._consumed_before = self.power.consumed_mah
        self._home_locked = False
        self._switch, self._switch_pwm = self.pilot.switch, self.pilot.switch_pwm
        self._reminded = self._armed_at = self.now
        self.filter.power_on()
        self.on_power()

    @property
    def _switch_channel(self) -> int:
        """Of the mode switch; 0: there is none, and 5 stands in for it."""
        return min(max(int(self.params[f"{self.MODE_PARAM}_CH"]), 0), 8) or 5

    # ---- what it knows

    @property
    def position_ok(self) -> bool:
        """The EKF holds a position good enough to go by."""
        return self.boot.has("position") and self.filter.good

    @property
    def ekf_flags(self) -> Flag:
        """EKF_STATUS_REPORT.flags; without a position as before there was one."""
        return self.filter.flags if self.boot.has("position") else self.boot.ekf_flags

    @property
    def gps_ok(self) -> bool:
        return self.boot.has("gps") and self.filter.has_fix

    @property
    def failsafe(self) -> bool:
        """Any of them is on."""
        return self.rc.lost or self.gcs.active or self.battery.failed or self.ekf.active

    @property
    def battery_left(self) -> float:
        """What it believes is left, 0 to 1."""
        return max(1.0 - self.consumed_mah / max(self.params["BATT_CAPACITY"], 1.0), 0.0)

    @property
    def takes_targets(self) -> bool:
        """Somebody outside may steer."""
        return self.mode is self.guided

    @property
    def taking_off(self) -> bool:
        """On its way up by itself."""
        return False

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
        mode = self.modes.get(number)
        if mode is None:
            left_out = self.NOT_SIMULATED.get(number)
            self.say(WARNING, f"No such mode {number}" if left_out is None else f"{left_out} is not simulated")
            return False
        if mode is self.mode:
            self.mode_by_fence = by_fence
            return True
        refusal = self._refusal(mode, by_fence)
        if refusal:
            self.say(WARNING, self.refusal_text(mode, refusal))
            return False
        self.mode.leave()
        self.mode, self.mode_by_fence = mode, by_fence
        self.mode_changed()
        mode.enter()
        self.beat()
        self.fence.mode_changed()
        return True

    def _refusal(self, mode: Mode, by_fence: bool) -> str:
        if self.armed and mode.needs_position and not self.position_ok:
            return "requires position"
        if self.armed and self.fence.blocks_mode_change and not by_fence:
            return "in fence recovery"
        return mode.blocked() or (mode.refusal() if self.armed else "")

    def move_home(self, place: Vector | None, *, lock: bool = False) -> bool:
        if not self.boot.has("origin"):
            return False
        self.home_world = place or (self.sense.north, self.sense.east, self.sense.down)
        self._home_locked |= lock
        self.mission.keep_home()
        self.announce()
        return True

    def sized(self, param: str, count: int) -> None:
        if self.params[param] != count:
            self.params.set(param, count)
            self.learned(param)

    def set_servo(self, channel: int, pwm: int) -> bool:
        if not 1 <= channel <= OUTPUTS:
            return False
        if int(self.params[f"SERVO{channel}_FUNCTION"]) not in FREE_FUNCTIONS:
            self.say(INFO, f"ServoRelayEvent: Channel {channel} is already in use")
            return False
        self.servos[channel - 1] = pwm
        return True

    def arm(self, *, forced: bool = False) -> bool:
        """Arm the motors; says why where it does not. ``forced`` skips all checks but the mandatory ones."""
        if self.armed:
            return True
        faults = self.arming_faults(forced=forced)
        for fault in faults:
            self.say(CRITICAL, f"Arm: {fault}")
        if faults:
            return False
        self.armed = True
        self._armed_at = self.now
        self.on_arm()
        if self.HOME_ON_ARMING and not self._home_locked:
            self.move_home(None)
        self.say(INFO, self.ARMING_TEXTS[0])
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
        self.on_disarm()
        self.say(INFO, self.ARMING_TEXTS[1])
        if not (self.KEEPS_MISSION and self.mode is self.auto):
            self.mission.reset()
        return True

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        """One tick of the state machine."""
        self.now, self.sense, self.dt = now, sense, dt
        for stage in self.boot.advance(self.uptime):
            self._wake(stage)
        self.rc.update()
        self.follow_switch()
        self._ticks += max(round(dt / TICK_S), 1)
        if self._ticks % FENCE_EVERY == 0:
            self.fence.update()
        self.camera.update()
        if self._ticks % SLOW_EVERY == 0:
            self.watch(TICK_S * SLOW_EVERY)
        if self.armed:
            self.watch_ground()
            if self.armed:
                self.mode.update()
        else:
            self._remind()
            self.mode.idle()
        if sense.impact > HARD_TOUCH:
            self.say(INFO, f"SIM Hit ground at {sense.impact:.6f} m/s")

    def watch(self, dt: float) -> None:
        """Ten times a second."""
        self.filter.update(dt)
        self.gcs.update()
        self.battery.update()
        self.ekf.update()

    def _wake(self, stage: Stage) -> None:
        for text in stage.text:
            self.say(stage.severity, text)
        if stage.event == "origin":
            self.origin_world = (self.sense.north, self.sense.east, self.sense.down)
            self.move_home(None)
            self.say(INFO, f"Field Elevation Set: {self.place(self.home_world).alt_amsl_m:.0f}m")

    def follow_switch(self) -> None:
        """A turn of the pilot's mode switch changes the mode."""
        pwm = self.rc.switch_pwm
        if pwm == self._switch_pwm or self.rc.lost:
            return
        self._switch_pwm = pwm
        switch = self.rc.switch
        if switch != self._switch:
            self._switch = switch
            self.set_mode(int(self.params[f"{self.MODE_PARAM}{switch}"]))

    def _remind(self) -> None:
        """Say every half minute why arming would be refused."""
        if self.boot.has("initialised") and self.now - self._reminded >= PREARM_REMINDER_S:
            self._reminded = self.now
            for fault in self.prearm_faults():
                self.say(CRITICAL, f"PreArm: {fault}")
