"""AUTO: flies the mission, as ArduCopter does: https://ardupilot.org/copter/docs/auto-mode.html"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.heading import Look
from zmav.sim.autopilots.arducopter.legs import (
    LEGS,
    Delay,
    GuidedBounds,
    GuidedEnable,
    LandAt,
    Leg,
    LoiterForever,
    LoiterTime,
    LoiterToAlt,
    LoiterTurns,
    ReturnToLaunch,
    Takeoff,
    Waypoint,
)
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.vehicle import AutoMode
from zmav.sim.autopilots.ardupilot.waits import UNREPORTED, Conditions
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

CRITICAL, WARNING = 2, 4
ALLOW_ARMING, ALLOW_TAKEOFF_WITHOUT_THROTTLE = 1, 2  # AUTO_OPTIONS
SPEEDS = {0: "speed", 1: "speed", 2: "speed_up", 3: "speed_down"}  # SPEED_TYPE
AUTO_RTL = 27  # the mode that AUTO calls itself on the way to a landing
GUIDED_LIMITS = 222  # MAV_CMD_DO_GUIDED_LIMITS
CONDITION_YAW = 115  # MAV_CMD
# Commands that go on with the way there is; the others set their own targets.
KEEPS_WAY = (Waypoint, LoiterForever, LoiterTime, LoiterToAlt, LandAt, LoiterTurns, Delay)


class Auto(AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, changes_speed = 3, "AUTO", True

    def __init__(self, copter: ArduCopter) -> None:
        super().__init__(copter)
        self.copter = copter
        self.leg: Leg | None = None
        self.travelled = False  # a place was flown to in this run
        self.waiting = False
        self._flown: tuple[Item, ...] = ()
        self._changes = 0
        self._conditions = Conditions()
        self.bounds = GuidedBounds()

    # ---- the mode

    def allows_arming(self) -> bool:
        return bool(int(self.copter.params["AUTO_OPTIONS"]) & ALLOW_ARMING)

    def refusal(self) -> str:
        copter = self.copter
        if not copter.mission.present:
            return "init failed"
        if copter.landed and not copter.mission.starts_with_takeoff():
            copter.say(CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
        return ""

    def enter(self) -> None:
        copter = self.copter
        self.leg, self.travelled, self.waiting = None, False, True
        if copter.heading.look is Look.POINT:
            copter.heading.hold(copter.sense.yaw)
        if copter.armed:
            copter.travel.stop()

    def on_arming(self) -> None:
        """The mission runs already; arming changes nothing about it."""

    def come_back(self) -> bool:
        """AUTO RTL: join the mission at its DO_LAND_START; False, with the reason said, where it has none."""
        copter = self.copter
        here = (copter.sense.north, copter.sense.east, copter.sense.down)
        start = copter.mission.landing_start(lambda item: math.dist(copter.place_of(item, here), here))
        if start == 0:
            text = "No return path or landing sequence found"
            copter.say(WARNING, f"Mode change to AUTO RTL failed: {text}")
            return False
        if copter.mode is not self and not copter.set_mode(3):
            return False
        self.waiting = False
        copter.mission.resume()
        copter.mission.set_current(start)
        self._note_mission()
        self.number, self.name = AUTO_RTL, "AUTO RTL"
        copter.beat()
        return True

    def leave(self) -> None:
        self.number, self.name = 3, "AUTO"
        if self.copter.mission.state is State.RUNNING:
            self.copter.mission.stop()
        self.leg = None
        self.copter.travel.release()

    def idle(self) -> None:
        """A mission that was chosen before arming runs as far as it gets on the ground."""
        self._run_mission()

    def update(self) -> None:
        copter = self.copter
        self._run_mission()
        if not copter.armed or copter.mode is not self:
            return
        if int(copter.params["AUTO_OPTIONS"]) & ALLOW_TAKEOFF_WITHOUT_THROTTLE and isinstance(self.leg, Takeoff):
            copter.auto_armed = True
        if self.leg is None or isinstance(self.leg, Delay):
            copter.spool()
            copter.travel.update()
        else:
            self.leg.run()

    def _run_mission(self) -> None:
        copter, mission = self.copter, self.copter.mission
        if self.waiting:
            if copter.boot.has("origin"):
                self.waiting = False
                mission.start_or_resume()
                self._note_mission()
            return
        if mission.changes != self._changes:
            before = self._flown
            self._note_mission()
            if self._flown != before and mission.state is State.RUNNING and self.leg is not None and self.leg.restarts:
                done = mission.restart_current()
                outcome = ", restarted command" if done else " but failed to restart command"
                copter.say(CRITICAL, f"Auto mission changed{outcome}")
        mission.update()

    def _note_mission(self) -> None:
        self._changes = self.copter.mission.changes
        self._flown = self.copter.mission.upcoming

    @property
    def is_landing(self) -> bool:
        if isinstance(self.leg, LandAt):
            return self.leg.descending
        return isinstance(self.leg, ReturnToLaunch) and self.copter.rtl.landing

    @property
    def taking_off(self) -> bool:
        return isinstance(self.leg, Takeoff) and self.leg.rising

    @property
    def target(self) -> Vector | None:
        """The place that it flies to, in the world's NED."""
        return self.copter.travel.destination if self.travelled else None

    @property
    def paused(self) -> bool:
        return self.copter.travel.paused

    def pause(self) -> bool:
        copter = self.copter
        if copter.mode is not self or copter.landed or copter.travel.reached or not self.travelled:
            return False
        copter.travel.pause()
        return True

    def resume(self) -> None:
        self.copter.travel.resume()

    @property
    def takes_targets(self) -> bool:
        """Somebody outside may steer now."""
        return isinstance(self.leg, GuidedEnable)

    def look_ahead(self) -> None:
        """Where the nose points on the way to a place, unless it is kept on a point."""
        copter = self.copter
        if copter.heading.look is not Look.POINT:
            copter.heading.along(copter.params["WP_YAW_BEHAVIOR"], copter.sense.yaw)

    # ---- the mission's performer

    def start(self, item: Item) -> bool:
        leg = LEGS.get(item.command)
        if leg is not None:
            if leg not in KEEPS_WAY:
                self.copter.travel.release()
            self.leg = leg(self, item)
            self.leg.begin()
            self._note_mission()
            return True
        return self._conditions.begin(item, self.copter.now) or self._do(item)

    def _do(self, item: Item) -> bool:
        """Commands that are done as soon as they are begun, and CONDITION_YAW."""
        copter = self.copter
        if item.command == CONDITION_YAW:
            angle, rate = math.radians(item.p1), math.radians(item.p2)
            copter.heading.sweep(copter.sense.yaw, angle, rate, item.p3, relative=item.p4 > 0)
        elif item.command == 178:
            if item.p2 > 0 and int(item.p1) in SPEEDS:
                copter.change_speed(SPEEDS[int(item.p1)], item.p2)
        elif item.command == 179:
            copter.move_home(None if item.p1 == 1 or (item.here and item.z == 0) else copter.place_of(item, None))
        elif item.command in (195, 197, 201):
            copter.region_of_interest(None if item.here and item.z == 0 else copter.place_of(item, None))
        elif item.command in (188, 189):
            return True
        elif item.command == GUIDED_LIMITS:
            self.bounds.limit(item.p1, item.p2, item.p3, item.p4)
        else:
            return copter.payload.perform(item)
        return True

    def verify(self, item: Item) -> bool:
        if item.command in UNREPORTED:
            return True
        done = self._is_done(item)
        if done and not isinstance(self.leg, LoiterToAlt):
            self.copter.reached(item.seq)
        return done

    def _is_done(self, item: Item) -> bool:
        copter = self.copter
        if item.command in LEGS:
            return self.leg is not None and self.leg.done()
        if item.command == CONDITION_YAW:
            # A leg that began meanwhile has turned the nose its own way.
            copter.heading.insist()
            return copter.heading.arrived(copter.sense.yaw)
        return self._conditions.met(item, copter.now, copter.travel.distance)

    def finished(self) -> None:
        """The end of the mission: stay there, or disarm where it stands on the ground."""
        copter = self.copter
        self.leg = None
        if copter.landed:
            copter.disarm(forced=True)
        elif copter.position_ok:
            copter.travel.stop()
            copter.heading.hold(copter.sense.yaw)
        else:
            copter.set_mode(9)
