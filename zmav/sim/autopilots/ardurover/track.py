"""The track that SMART_RTL goes back on: points every SRTL_ACCURACY metres, without the loops that were driven.

https://ardupilot.org/rover/docs/smartrtl-mode.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.control.roversetpoints import Point

SAVE_EVERY_S = 1.0 / 3.0


class Track:
    """One rover's; ``usable`` is False once it has become too long, or was never begun."""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self.points: list[Point] = []
        self.usable = True
        self._next = 0.0

    def begin(self) -> None:
        """It was armed: here it goes back to."""
        self.points = [self._here]
        self.usable = self._vehicle.params["SRTL_POINTS"] > 0

    @property
    def _here(self) -> Point:
        return self._vehicle.sense.north, self._vehicle.sense.east

    def note(self) -> None:
        """Three times a second while it drives away."""
        vehicle = self._vehicle
        if not self.usable or not self.points or vehicle.now < self._next or not vehicle.position_ok:
            return
        self._next = vehicle.now + SAVE_EVERY_S
        here, step = self._here, max(vehicle.params["SRTL_ACCURACY"], 0.1)
        if math.dist(here, self.points[-1]) < step:
            return
        # Back where it was before: what lies between was a loop.
        for index in range(len(self.points) - 2):
            if math.dist(here, self.points[index]) < step:
                del self.points[index + 1 :]
                break
        self.points.append(here)
        self._simplify(step)
        if len(self.points) > vehicle.params["SRTL_POINTS"]:
            self.usable = False

    def _simplify(self, step: float) -> None:
        """A point between two others that lies on their line is none."""
        if len(self.points) < 3:
            return
        a, b, c = self.points[-3:]
        along = (c[0] - a[0], c[1] - a[1])
        length = math.hypot(*along)
        if length > 0.0 and abs((b[0] - a[0]) * along[1] - (b[1] - a[1]) * along[0]) / length < 0.25 * step:
            del self.points[-2]

    def way_back(self) -> list[Point]:
        """The places to go to, home last."""
        return self.points[::-1]
