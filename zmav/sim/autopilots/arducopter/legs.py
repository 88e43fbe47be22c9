"""The navigation commands of a mission, each as ArduCopter flies it in AUTO.

Commands: https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.modes import CENTI, descend
from zmav.sim.autopilots.ardupilot.waits import delay
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Axis, Spool, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.auto import Auto
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

INFO = 6
EDGE_M = 3.0  # so near to its centre, circling begins at once
PASSING = (16, 17, 19, 82)  # commands that a waypoint before them is passed to without a stop
LEAST_CLIMB_M = 1.0
SLOWEST_TURN = math.radians(2.0)  # rad/s^2


class Leg(ABC):
    """One command. ``begin`` once, ``run`` at every tick in the air, ``done`` until it says so."""

    restarts = False  # begun again where the mission is changed under way

    def __init__(self, auto: Auto, item: Item) -> None:
        self.auto = auto
        self.copter = auto.copter
        self.item = item
        self._since: float | None = None

    @abstractmethod
    def begin(self) -> None:
        """Set out."""

    def run(self) -> None:
        """Set this moment's targets, on the ground too; the motors are armed."""
        if self.copter.spool():
            self.copter.travel.update()

    @abstractmethod
    def done(self) -> bool:
        """Whether the next command's turn has come."""

    @property
    def default(self) -> Vector:
        """What a command that leaves its place or height open means."""
        travel, s = self.copter.travel, self.copter.sense
        return travel.destination if self.auto.travelled and travel.reached else (s.north, s.east, s.down)

    def go(self, item: Item, onward: Vector | None = None) -> Vector:
        place = self.copter.place_of(item, self.default)
        self.copter.travel.go(place, onward)
        self.auto.travelled = True
        self.auto.look_ahead()
        return place

    def waited(self, seconds: float) -> bool:
        """Arrived, and so many seconds have passed since."""
        if not self.copter.travel.reached:
            return False
        self._since = self.copter.now if self._since is None else self._since
        return int(self.copter.now - self._since) >= int(seconds)


class Takeoff(Leg):
    """Straight up; on the ground it waits until the pilot or MISSION_START lets it."""

    def begin(self) -> None:
        copter, s = self.copter, self.copter.sense
        _, _, down = copter.place_of(self.item, (s.north, s.east, s.down))
        self._down = min(down, s.down - (LEAST_CLIMB_M if copter.landed else 0.0))
        self._lift_at = math.inf
        copter.heading.hold(s.yaw)

    def run(self) -> None:
        copter = self.copter
        if copter.landed and (not copter.auto_armed or copter.now < self._lift_at):
            copter.sp.spool(Spool.IDLE)
            if not copter.auto_armed:
                self._lift_at = math.inf
            elif self._lift_at == math.inf:
                self._lift_at = copter.spun_up_at
            self._place = (copter.sense.north, copter.sense.east, self._down)
            copter.sp.move(pos=self._place)
            copter.heading.hold(copter.sense.yaw)
            return
        copter.sp.spool(Spool.FLY)

    @property
    def rising(self) -> bool:
        """The motors are up to lift it, and it is not there yet."""
        return self.copter.now >= self._lift_at and not self._up

    @property
    def _up(self) -> bool:
        copter, s = self.copter, self.copter.sense
        slow = -s.vd < 0.1 * copter.sp.limit_of("speed_up")
        return not copter.landed and slow and s.down <= self._down + 0.1

    def done(self) -> bool:
        if self._up:
            s = self.copter.sense
            self.copter.travel.destination, self.copter.travel.reached = (s.north, s.east, self._down), True
        return self._up


class Waypoint(Leg):
    """To a place, and on after ``p1`` seconds there; also for splines, which are flown straight."""

    restarts = True

    def begin(self) -> None:
        onward = None
        following = self.copter.mission.next_navigation(self.item.seq + 1)
        place = self.copter.place_of(self.item, self.default)
        if self.item.p1 == 0 and following is not None and following.command in PASSING:
            onward = self.copter.place_of(following, place)
        self.go(self.item, onward)

    def done(self) -> bool:
        if not self.waited(self.item.p1):
            return False
        self.copter.say(INFO, f"Reached command #{self.item.seq}")
        return True


