"""Where an ArduPlane goes: from one place to the next, or round one, and at which height.

https://ardupilot.org/plane/docs/navigation-tuning.html; heights between two places: ALT_SLOPE_MIN
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.arduplane.base import PlaneBase
from zmav.sim.control.setpoints import Vector

USUAL_RADIUS_M = 60.0
LOW_M = 20.0  # below it AUTO climbs at once
DIRECT_RADII = 3.0  # nearer than that a circle is flown to by itself
HEIGHT_REACHED_M = 5.0


class Way:
    """``start`` and ``end`` are places of the world's NED; ``crosstrack``: the line between them is kept."""

    def __init__(self, plane: PlaneBase) -> None:
        self._plane = plane
        self.power_on()

    def power_on(self) -> None:
        self.start: Vector = self._plane.here
        self.end: Vector = self.start
        self.crosstrack = False
        self.next_crosstrack = True
        self.counter_clockwise = False
        self.radius = USUAL_RADIUS_M
        self.arrived_at: float | None = None  # on the circle
        self.turned = 0.0  # rad round the circle
        self.reached_height = False
        self._rise = 0.0  # of the slope, m; 0: there is none
        self._bearing: float | None = None

    # ---- where to

    def go(self, end: Vector) -> None:
        """On to the next place of a mission: along the line from the last one."""
        here = self._plane.here
        self.start, self.end = (self.end if self.next_crosstrack else here), end
        self.crosstrack, self.next_crosstrack = self.next_crosstrack, True
        if self.share >= 1.0:
            # The line lies behind already.
            self.start = here
        self._begin()
        auto = self._plane.mode is self._plane.auto
        if not auto or self._plane.height > LOW_M or end[2] > here[2]:
            self._slope()

    def direct(self, end: Vector) -> None:
        """Straight there from here; down on a slope, up at once."""
        self.start, self.end = self._plane.here, end
        self.crosstrack = self.next_crosstrack = False
        self._begin()
        if end[2] > self.start[2]:
            self._slope()

    def stay(self) -> None:
        """Round this place, at this height."""
        self.direct(self._plane.here)

    def level(self) -> None:
        """To the end's height at once, without a slope."""
        self._rise = 0.0

    def _begin(self) -> None:
        self.counter_clockwise = self._plane.params["WP_LOITER_RAD"] < 0
        self.arrived_at, self.turned, self._bearing = None, 0.0, None
        self.reached_height = False
        self._rise = 0.0

    def _slope(self) -> None:
        rise = self.start[2] - self.end[2]
        self._rise = rise if abs(rise) >= self._plane.params["ALT_SLOPE_MIN"] else 0.0

    # ---- how far

    @property
    def share(self) -> float:
        """Of the line that lies behind: 0 at its start, 1 at its end, and beyond."""
        here = self._plane.here
        line = self.end[0] - self.start[0], self.end[1] - self.start[1]
        length = line[0] ** 2 + line[1] ** 2
        if length < 1e-6:
            return 1.0
        return ((here[0] - self.start[0]) * line[0] + (here[1] - self.start[1]) * line[1]) / length

    @property
    def distance(self) -> float:
        """To its end over the ground, m."""
        here = self._plane.here
        return math.hypot(self.end[0] - here[0], self.end[1] - here[1])

    @property
    def bearing(self) -> float:
        """To its end, rad."""
        here = self._plane.here
        return math.atan2(self.end[1] - here[1], self.end[0] - here[0])

    @property
    def course(self) -> float:
        """Of the line, rad."""
        return math.atan2(self.end[1] - self.start[1], self.end[0] - self.start[0])

    @property
    def down(self) -> float:
        """The height to fly now: metres down of the world's origin."""
        if self._rise == 0.0 or self.arrived_at is not None:
            return self.end[2]
        return self.end[2] + self._rise * (1.0 - min(max(self.share, 0.0), 1.0))

    # ---- flying it

    def follow(self) -> None:
        """Along the line."""
        start = self.start if self.crosstrack else self._plane.here
        self._plane.sp.line(start[:2], self.end[:2])

    def circle(self, radius: float = 0.0) -> None:
        """Round its end, and there first where that is far; 0: WP_LOITER_RAD."""
        plane = self._plane
        size = abs(radius)
        if size <= 1.0:
            size = abs(plane.params["WP_LOITER_RAD"])
        # As large as the air is thin: the same bank flies it at any height.
        self.radius = (size if size > 1.0 else USUAL_RADIUS_M) * plane.eas2tas**2
        far = self.distance > DIRECT_RADII * self.radius
        if self.arrived_at is None and self.crosstrack and far:
            self.follow()
            return
        plane.sp.circle(self.end[:2], -self.radius if self.counter_clockwise else self.radius)
        self._watch_circle()

    @property
    def circling(self) -> bool:
        """It is on the circle."""
        return bool(self._plane.sp.flown().circling)

    def _watch_circle(self) -> None:
        plane = self._plane
        here = plane.here
        if self.arrived_at is None and (self.circling or (self.crosstrack and self.share > 1.0)):
            self.arrived_at = plane.now
        if not self.circling:
            return
        bearing = math.atan2(here[1] - self.end[1], here[0] - self.end[0])
        if self._bearing is not None:
            self.turned += abs(math.remainder(bearing - self._bearing, math.tau))
        self._bearing = bearing
        self.reached_height |= abs(here[2] - self.end[2]) < HEIGHT_REACHED_M

    def lined_up(self, onward: Vector) -> bool:
        """It flies toward the next place; after every circle that is seen less strictly."""
        s, here = self._plane.sense, self._plane.here
        away = math.hypot(onward[0] - self.end[0], onward[1] - self.end[1])
        wanted = math.atan2(onward[1] - here[1], onward[0] - here[0])
        if away < self.radius:
            # It lies inside the circle, whose tangents never meet it: the turn is as good as any.
            return True
        allowed = math.radians(10.0) * (1 + int(self.turned / (2.0 * math.pi)))
        miss = math.remainder(wanted - math.atan2(s.ve, s.vn), math.tau)
        return abs(miss) <= allowed
