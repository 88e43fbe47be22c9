"""Flying from one place to the next, as ArduCopter's waypoint navigation does: straight, with limited jerk, and
through a corner without stopping where the way goes on.

In a corner the next leg begins while the last one ends, and their motions add up; it begins as late as keeps the turn
within WPNAV_RADIUS of the corner. Source: ardupilot.org, "Copter Position Control and Navigation", "S-Curves".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.profile import Profile
from zmav.sim.control.setpoints import Axis, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.copter import ArduCopter

AT_REST = 0.5  # m/s: from faster than that, the copter is led to the place by its position controller alone
SHORTEST_LEG_M = 0.1
CENTI = 0.01


class Leg:
    """One straight from ``start`` to ``end``, and how far it is flown; ``planned``: the ground speed that it is for."""

    def __init__(self, start: Vector, end: Vector, limits: tuple[float, float, float], planned: float) -> None:
        self.end = end
        self.planned = planned
        self.time = 0.0
        length = math.dist(start, end)
        self.profile = Profile(length, *limits)
        self.along = tuple((e - s) / length if length > 0 else 0.0 for s, e in zip(start, end, strict=True))

    @property
    def left(self) -> float:
        """Seconds to the end."""
        return max(self.profile.duration - self.time, 0.0)

    def motion(self, ahead: float = 0.0) -> tuple[float, float, float]:
        """Distance gone, speed and acceleration, now or so many seconds later."""
        return self.profile.at(self.time + ahead)


class Travel:
    """One vehicle's way to a place."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self.destination: Vector = (0.0, 0.0, 0.0)
        self.reached = True
        self.paused = False
        self._onward: Vector | None = None
        self._leg: Leg | None = None  # None: led by the position controller alone
        self._last: Leg | None = None  # the end of the one before, in a corner
        self._next: Leg | None = None
        self._pace = 1.0

    def go(self, destination: Vector, onward: Vector | None = None) -> None:
        """Fly to ``destination`` (the world's NED), and not stop there where there is a place to go ``onward`` to."""
        copter, s = self._copter, self._copter.sense
        if self._next is not None and math.dist(self._next.end, destination) < SHORTEST_LEG_M:
            self._last, self._leg = self._leg, self._next
        elif math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd) < AT_REST:
            start = self.destination if self.reached and self._near(self.destination) else (s.north, s.east, s.down)
            self._last, self._leg, self._pace = None, self._plan(start, destination), 1.0
        else:
            self.release()
            copter.sp.move(pos=destination)
        self.destination, self._onward, self._next = destination, onward, None
        self.reached = self.paused = False
        if self._leg is not None:
            copter.sp.raw(True)

    def stop(self) -> None:
        """Stay at the place where the copter can stop."""
        s = self._copter.sense
        brake = max(self._copter.sp.limit_of("accel"), 0.1)
        ahead = 0.5 * math.hypot(s.vn, s.ve) / brake
        self.release()
        self.destination, self.reached, self.paused = (
            (s.north + s.vn * ahead, s.east + s.ve * ahead, s.down),
            False,
            False,
        )
        self._copter.sp.move(pos=self.destination)

    def release(self) -> None:
        """Somebody else sets the targets now."""
        self._leg = self._last = self._next = self._onward = None
        self._copter.sp.raw(False)

    @property
    def distance(self) -> float:
        """To the destination over the ground, m."""
        s, d = self._copter.sense, self.destination
        return math.hypot(d[0] - s.north, d[1] - s.east)

    def pause(self) -> None:
        """Stop on the way; :meth:`resume` goes on."""
        self.paused = True
        if self._leg is None:
            self._copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)

    def resume(self) -> None:
        if self.paused and self._leg is None:
            self._copter.sp.move(pos=self.destination)
        self.paused = False

    def update(self) -> None:
        """Once a tick: the next target, and whether it is there."""
        if self._leg is not None:
            self._fly(self._leg)
        elif not self.reached and not self.paused:
            s = self._copter.sense
            slow = math.hypot(s.ref_vn, s.ref_ve) < AT_REST and abs(s.vd) < AT_REST
            self.reached = slow and self._near(self.destination)

    # ---- legs

    def _near(self, place: Vector) -> bool:
        s = self._copter.sense
        return math.dist((s.north, s.east, s.down), place) <= self._copter.params["WPNAV_RADIUS"] * CENTI

    def _plan(self, start: Vector, end: Vector) -> Leg:
        """The straight, with what the limits of ground and height allow along it."""
        copter = self._copter
        length = max(math.dist(start, end), 1e-6)
        level = math.dist(start[:2], end[:2]) / length
        steep = abs(end[2] - start[2]) / length
        climbs = end[2] < start[2]
        speed, accel = copter.speeds["speed"], max(copter.params["WPNAV_ACCEL"] * CENTI, 0.1)
        vertical = copter.speeds["speed_up" if climbs else "speed_down"]
        accel_z = max(copter.params["WPNAV_ACCEL_Z"] * CENTI, 0.1)
        limits = (
            min(speed / max(level, 1e-6), vertical / max(steep, 1e-6)),
            min(accel / max(level, 1e-6), accel_z / max(steep, 1e-6)),
            max(copter.params["WPNAV_JERK"], 0.05),
        )
        return Leg(start, end, limits, speed)

    def _fly(self, leg: Leg) -> None:
        copter = self._copter
        step = self._advance(leg)
        leg.time += step
        if self._last is not None:
            self._last.time += step
            if self._last.left == 0.0:
                self._last = None
        if self._next is not None:
            self._next.time += step
        elif self._onward is not None and not self.reached and leg.left <= leg.profile.ramp:
            self._begin_turn(leg, self._onward)
        self._aim(leg)
        if not self.reached:
            if self._next is not None:
                self.reached = self._next.time >= leg.left
            elif leg.left == 0.0:
                self.reached = self._near(self.destination) or self._onward is not None
        copter.sp.raw(True)

    def _advance(self, leg: Leg) -> float:
        """Seconds of the leg that this tick flies: fewer or more where the speed was changed, none in a pause."""
        copter = self._copter
        wanted = 0.0 if self.paused else copter.speeds["speed"] / leg.planned
        most = copter.dt * copter.params["WPNAV_ACCEL"] * CENTI / max(leg.planned, 0.1)
        self._pace += min(max(wanted - self._pace, -most), most)
        return copter.dt * self._pace

    def _begin_turn(self, leg: Leg, onward: Vector) -> None:
        """Begin the next leg where the middle of the turn would pass the corner close and slow enough."""
        following = self._plan(leg.end, onward)
        half = 0.5 * leg.left
        if leg.left > following.profile.ramp:
            return
        gone, speed, slowing = leg.motion(half)
        on, start, rising = following.motion(half)
        before = gone - leg.profile.length
        off = [a * before + b * on for a, b in zip(leg.along, following.along, strict=True)]
        turn = [a * speed + b * start for a, b in zip(leg.along, following.along, strict=True)]
        push = [a * slowing + b * rising for a, b in zip(leg.along, following.along, strict=True)]
        corner = self._copter.params["WPNAV_ACCEL_C"] or 2.0 * self._copter.params["WPNAV_ACCEL"]
        if (
            math.hypot(*off) < self._copter.params["WPNAV_RADIUS"] * CENTI
            and math.hypot(*turn) <= min(leg.profile.speed, following.profile.speed) + 1e-6
            and math.hypot(push[0], push[1]) < corner * CENTI
        ):
            self._next = following

    def _aim(self, leg: Leg) -> None:
        """The sum of what the legs of a corner ask for."""
        pace = self._pace
        gone, speed, accel = leg.motion()
        left = leg.profile.length - gone
        parts = [(leg.along, -left, speed, accel)]
        if self._last is not None:
            gone, speed, accel = self._last.motion()
            parts.append((self._last.along, gone - self._last.profile.length, speed, accel))
        if self._next is not None:
            parts.append((self._next.along, *self._next.motion()))
        place = [sum(along[i] * far for along, far, _, _ in parts) for i in range(3)]
        d = self.destination
        self._copter.sp.move(
            pos=(d[0] + place[0], d[1] + place[1], d[2] + place[2]),
            vel=_sum([(along, speed * pace) for along, _, speed, _ in parts]),
            acc=_sum([(along, accel * pace * pace) for along, _, _, accel in parts]),
        )


def _sum(parts: list[tuple[tuple[float, ...], float]]) -> Vector:
    north, east, down = (sum(along[i] * size for along, size in parts) for i in range(3))
    return north, east, down