class LoiterForever(Leg):
    restarts = True

    def begin(self) -> None:
        self.go(self.item)

    def done(self) -> bool:
        return False


class LoiterTime(LoiterForever):
    def done(self) -> bool:
        if not self.waited(self.item.p1):
            return False
        self.copter.say(INFO, f"Reached command #{self.item.seq}")
        return True


class LoiterToAlt(Leg):
    """Over a place, then up or down to a height. Its end is not reported as an item reached."""

    def begin(self) -> None:
        place = self.go(self.item)
        self._down = self.copter.place_of(self.item, place)[2]
        s = self.copter.sense
        self.copter.travel.go((place[0], place[1], s.down))
        self._over = False

    def run(self) -> None:
        if not self.copter.spool():
            return
        self.copter.travel.update()
        if self.copter.travel.reached and not self._over:
            self._over = True
            north, east, _ = self.copter.travel.destination
            self.copter.travel.go((north, east, self._down))

    def done(self) -> bool:
        return self._over and abs(self.copter.sense.down - self._down) < 0.1


class LoiterTurns(Leg):
    """Circles about a place: ``p1`` turns with a radius of ``p3`` metres, counter-clockwise where that is negative."""

    def begin(self) -> None:
        copter, s = self.copter, self.copter.sense
        self._centre = copter.place_of(self.item, (s.north, s.east, s.down))
        self._radius = abs(self.item.p3) or copter.params["CIRCLE_RADIUS"] * CENTI
        self._way = -1.0 if self.item.p3 < 0 else 1.0
        self._angle: float | None = None
        self._turned = self._rate = 0.0
        self._said = -1
        north, east = s.north - self._centre[0], s.east - self._centre[1]
        off = math.hypot(north, east)
        if math.hypot(off, s.down - self._centre[2]) <= EDGE_M:
            self._circle()
            return
        angle = math.atan2(east, north) if off > 0.01 else s.yaw + math.pi
        copter.travel.go(self._on_circle(angle))
        self.auto.travelled = True
        if off > self._radius and off > 5.0:
            self.auto.look_ahead()
        else:
            copter.heading.hold(s.yaw)

    def _circle(self) -> None:
        s = self.copter.sense
        self.copter.travel.release()
        self._angle = math.atan2(s.east - self._centre[1], s.north - self._centre[0])

    def _on_circle(self, angle: float) -> Vector:
        north, east, down = self._centre
        return north + self._radius * math.cos(angle), east + self._radius * math.sin(angle), down

    def run(self) -> None:
        copter = self.copter
        if not self.copter.spool():
            return
        if self._angle is None:
            copter.travel.update()
            if copter.travel.reached:
                self._circle()
            return
        accel = copter.sp.limit_of("accel")
        fastest = min(copter.sp.limit_of("speed"), math.sqrt(0.5 * accel * self._radius)) / max(self._radius, 0.1)
        wanted = min(math.radians(abs(copter.params["CIRCLE_RATE"])), fastest)
        ramp = max(accel / max(self._radius, 0.1), SLOWEST_TURN) * copter.dt
        self._rate = min(self._rate + ramp, wanted)
        self._angle += self._way * self._rate * copter.dt
        self._turned += self._rate * copter.dt
        speed, toward = self._rate * self._radius, self._angle + self._way * math.pi / 2.0
        copter.sp.move(
            pos=self._on_circle(self._angle),
            vel=(speed * math.cos(toward), speed * math.sin(toward), 0.0),
            acc=(
                -self._rate * speed * math.cos(self._angle),
                -self._rate * speed * math.sin(self._angle),
                0.0,
            ),
        )
        copter.heading.hold(self._angle + math.pi)

    def done(self) -> bool:
        if self._angle is None:
            return False
        turns = self._turned / (2.0 * math.pi)
        if int(turns) != self._said:
            self._said = int(turns)
            self.copter.say(INFO, f"Mission: starting circle {self._said + 1}/{int(self.item.p1)}")
        return turns >= self.item.p1


