"""Aircraft that are not of the fleet, as obstacles that move: balls, which grow with their age."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable

from agents.planner.live.world import Passing
from zmav import wire
from zmav.traffic import AirPicture, Seen, read
from zmav.wire import Vector, swarm

MOST, WITHIN_M = 16, 10_000.0
"""aircraft that are kept clear of, the nearest, and m from a vehicle within which: of 60 m/s some three minutes"""

RENEWED = 1.0
"""s until an aircraft is heard again, mostly: it may have turned by then"""


class TrafficWatch:
    """``radius``: m that vehicles keep from where an aircraft is taken to be; 0: they keep clear of none."""

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._picture = AirPicture()

    def hear(self, data: bytes) -> None:
        """A report. Raises :class:`~zmav.errors.BadInput`."""
        self._picture.hear(read(data), time.monotonic(), time.time())

    def obstacles(self, states: Iterable[wire.VehicleState], now: float, utc: float) -> list[Passing]:
        """In the fleet's frame, by vehicles that say where they are both in it and on the globe; at UTC ``utc``.

        What stands on the ground is left out, and what flies at a height that nobody knows is at the vehicle's.
        """
        known = [(s.position, s.local) for s in states if s.position is not None and s.local is not None]
        if not known or not self._radius:
            return []
        near: list[tuple[float, Seen, Vector, Vector]] = []
        for seen in self._picture.aircraft(now):
            if seen.aircraft.ground:
                continue
            far, place, velocity = min(_from(seen, position, local) for position, local in known)
            if far <= WITHIN_M:
                near.append((far, seen, place, velocity))
        near.sort(key=lambda each: each[0])
        return [self._ball(seen, place, velocity, utc) for _, seen, place, velocity in near[:MOST]]

    def _ball(self, seen: Seen, place: Vector, velocity: Vector, utc: float) -> Passing:
        """As large as its place, over the ground or in height, may be off."""
        height = 0.0 if seen.amsl is None else seen.height_error
        now, then = (max(each.error, height) for each in (seen, seen._replace(age=seen.age + RENEWED)))
        ball = swarm.Ball(center=place, radius=self._radius + now, velocity=velocity)
        return Passing(swarm.Obstacle(name=f"traffic {seen.name}", t=utc, what=ball), then - now)


def _from(seen: Seen, position: wire.GlobalPosition, local: Vector) -> tuple[float, Vector, Vector]:
    """m over the ground from a vehicle, and place and velocity in the fleet's frame."""
    (north, east, down), velocity = seen.ned(position)
    place = local[0] + north, local[1] + east, local[2] + down
    return math.hypot(north, east), place, velocity
