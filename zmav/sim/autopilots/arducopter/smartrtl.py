"""SMART_RTL: home by the way it came, without its loops. https://ardupilot.org/copter/docs/smartrtl-mode.html"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.modes import CENTI, CopterMode, descend
from zmav.sim.control.setpoints import Axis, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

SAVE_EVERY_S = 1.0 / 3.0
LOST_S = 15.0  # without a position: the way is not known any more
ABOVE_START_M = 2.0
WARNING = 4


class Breadcrumbs:
    """The way since arming: points SRTL_ACCURACY metres apart, no more than SRTL_POINTS of them."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self.points: list[Vector] = []
        self._next = self._good = 0.0

    @property
    def usable(self) -> bool:
        return bool(self.points)

    def begin(self) -> None:
        """It was armed: here it goes back to."""
        self._good = self._copter.now
        enough = self._copter.params["SRTL_POINTS"] > 0 and self._copter.position_ok
        self.points = [self._here] if enough else []

    @property
    def _here(self) -> Vector:
        s = self._copter.sense
        return s.north, s.east, s.down

    def drop(self, why: str) -> None:
        """The way is lost until the next arming."""
        if self.points:
            self.points = []
            self._copter.say(WARNING, f"SmartRTL deactivated: {why}")

    def note(self) -> None:
        """Called while it flies elsewhere; three times a second it looks whether it has moved."""
        copter = self._copter
        if not self.points or copter.now < self._next:
            return
        self._next = copter.now + SAVE_EVERY_S
        if not copter.position_ok:
            if copter.now - self._good > LOST_S:
                self.drop("bad position")
            return
        self._good = copter.now
        here, step = self._here, max(copter.params["SRTL_ACCURACY"], 0.1)
        if math.dist(here, self.points[-1]) < step:
            return
        self._cut_loop(here, step)
        self.points.append(here)
        if len(self.points) > copter.params["SRTL_POINTS"]:
            self.points = thinned(self.points, 0.5 * step)
            if len(self.points) > copter.params["SRTL_POINTS"]:
                self.drop("buffer full")

    def _cut_loop(self, here: Vector, step: float) -> None:
        """Back where it was before: what lies between was a loop."""
        for index, point in enumerate(self.points[:-2]):
            if math.dist(here, point) < step:
                del self.points[index + 1 :]
                return

    def way_back(self) -> list[Vector]:
        """The places to go to, the start last."""
        return thinned(self.points, 0.5 * max(self._copter.params["SRTL_ACCURACY"], 0.1))[::-1]


def thinned(points: list[Vector], within: float) -> list[Vector]:
    """As few of the points as keep the line within so many metres: Ramer, Douglas and Peucker's algorithm."""
    if len(points) < 3:
        return list(points)
    offsets = [_aside(point, points[0], points[-1]) for point in points[1:-1]]
    worst = max(range(len(offsets)), key=offsets.__getitem__)
    if offsets[worst] <= within:
        return [points[0], points[-1]]
    middle = worst + 1
    return thinned(points[: middle + 1], within)[:-1] + thinned(points[middle:], within)


def _aside(point: Vector, a: Vector, b: Vector) -> float:
    """Distance of a point from the piece of line between two others."""
    ab = [q - p for p, q in zip(a, b, strict=True)]
    square = sum(c * c for c in ab)
    share = 0.0
    if square > 0.0:
        share = min(max(sum((p - q) * c for p, q, c in zip(point, a, ab, strict=True)) / square, 0.0), 1.0)
    return math.dist(point, [p + share * c for p, c in zip(a, ab, strict=True)])


class SmartRtl(CopterMode):
    number, name, changes_speed = 21, "SMARTRTL", True

    def __init__(self, copter: ArduCopter) -> None:
        super().__init__(copter)
        self._way: list[Vector] = []
        self._at = 0
        self._landing = False

    @property
    def is_landing(self) -> bool:
        return self._landing

    def refusal(self) -> str:
        return "" if self.copter.crumbs.usable else "init failed"

    def enter(self) -> None:
        copter = self.copter
        self._way, self._at, self._landing = copter.crumbs.way_back(), 0, False
        if not self._way:
            return
        north, east, down = self._way[-1]
        self._way[-1] = (north, east, down - ABOVE_START_M)
        copter.travel.release()
        copter.heading.along(copter.params["WP_YAW_BEHAVIOR"], copter.sense.yaw)
        self._go()

    def _go(self) -> None:
        onward = self._way[self._at + 1] if self._at + 1 < len(self._way) else None
        self.copter.travel.go(self._way[self._at], onward)

    def leave(self) -> None:
        """What was flown back is not on the way any more."""
        crumbs = self.copter.crumbs
        left = self._way[self._at :]
        if crumbs.usable and left and not self._landing:
            crumbs.points = [crumbs.points[0], *left[-2::-1]]
        self.copter.travel.release()

    def update(self) -> None:
        copter = self.copter
        if not copter.spool():
            return
        if self._landing:
            descend(copter)
            return
        copter.travel.update()
        if not copter.travel.reached:
            return
        self._at += 1
        if self._at < len(self._way):
            self._go()
        elif copter.params["RTL_ALT_FINAL"] * CENTI <= 0.0 or copter.rc.lost:
            self._at = len(self._way) - 1
            self._landing = True
            copter.travel.release()
            copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
            copter.heading.hold(copter.sense.yaw)
        else:
            self._at = len(self._way) - 1  # RTL_ALT_FINAL: it waits over its start