class ReturnToLaunch(Leg):
    """As the RTL mode does, landing included."""

    def begin(self) -> None:
        self.copter.rtl.enter()

    def run(self) -> None:
        self.copter.rtl.update()

    def done(self) -> bool:
        return self.copter.rtl.landing and self.copter.landed


class LandAt(Leg):
    """Over the place at the height it has, then down; the mission ends there unless a takeoff may follow."""

    def begin(self) -> None:
        self.descending = self.item.here
        if self.descending:
            self._descend()
            return
        north, east, _ = self.copter.place_of(self.item, self.default)
        self.copter.travel.go((north, east, self.copter.sense.down))
        self.auto.travelled = True
        self.auto.look_ahead()

    def _descend(self) -> None:
        self.descending = True
        self.copter.travel.release()
        self.copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.copter.heading.hold(self.copter.sense.yaw)

    def run(self) -> None:
        if not self.copter.spool():
            return
        if self.descending:
            descend(self.copter)
            return
        self.copter.travel.update()
        if self.copter.travel.reached:
            self._descend()

    def done(self) -> bool:
        if not (self.descending and self.copter.landed and self.copter.settled):
            return False
        if self.copter.mission.goes_on_after_landing or not self.copter.armed:
            return True
        self.copter.disarm(forced=True)
        return False


class Delay(Leg):
    """``p1`` seconds from now, or until a time of day (UTC: hours, minutes and seconds in ``p2`` to ``p4``)."""

    def begin(self) -> None:
        seconds = delay(self.item, self.copter.unix_s())
        self._end = self.copter.now + seconds
        self.copter.say(INFO, f"Delaying {int(seconds)} sec")

    def done(self) -> bool:
        return self.copter.now > self._end


class GuidedBounds:
    """DO_GUIDED_LIMITS: how long and how far somebody outside may steer in a mission; a zero is no limit."""

    def __init__(self) -> None:
        self.limit(0.0, 0.0, 0.0, 0.0)
        self._since, self._from = 0.0, (0.0, 0.0)

    def limit(self, seconds: float, lowest: float, highest: float, away: float) -> None:
        """Seconds; metres above the EKF's origin; metres over the ground."""
        self._seconds, self._lowest, self._highest, self._away = seconds, lowest, highest, away

    def begin(self, copter: ArduCopter) -> None:
        self._since, self._from = copter.now, copter.local[:2]

    def passed(self, copter: ArduCopter) -> bool:
        north, east, down = copter.local
        if self._seconds > 0.0 and copter.now - self._since >= self._seconds:
            return True
        if (self._lowest != 0.0 and -down < self._lowest) or (self._highest != 0.0 and -down > self._highest):
            return True
        return self._away > 0.0 and math.dist((north, east), self._from) > self._away


class GuidedEnable(Leg):
    """Targets from outside are taken as in GUIDED, until somebody sets another item or DO_GUIDED_LIMITS are passed."""

    def begin(self) -> None:
        if self.item.p1 > 0:
            self.copter.guided.enter()
            self.auto.bounds.begin(self.copter)

    def run(self) -> None:
        self.copter.guided.update()

    def done(self) -> bool:
        return self.item.p1 == 0 or self.auto.bounds.passed(self.copter)


LEGS: dict[int, type[Leg]] = {
    16: Waypoint,
    17: LoiterForever,
    18: LoiterTurns,
    19: LoiterTime,
    20: ReturnToLaunch,
    21: LandAt,
    22: Takeoff,
    31: LoiterToAlt,
    82: Waypoint,
    84: Takeoff,
    85: LandAt,
    92: GuidedEnable,
    93: Delay,
}
