"""One ArduPlane: its state machine, from boot to disarm. What it says and hears is in :mod:`zmav.sim.protocol`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.boot import Stage as BootStage
from zmav.sim.autopilots.ardupilot.mode import Mode
from zmav.sim.autopilots.ardupilot.plan import stored
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.arduplane import modes
from zmav.sim.autopilots.arduplane.auto import Auto, AutoLand
from zmav.sim.autopilots.arduplane.guided import Guided
from zmav.sim.autopilots.arduplane.landing import Landing
from zmav.sim.autopilots.arduplane.launch import Launch
from zmav.sim.autopilots.arduplane.modes import PlaneMode
from zmav.sim.autopilots.arduplane.reactions import PlaneReactions
from zmav.sim.autopilots.arduplane.stages import PLANE_STAGES
from zmav.sim.autopilots.arduplane.way import Way
from zmav.sim.autopilots.items import Item, Result
from zmav.sim.control.planetargets import GAINS, PlaneHandle, Stage
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.wing import Wing
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position
from zmav.sim.protocol.params import ParamStore

_WARNING, _INFO = 4, 6
INITIALISING = 16
QUADPLANE_MODES = frozenset((17, 18, 19, 20, 21, 22, 23, 25))
TURN = 5  # ticks: how often modes set their targets
FLYING_EVERY = 20  # ticks: how often it asks itself whether it flies
FLYING_KEEP = 0.85  # of that belief, a low-pass filter
SURE_ARMED, SURE_DISARMED = 0.1, 0.9
MOVING = 1.5  # m/s
FAST_ENOUGH = 0.75  # of AIRSPEED_MIN, to fly
LAUNCHED_M, LAUNCHED_SPEED = 10.0, 5.0  # what ends the suppression of the engine
IN_AIR_S, IN_AIR_M = 5.0, 5.0
COURSE_SPEED = 5.0
HARD_TOUCH = 0.25  # m/s
LAND_START = 189


class ArduPlane(ArduVehicle):
    """Modes, arming, takeoff, landing and failsafes of one plane."""

    FIRMWARE: ClassVar[str] = "ArduPlane"
    FRAME = ""
    MAV_TYPE = 1
    NOT_SIMULATED: ClassVar[Mapping[int, str]] = {
        2: "STABILIZE",
        3: "TRAINING",
        4: "ACRO",
        6: "FBWB",
        8: "AUTOTUNE",
        14: "AVOID_ADSB",
        24: "THERMAL",
    }
    STAGES: ClassVar[tuple[BootStage, ...]] = PLANE_STAGES
    ARMING_TEXTS: ClassVar[tuple[str, str]] = ("Throttle armed", "Throttle disarmed")
    RADIO_PARAMS: ClassVar[tuple[str, str]] = ("THR_FAILSAFE", "THR_FS_VALUE")
    GCS_PARAMS: ClassVar[tuple[str, str]] = ("FS_GCS_ENABL", "FS_LONG_TIMEOUT")

    auto: Auto
    guided: Guided
    reactions: PlaneReactions

    def __init__(
        self, wing: Wing, params: ParamStore, sp: PlaneHandle, sense: Sense, world: Position, ready_s: float
    ) -> None:
        self.airframe = wing
        self.sp = sp
        self.eas2tas = sp.eas2tas
        self.sense = sense  # for those that look at once
        self.params, self.now = params, 0.0
        self.way, self.launch, self.landing = Way(self), Launch(self), Landing(self)
        super().__init__(params, sense, world, ready_s)
        self.mission.stored = plane_item
        for name in GAINS:
            if name in params:
                sp.gain(name, params[name])

    # ---- what kind it is

    def make_modes(self) -> list[Mode]:
        self.guided, self.auto = Guided(self), Auto(self)
        self.autoland = AutoLand(self)
        kinds: tuple[type[PlaneMode], ...] = (
            modes.Manual,
            modes.Circle,
            modes.FlyByWireA,
            modes.Cruise,
            modes.Rtl,
            modes.Loiter,
            modes.Takeoff,
            modes.Initialising,
        )
        return [*(kind(self) for kind in kinds), self.guided, self.auto, self.autoland]

    def make_reactions(self) -> PlaneReactions:
        return PlaneReactions(self)

    def on_power(self) -> None:
        self.way.power_on()
        self.launch.reset()
        self.landing = Landing(self)
        self.reactions.reset()
        self._flying = 0.0
        self.flying_since = self.now
        self.last_flying = self.now
        self.throttle_suppressed = True
        self.taken_off = True
        self.takeoff_direction: float | None = None
        self.fastest = 0.0
        self.airspeed_chosen: float | None = None
        self.throttle_chosen = False
        self._chosen_mode = self.mode
        self.mode = self.modes[INITIALISING]
        self.sp.off()

    def _wake(self, stage: BootStage) -> None:
        super()._wake(stage)
        if stage.event == "initialised" and self.mode.number == INITIALISING:
            self._switch_mode(self._chosen_mode, by_fence=False)

    def on_disarm(self) -> None:
        self.sp.off()
        self.launch.reset()
        self.airspeed_chosen = None
        self.takeoff_direction = None
        self.throttle_suppressed = True
        if self.throttle_chosen:
            self.sp.gain("TRIM_THROTTLE", self.params["TRIM_THROTTLE"])
            self.throttle_chosen = False

    def disarm(self, *, forced: bool = False) -> bool:
        """Stop the engine; refused in the air unless forced."""
        was = self.armed
        done = super().disarm(forced=forced)
        if was and done:
            self._flying = 0.0
        return done

    def waking_faults(self) -> list[str]:
        """In ArduPlane's words and order."""
        has = self.boot.has
        if not has("initialised"):
            return ["System not initialised"]
        if has("prearm"):
            return [] if self.armed or self.mode.allows_arming() else [f"{self.mode.name} mode not armable"]
        checks = (
            (True, "Gyros inconsistent" if has("aligned") else "Accels inconsistent"),
            (not has("ekf_started"), "AHRS: waiting for home"),
            (not has("airspeed"), "Airspeed: 1 pre-flight calibration in progress"),
        )
        return [text for failed, text in checks if failed]

    def forget_mission(self) -> None:
        """In AUTO it goes on where it was."""
        if self.mode is not self.auto:
            self.mission.reset()

    def param_changed(self, name: str, value: float) -> None:
        if name in GAINS:
            self.sp.gain(name, value)

    def change_speed(self, limit: str, value: float) -> None:
        """A plane has one speed: see :meth:`ask_speed`."""
        if limit == "speed":
            self.ask_speed(0, value, 0.0)

    def ask_speed(self, kind: int, value: float, throttle_pct: float) -> bool:
        """DO_CHANGE_SPEED: an airspeed (SPEED_TYPE 0; -2 is the usual one), a least ground speed (1), or a throttle."""
        params = self.params
        if kind == 0 and value == -2.0:
            self.airspeed_chosen = None
            return True
        if kind == 0 and params["AIRSPEED_MIN"] <= value <= params["AIRSPEED_MAX"]:
            self.airspeed_chosen = value
            self.say(_INFO, f"Set airspeed {int(value)} m/s")
            return True
        if kind == 1:
            self.say(_INFO, f"Set groundspeed {int(value)}")
            self.params.set("MIN_GROUNDSPEED", min(max(value, 0.0), params["AIRSPEED_MAX"]))
            return True
        if kind == 0 and 0 < throttle_pct <= 100:
            self.say(_INFO, f"Set throttle {int(throttle_pct)}")
            self.sp.gain("TRIM_THROTTLE", throttle_pct)
            self.throttle_chosen = True
            return True
        return False

    # ---- what it knows

    @property
    def here(self) -> Vector:
        s = self.sense
        return s.north, s.east, s.down

    @property
    def groundspeed(self) -> float:
        return math.hypot(self.sense.vn, self.sense.ve)

    @property
    def eas(self) -> float:
        """Equivalent airspeed, m/s."""
        return self.sense.airspeed / self.eas2tas

    @property
    def head_wind(self) -> float:
        """m/s of the wind against its nose: what airspeed is more than ground speed along it."""
        s = self.sense
        return s.airspeed - (s.vn * math.cos(s.yaw) + s.ve * math.sin(s.yaw))

    @property
    def flying(self) -> bool:
        return self._flying >= (SURE_ARMED if self.armed else SURE_DISARMED)

    @property
    def navigating(self) -> bool:
        """It flies somewhere by itself."""
        return isinstance(self.mode, PlaneMode) and self.mode.navigates

    @property
    def cruise(self) -> float:
        """The usual airspeed, equivalent, m/s."""
        return self.params["AIRSPEED_CRUISE"]

    @property
    def airspeed_wanted(self) -> float:
        """In modes that navigate: what was chosen, more with the throttle stick above its middle, and enough against
        the wind (MIN_GROUNDSPEED).
        """
        params = self.params
        speed = self.airspeed_chosen or self.cruise
        push = self.rc.throttle - 0.5
        if params["THROTTLE_NUDGE"] and push > 0.0 and not self.rc.lost and self.mode.number != INITIALISING:
            speed += (params["AIRSPEED_MAX"] - self.cruise) * 2.0 * push
        if params["MIN_GROUNDSPEED"] > 0:
            s = self.sense
            along = s.vn * math.cos(s.yaw) + s.ve * math.sin(s.yaw)
            speed += max(params["MIN_GROUNDSPEED"] - along, 0.0)
        return min(max(speed, params["AIRSPEED_MIN"]), params["AIRSPEED_MAX"])

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

    # ---- the pilot's sticks, in the middle without a radio

    @property
    def stick_roll(self) -> float:
        return 0.0 if self.rc.lost else self.rc.roll

    @property
    def stick_pitch(self) -> float:
        """Positive: nose up."""
        return 0.0 if self.rc.lost else -self.rc.pitch

    @property
    def stick_yaw(self) -> float:
        return 0.0 if self.rc.lost else self.rc.yaw

    @property
    def stick_throttle(self) -> float:
        return 0.0 if self.rc.lost or not self.armed else self.rc.throttle * self.params["THR_MAX"] * 0.01

    # ---- what it can be told

    def set_mode(self, number: int, *, by_fence: bool = False) -> bool:
        """Change mode; says why where it does not."""
        mode = self.modes.get(number)
        if number in QUADPLANE_MODES:
            self.say(_INFO, "Q_ENABLE 0")
            return False
        if mode is None:
            return super().set_mode(number)  # says why not
        if mode is self.mode:
            self.mode_by_fence |= by_fence
            return True
        if self.armed and self.fence.blocks_mode_change and not by_fence:
            self.say(_WARNING, f"Mode change to {mode.name} denied, in fence recovery")
            return False
        if mode.refusal():
            self.say(_WARNING, "Flight mode change failed")
            return False
        self._switch_mode(mode, by_fence=by_fence)
        return True

    def _switch_mode(self, mode: Mode, *, by_fence: bool) -> None:
        self.mode.leave()
        self.mode, self.mode_by_fence = mode, by_fence
        if not self.flying:
            self.throttle_suppressed = True
        mode.enter()
        self.beat()
        self.fence.mode_changed()

    def land_by_mission(self) -> bool:
        """Go on with the nearest DO_LAND_START of the mission; False where there is none."""
        best, nearest = 0, math.inf
        for seq in range(1, len(self.mission)):
            item = self.mission.read(seq)
            if not isinstance(item, Item) or item.command != LAND_START:
                continue
            place = self.place_of(item, self.here)
            away = math.hypot(place[0] - self.here[0], place[1] - self.here[1])
            if away < nearest:
                best, nearest = seq, away
        if not best or not self.mission.set_current(best):
            return False
        self.say(_INFO, "Landing sequence start")
        self.mission.landing = True
        if self.mode is self.auto:
            return True
        self.auto.force_resume = True
        return self.set_mode(self.auto.number)

    def disarm_after_landing(self) -> None:
        """LAND_DISARMDELAY seconds after it stopped flying."""
        delay = self.params["LAND_DISARMDELAY"]
        if self.armed and delay > 0 and not self.flying and self.now - self.last_flying >= delay:
            self.disarm(forced=True)
            self.say(_INFO, "Auto disarmed")
            self.landing.report_distance()

    # ---- flying

    def fly_height(self, height: float, airspeed: float, stage: Stage = Stage.NORMAL, ground: float = 0.0) -> None:
        """Hold a height (m over the world's origin) and an equivalent airspeed."""
        self.sp.energy(height, airspeed)
        self.sp.stage(stage, ground)
        self.limit()
        if self.throttle_suppressed or stage is Stage.FLARE:
            self.sp.power(0.0)

    def limit(
        self, *, roll: float | None = None, pitch_min: float | None = None, throttle: tuple[float, float] | None = None
    ) -> None:
        """How far navigation may go: the parameters, or less."""
        params = self.params
        most = math.radians(params["ROLL_LIMIT_DEG"])
        low, high = math.radians(params["PTCH_LIM_MIN_DEG"]), math.radians(params["PTCH_LIM_MAX_DEG"])
        self.sp.limits(
            roll=most if roll is None else min(roll, most),
            pitch=(low if pitch_min is None else pitch_min, high),
            throttle=throttle or (params["THR_MIN"] * 0.01, params["THR_MAX"] * 0.01),
        )

    @property
    def on_turn(self) -> bool:
        """It is time for new targets."""
        return self._ticks % TURN == 0

    @property
    def turn_s(self) -> float:
        return TURN * self.dt

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.reactions.update()

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if sense.impact > HARD_TOUCH:
            self.say(_INFO, f"SIM Hit ground at {sense.impact:.6f} m/s")
        if self._ticks % FLYING_EVERY == 0:
            self._believe_flying()
        if self.on_turn:
            moves = self._flying > 0.0 or not self.throttle_suppressed or self.rc.throttle > 0.0
            self.sp.flying(self.armed and moves)

    def watch_ground(self) -> None:
        """The engine stays off until the launch; AUTOLAND's direction is that of the first course flown."""
        if self.throttle_suppressed and self.on_turn:
            self.throttle_suppressed = not self._launched()
        if self.takeoff_direction is None and self.flying and self.groundspeed > COURSE_SPEED:
            captures = isinstance(self.mode, PlaneMode) and self.mode.captures_direction
            if captures or self.taking_off:
                course = math.atan2(self.sense.ve, self.sense.vn) + math.radians(self.params["AUTOLAND_DIR_OFF"])
                self.takeoff_direction = course
                self.say(_INFO, f"Autoland direction= {int(math.degrees(course) % 360.0)}")

    def _launched(self) -> bool:
        """Whether the engine may run, in a mode that runs it by itself."""
        if not (isinstance(self.mode, PlaneMode) and self.mode.auto_throttle):
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
        self.fastest = max(self.fastest, self.eas) if self.armed else 0.0


def plane_item(item: Item) -> Item | Result:
    """The item as a plane keeps it: of a waypoint the acceptance and passing distances, metres in a byte each."""
    kept = stored(item)
    if isinstance(kept, Result) or item.command != 16:
        return kept
    accept, passing = (float(int(p) & 0xFF) if math.isfinite(p) and p > 0 else 0.0 for p in (item.p2, item.p3))
    return Item(
        command=kept.command,
        frame=kept.frame,
        p1=0.0,
        p2=accept,
        p3=passing,
        x=kept.x,
        y=kept.y,
        z=kept.z,
        seq=kept.seq,
    )
