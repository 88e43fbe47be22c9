"""Flying from one place to the next, as ArduCopter's waypoint navigation does: straight, with limited jerk, and
through a corner without stopping where the way goes on, within WPNAV_RADIUS of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zmav.sim.autopilots.arducopter.base import CopterBase
from zmav.sim.autopilots.ardupilot.legs import Leg, Legs
from zmav.sim.control.setpoints import Vector

AT_REST = 0.5  # m/s: from faster than that, the copter is led to the place by its position controller alone
SHORTEST_LEG_M = 0.1
CENTI = 0.01


class Travel(Legs):
    """One vehicle's way to a place."""

    def __init__(self, copter: CopterBase) -> None:
        super().__init__()  # without a leg it is led by the position controller alone
        self._copter = copter
        self.destination: Vector = (0.0, 0.0, 0.0)
        self.reached = True
        self._onward: Vector | None = None
        self._follows = False
        """legs are over level ground: what the terrain is higher than home is added as they are flown"""

    def go(self, destination: Vector, onward: Vector | None = None, follows: bool = False) -> None:
        """Fly to ``destination`` (the world's NED), and not stop there where there is a place to go ``onward`` to.
        ``follows``: straight over the terrain, as ArduCopter does to places whose heights count from it.
        """
        copter, s = self._copter, self._copter.sense
        same, self._follows = self._follows == follows, follows
        end = self._level(destination)
        if same and self._next is not None and math.dist(self._next.end, end) < SHORTEST_LEG_M:
            self._last, self._leg = self._leg, self._next
        elif math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd) < AT_REST:
            start = self.destination if self.reached and self._near(self.destination) else (s.north, s.east, s.down)
            self._last, self._leg, self._pace = None, self._plan(self._level(start), end), 1.0
        else:
            self.release()
            copter.sp.move(pos=destination)
        self.destination, self._next = destination, None
        self._onward = None if onward is None else self._level(onward)
        self.reached = False
        if self._leg is not None:
            copter.sp.raw(True)

    def stop(self) -> None:
        """Stay at the place where the copter can stop."""
        s = self._copter.sense
        brake = max(self._copter.sp.limit_of("accel"), 0.1)
        ahead = 0.5 * math.hypot(s.vn, s.ve) / brake
        self.release()
        self.destination, self.reached = (s.north + s.vn * ahead, s.east + s.ve * ahead, s.down), False
        self._copter.sp.move(pos=self.destination)

    def release(self) -> None:
        """Somebody else sets the targets now."""
        self._leg = self._last = self._next = self._onward = None
        self._copter.sp.raw(False)

    def update(self) -> None:
        """Once a tick: the next target, and whether it is there."""
        if self._leg is not None:
            self._fly(self._leg)
        elif not self.reached:
            s = self._copter.sense
            slow = math.hypot(s.ref_vn, s.ref_ve) < AT_REST and abs(s.vd) < AT_REST
            self.reached = slow and self._near(self.destination)

    # ---- legs

    def _higher(self, north: float, east: float) -> float:
        return self._copter.above_home(north, east) if self._follows else 0.0

    def _level(self, place: Vector) -> Vector:
        """As it would be over level ground."""
        return place[0], place[1], place[2] + self._higher(place[0], place[1])

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
        if self._advance(leg, self._step(leg)) and self._onward is not None:
            self._begin_turn(leg, self._plan((leg.end[0], leg.end[1], leg.end[2]), self._onward))
        self._aim(leg)
        if not self.reached:
            if self._next is not None:
                self.reached = self._next.time >= leg.left
            elif leg.left == 0.0:
                self.reached = self._near(self.destination) or self._onward is not None
        copter.sp.raw(True)

    def _step(self, leg: Leg) -> float:
        """Seconds of the leg that this tick flies: fewer or more where the speed was changed."""
        copter = self._copter
        wanted = copter.speeds["speed"] / leg.planned
        most = copter.dt * copter.params["WPNAV_ACCEL"] * CENTI / max(leg.planned, 0.1)
        self._pace += min(max(wanted - self._pace, -most), most)
        return copter.dt * self._pace

    def _turn_fits(self, leg: Leg, following: Leg, off: float, speed: float, push: Sequence[float]) -> bool:
        params = self._copter.params
        corner = params["WPNAV_ACCEL_C"] or 2.0 * params["WPNAV_ACCEL"]
        slow = speed <= min(leg.profile.speed, following.profile.speed) + 1e-6
        return off < params["WPNAV_RADIUS"] * CENTI and slow and math.hypot(push[0], push[1]) < corner * CENTI

    def _aim(self, leg: Leg) -> None:
        place, vel, acc = self._motion(leg)
        pace, d, dt = self._pace, self._level(self.destination), self._copter.dt
        north, east, v = d[0] + place[0], d[1] + place[1], [each * pace for each in vel]
        up = self._higher(north, east)
        climbs = (self._higher(north + v[0] * dt, east + v[1] * dt) - up) / dt
        self._copter.sp.move(
            pos=(north, east, d[2] + place[2] - up),
            vel=(v[0], v[1], v[2] - climbs),
            acc=(acc[0] * pace * pace, acc[1] * pace * pace, acc[2] * pace * pace),
        )
