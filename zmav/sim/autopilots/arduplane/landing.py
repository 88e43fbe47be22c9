"""How an ArduPlane lands by itself: down a slope to a place before the landing point, and a flare.

https://ardupilot.org/plane/docs/automatic-landing.html
"""

from __future__ import annotations

import enum
import math

from zmav.sim.autopilots.ardupilot.state import INFO
from zmav.sim.autopilots.arduplane.base import PlaneBase
from zmav.sim.autopilots.arduplane.way import Way
from zmav.sim.control.planetargets import Stage

LINED_UP, ON_LINE_M = math.radians(10.0), 5.0
AHEAD_M = 200.0  # beyond where it is, the line is followed
AIM_BEYOND_M = 500.0


class Leg(enum.IntEnum):
    """Of a landing."""

    NORMAL = 0
    APPROACH = 1
    FINAL = 2


class Landing:
    """A landing along the way's line, at its end."""

    def __init__(self, plane: PlaneBase, way: Way) -> None:
        self._plane, self._way = plane, way
        self.leg = Leg.NORMAL
        self.active = False
        self._slope: float | None = None
        self._loitered = False

    @property
    def flaring(self) -> bool:
        return self.active and self.leg is Leg.FINAL

    @property
    def height(self) -> float:
        """Over the place to land at, m."""
        return self._way.end[2] - self._plane.sense.down

    def begin(self, *, loitered: bool) -> None:
        """The way leads there. ``loitered``: the approach follows a descent in circles, and is one from its start."""
        self.leg, self._slope, self.active, self._loitered = Leg.NORMAL, None, True, loitered
        self._plane.say(INFO, f"Landing approach start at {self._plane.height:.1f}m")

    def stop(self) -> None:
        self.active = False

    def update(self) -> None:
        """Fly on."""
        plane, way = self._plane, self._way
        if self.leg is Leg.NORMAL and self._approaches():
            self.leg = Leg.APPROACH
        self._watch_flare()
        done = max(way.share, 0.0) * math.hypot(way.end[0] - way.start[0], way.end[1] - way.start[1])
        course = way.course
        reach = done + AHEAD_M
        end = way.start[0] + reach * math.cos(course), way.start[1] + reach * math.sin(course)
        plane.sp.line(way.start[:2], end)
        self._descend()
        if self.flaring and plane.disarm_after_landing():
            plane.say(INFO, f"Distance from LAND point={way.distance:.2f}m")

    def _approaches(self) -> bool:
        plane, share = self._plane, self._way.share
        flown = plane.sp.flown()
        straight, near = abs(flown.error) < LINED_UP, abs(flown.cross_track) < ON_LINE_M
        lower = plane.sense.down > self._way.start[2]
        aligned = straight and ((share >= 0 and near) or (share > 0.15 and lower))
        return self._loitered or aligned or share > 0.5

    def _watch_flare(self) -> None:
        plane, params, s = self._plane, self._plane.params, self._plane.sense
        if self.leg is Leg.FINAL:
            return
        height, sink, share = self.height, s.vd, self._way.share
        soon = params["LAND_FLARE_SEC"] > 0 and height <= sink * params["LAND_FLARE_SEC"] and share > 0.5
        if (self.leg >= Leg.APPROACH and (height <= params["LAND_FLARE_ALT"] or soon)) or share >= 1.0:
            self.leg = Leg.FINAL
            plane.say(
                INFO,
                f"Flare {height:.1f}m sink={sink:.2f} speed={plane.groundspeed:.1f} dist={self._way.distance:.1f}",
            )

    # ---- heights and speeds

    def _descend(self) -> None:
        plane, way = self._plane, self._way
        ground = -way.end[2]
        if self.leg is Leg.NORMAL:
            plane.fly_height(-way.down, self.airspeed, Stage.NORMAL)
            return
        height = ground if self.flaring else self._slope_height()
        plane.fly_height(height, self.airspeed, Stage.FLARE if self.flaring else Stage.LAND, ground)

    def _slope_height(self) -> float:
        """Where the slope is now: to a point before and above the landing point, from which the flare sinks on."""
        plane, params, way = self._plane, self._plane.params, self._way
        total = max(math.hypot(way.end[0] - way.start[0], way.end[1] - way.start[1]), 1.0)
        drop = way.end[2] - way.start[2]
        speed = max(plane.groundspeed, 0.5)
        sink = drop / max(total / speed, 0.5)
        aim = params["LAND_FLARE_SEC"] * sink
        aim = aim if aim > 0 else params["LAND_FLARE_ALT"]
        if params["LAND_FLARE_ALT"] > 0:
            aim = min(aim, 2.0 * params["LAND_FLARE_ALT"])
        weight = min(max(0.01 * params["LAND_FLARE_AIM"], 0.0), 1.0)
        sinking = max(weight * params["TECS_LAND_SINK"] + (1.0 - weight) * sink, 0.1)
        before = min(speed * aim / sinking, 0.5 * total)
        slope = (drop - aim) / (total - before)
        if self._slope is None:
            plane.say(INFO, f"Landing glide slope {math.degrees(math.atan(slope)):.1f} degrees")
        self._slope = slope
        gone = min(max(way.share, 0.0) * total, total - before + AIM_BEYOND_M)
        height = -way.start[2] - slope * gone
        return min(max(height, -way.end[2] + aim - slope * AIM_BEYOND_M), -way.start[2])

    @property
    def airspeed(self) -> float:
        """Equivalent, m/s: slower on the approach."""
        params = self._plane.params
        cruise = params["AIRSPEED_CRUISE"]
        if self.leg is Leg.NORMAL:
            return cruise
        speed = params["TECS_LAND_ARSPD"]
        return speed if speed >= 0 else 0.5 * (cruise + params["AIRSPEED_MIN"])
