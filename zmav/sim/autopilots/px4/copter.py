"""One PX4 multicopter: its commander, from boot to disarm. What it says is in :mod:`zmav.sim.protocol.px4`."""

from __future__ import annotations

import math

from zmav.sim.autopilots.pilot import Pilot
from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.battery import Battery
from zmav.sim.autopilots.px4.ekf import Ekf2
from zmav.sim.autopilots.px4.failsafe import Action, Failsafe, Px4Parts
from zmav.sim.autopilots.px4.ground import LandDetector, Stage
from zmav.sim.autopilots.px4.health import Health
from zmav.sim.autopilots.px4.items import Fence, FenceItems, RallyItems
from zmav.sim.autopilots.px4.modes import HOLD, LAND, OFFBOARD, SWITCH, TERMINATION, Mode
from zmav.sim.autopilots.px4.navigator import Mission, Navigator
from zmav.sim.autopilots.px4.offboard import Motion, Offboard
from zmav.sim.autopilots.px4.sticks import Sticks
from zmav.sim.control.setpoints import Spool
from zmav.sim.fleets.base import Sense

TICK_S = 0.01
CHECK_EVERY, FENCE_EVERY = 10, 20  # ticks
_STREAM_LIMITS = {"speed": "MPC_XY_VEL_MAX", "speed_up": "MPC_Z_VEL_MAX_UP", "speed_down": "MPC_Z_VEL_MAX_DN"}


class Px4Copter(Px4Parts):
    """Modes, arming, landing and failsafes of one vehicle.

    The world calls :meth:`update` at every tick.
    """

    def make_parts(self) -> None:
        self.pilot = Pilot(radio=False)
        self.fence, self.rally = FenceItems(), RallyItems()
        self.mission = Mission(self)
        self.filter = Ekf2(self)
        self._ticks = 0

    def power_on(self) -> None:
        self.booted_at = self.now
        self.armed = False
        self.armed_at = 0.0
        self._consumed_before = self.power.consumed_mah
        self.cruise_speed: float | None = None
        self.wanted: Mode = HOLD
        self.mode: Mode = HOLD
        self.intents = 0  # how often a mode was asked for
        self._after_disarm: Mode = HOLD
        self.sticks = Sticks(self, self.pilot)
        self._switch = self.pilot.switch
        self.offboard = Offboard(self)
        self.navigator = Navigator(self, self.mission)
        self.ground = LandDetector(self)
        self.filter.power_on()
        self.battery, self.geofence = Battery(self), Fence(self, self.fence)
        self.failsafe = Failsafe(self)
        self.health = Health(self, self.failsafe)
        self._stood_since = self.now
        self._flew = False
        self._fused = True
        self.sp.spool(Spool.OFF)
        self.sp.limit("lean", math.radians(self.params["MPC_TILTMAX_AIR"]))

    # ---- what it knows

    @property
    def battery_left(self) -> float:
        """What it believes is left, 0 to 1."""
        return self.battery.remaining

    @property
    def position_ok(self) -> bool:
        """The estimator holds a position."""
        return self.has_home and self.filter.good

    @property
    def flies(self) -> bool:
        """OFFBOARD has the vehicle, off the ground."""
        return self.armed and self.mode is OFFBOARD and self.ground.stage is Stage.FLYING

    @property
    def landed(self) -> bool:
        return self.ground.landed

    @property
    def checks_ok(self) -> bool:
        """The pre-arm bit: nothing stands against arming in the mode asked for."""
        return self.health.ready_for(self.wanted.bit)

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
        if TERMINATION in (self.wanted, self.mode):
            return False
        self.wanted = mode
        self.intents += 1
        if mode.arms:
            self._after_disarm = mode
        if not self.failsafe.active:
            self._fly_in(mode)
        return True

    def _can_fly(self, mode: Mode) -> bool:
        """A landing is never refused."""
        return mode is LAND or (self.failsafe.can_run(mode) and (self.sticks.alive or not mode.manual))

    def arm(self, *, forced: bool = False) -> bool:
        """Arm the motors; the reason of a refusal goes out as an event."""
        if self.armed:
            return True
        if not (self.checks_ok or forced):
            self.tell(events.ARM_DENIED)
            return False
        self.armed, self.armed_at, self._flew = True, self.now, False
        self._stood_since = self.now
        self.home_world = (self.sense.north, self.sense.east, self.sense.down)
        self.failsafe.armed()
        self.tell(events.ARMED, bytes([events.EXTERNAL]))
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

    def terminate(self) -> None:
        """Flight termination: the motors stop now, and until a reboot nothing else is flown."""
        self.wanted = self._after_disarm = TERMINATION
        self.intents += 1
        self._fly_in(TERMINATION)

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        """One tick of the commander."""
        self.now, self.sense = now, sense
        self._ticks += max(round(dt / TICK_S), 1)
        self._follow_switch()
        if self._ticks % CHECK_EVERY == 0:
            self._check(CHECK_EVERY * TICK_S)
        if not self.armed:
            return
        self._take_over()
        flying = self.failsafe.mode
        if flying is None:
            self.disarm(forced=True, reason=events.FAILURE)
            return
        if flying is not self.mode:
            self._fly_in(flying)
        self._control()
        self.ground.update(descends=self._descends())
        self._disarm_idle()

    def _check(self, dt: float) -> None:
        """Ten times a second: what there is to know, what stands against what, and what to do about it."""
        self.filter.update(dt)
        self._report_fusion()
        self.battery.update()
        if self._ticks % FENCE_EVERY == 0:
            self.geofence.update()
        self.sticks.update()
        self.failsafe.watch_ground()
        self.health.update()
        if self.armed:
            self.failsafe.update(dt)
            if self.failsafe.action is Action.TERMINATE:
                self.wanted = self._after_disarm = TERMINATION

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
            self.limit(_STREAM_LIMITS)
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
            return wish is not None and wish.thrust < 0.6 * self.airframe.hover_share
        if self.mode.manual:
            return not self.sticks.alive or self.sticks.descends(self.mode)
        return self.navigator.descends

    def _follow_switch(self) -> None:
        """A turn of the pilot's mode switch changes the mode, where his radio is heard."""
        switch = self.pilot.switch
        if switch != self._switch and self.pilot.heard:
            self._switch = switch
            if (mode := SWITCH.get(int(self.params[f"COM_FLTMODE{switch}"]))) is not None:
                self.set_mode(mode)

    def _take_over(self) -> None:
        """A pilot who moves the sticks gets POSCTL (COM_RC_OVERRIDE: 1 in AUTO modes, 2 in OFFBOARD)."""
        bit = 1 if self.mode.auto else 2 if self.wanted is OFFBOARD else 0
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
        self.tell(events.TAKEOFF_DETECTED)

    def touched_down(self) -> None:
        self.mission.touched_down()
        self.tell(events.LANDING_DETECTED)

    def _report_fusion(self) -> None:
        """Armed, it says when it goes on without its GPS, and when it has it again."""
        fused = self.filter.good
        if fused is not self._fused:
            self._fused = fused
            if self.armed:
                self.tell(events.GNSS_STARTED if fused else events.GNSS_STOPPED)
