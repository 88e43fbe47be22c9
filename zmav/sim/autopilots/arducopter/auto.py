"""AUTO: flies the mission, as ArduCopter does: https://ardupilot.org/copter/docs/auto-mode.html"""

from __future__ import annotations

from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.heading import Look
from zmav.sim.autopilots.arducopter.legs import (
    LEGS,
    LandAt,
    Leg,
    LoiterForever,
    LoiterTime,
    ReturnToLaunch,
    Takeoff,
    Waypoint,
)
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.mode import AutoMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

CRITICAL, WARNING = 2, 4
ALLOW_ARMING, ALLOW_TAKEOFF_WITHOUT_THROTTLE = 1, 2  # AUTO_OPTIONS
SPEEDS = {0: "speed", 1: "speed", 2: "speed_up", 3: "speed_down"}  # SPEED_TYPE
# Commands that go on with the way there is; the others set their own targets.
KEEPS_WAY = (Waypoint, LoiterForever, LoiterTime, LandAt)


class Auto(AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, changes_speed = 3, "AUTO", True
    NAVIGATION = LEGS

    def __init__(self, copter: ArduCopter) -> None:
        super().__init__(copter)
        self.copter = copter
        self.leg: Leg | None = None
        self.travelled = False  # a place was flown to in this run
        self.waiting = False
        self._flown: tuple[Item, ...] = ()
        self._changes = 0

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

    def leave(self) -> None:
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
        if self.leg is None:
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

    def look_ahead(self) -> None:
        """Where the nose points on the way to a place, unless it is kept on a point."""
        copter = self.copter
        if copter.heading.look is not Look.POINT:
            copter.heading.along(copter.params["WP_YAW_BEHAVIOR"], copter.sense.yaw)

    # ---- the mission's performer

    def set_out(self, item: Item) -> None:
        leg = LEGS[item.command]
        if leg not in KEEPS_WAY:
            self.copter.travel.release()
        self.leg = leg(self, item)
        self.leg.begin()
        self._note_mission()

    def arrived(self, item: Item) -> bool:
        return self.leg is not None and self.leg.done()

    def change_speed(self, item: Item) -> None:
        if item.p2 > 0 and int(item.p1) in SPEEDS:
            self.copter.change_speed(SPEEDS[int(item.p1)], item.p2)

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
