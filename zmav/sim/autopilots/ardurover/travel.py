"""A rover's way to a place in AUTO and RTL: straight legs with limited speed, acceleration and jerk that
run into each other in the corners.

After ArduRover's waypoint navigation (ardupilot.org, "Rover: Tuning Navigation"): a point runs along the
leg, slower where the rover falls behind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zmav.sim.autopilots.ardupilot.legs import Leg, Legs
from zmav.sim.autopilots.ardurover.base import RoverBase
from zmav.sim.control.roversetpoints import Point

SLOWEST = 0.05  # m/s that a speed may be set to
AHEAD = 0.05  # of the speed, that the point gains on the rover
PATIENCE_S = 0.5  # after which a way that nobody drove is begun again


class Travel(Legs):
    """One rover's way."""

    def __init__(self, rover: RoverBase) -> None:
        super().__init__()
        self._rover = rover
        self.begin()

    def begin(self, speed: float = 0.0) -> None:
        """Forget what was; ``speed``: the highest, m/s (0: WP_SPEED)."""
        self.base_speed = max(speed if speed > 0.0 else self._rover.params["WP_SPEED"], SLOWEST)
        self.destination: Point | None = None
        self.reached = False
        self._onward: Point | None = None
        self._leg = self._next = self._last = None
        self._pace = 1.0
        self._driven_at = -math.inf

    # ---- what it knows

    @property
    def cross_track(self) -> float:
        """Metres off the leg, positive to its left."""
        if self._leg is None:
            return 0.0
        here = self._rover.here
        north, east = here[0] - self._leg.start[0], here[1] - self._leg.start[1]
        along = self._leg.along
        if along == (0.0, 0.0):
            return math.hypot(north, east)
        return north * along[1] - east * along[0]

    @property
    def _braking(self) -> float:
        """The hardest, m/s^2; 0: without a limit."""
        params = self._rover.params
        return params["ATC_DECEL_MAX"] if params["ATC_DECEL_MAX"] > 0 else params["ATC_ACCEL_MAX"]

    @property
    def acceleration(self) -> float:
        """The highest along the way, m/s^2."""
        params = self._rover.params
        most = min(params["ATC_ACCEL_MAX"], self._braking) or 20.0
        return max(min(params["WP_ACCEL"], most) if params["WP_ACCEL"] > 0 else most, 0.05)

    @property
    def jerk(self) -> float:
        return max(self._rover.params["WP_JERK"] or self.acceleration, 0.05)

    def stopping_place(self) -> Point:
        """Where it comes to a stop if it brakes now."""
        s, decel = self._rover.sense, self._braking
        speed = math.hypot(s.vn, s.ve)
        share = 0.5 * speed / decel if decel > 0 else 0.0
        return s.north + s.vn * share, s.east + s.ve * share

    # ---- orders

    def change_speed(self, speed: float) -> bool:
        if not speed >= SLOWEST:
            return False
        self.base_speed = speed
        return True

    def go(self, destination: Point, onward: Point | None = None) -> None:
        """Drive to ``destination``, and not stop there where there is a place to go ``onward`` to."""
        now = self._rover.now
        interrupted = now - self._driven_at > PATIENCE_S or not self.reached
        start = self.stopping_place() if interrupted or self.destination is None else self.destination
        joined = self._next if not interrupted and self._next is not None else None
        if joined is not None and math.dist(joined.end, destination) < 0.1:
            self._last, self._leg = self._leg, joined
        else:
            self._last, self._leg = None, self._plan(start, destination)
            self._pace = 1.0
        self._next = None
        self.destination, self.reached, self._driven_at = destination, False, now
        self._onward = onward

    def _plan(self, start: Point, end: Point) -> Leg:
        return Leg(start, end, (self.base_speed, self.acceleration, self.jerk), self.base_speed)

    # ---- driving

    def ready(self) -> None:
        """Hand the limits and the direction to the controllers."""
        self._rover.sp.limits(self.base_speed, self.acceleration, self.jerk)

    def update(self) -> None:
        """Once a tick: the next target, and whether it is there."""
        rover, leg = self._rover, self._leg
        self._driven_at = rover.now
        self.ready()
        if leg is None or self.destination is None:
            rover.sp.stop()
            return
        if self._advance(leg, self._step(leg)) and self._onward is not None:
            self._begin_turn(leg, self._plan((leg.end[0], leg.end[1]), self._onward))
        self._aim(leg)
        if not self.reached:
            if self._next is not None:
                self.reached = self._next.time >= leg.left
            elif leg.left == 0.0:
                near = math.dist(rover.here, self.destination) <= rover.params["WP_RADIUS"]
                self.reached = near or leg.gone_beyond(rover.here) >= 0.0

    def _step(self, leg: Leg) -> float:
        """Seconds of the plan that the point goes on by: no faster than the rover can follow."""
        rover = self._rover
        wanted = self.base_speed / max(leg.planned, SLOWEST)
        _, speed, _ = leg.motion()
        if speed > 0.0:
            along, s = leg.along, rover.sense
            gone, _, _ = leg.motion()
            behind = gone - ((s.north - leg.start[0]) * along[0] + (s.east - leg.start[1]) * along[1])
            keeps_up = AHEAD + (s.vn * along[0] + s.ve * along[1] - rover.params["PSC_POS_P"] * behind) / speed
            wanted = min(wanted, max(keeps_up, 0.0))
        self._pace += (wanted - self._pace) * min(rover.dt * self.jerk / self.acceleration, 1.0)
        return rover.dt * max(self._pace, 0.0)

    def _turn_fits(self, leg: Leg, following: Leg, off: float, speed: float, push: Sequence[float]) -> bool:
        params = self._rover.params
        gentle = math.hypot(*push) < params["ATC_TURN_MAX_G"] * 9.81
        slow = speed <= max(leg.profile.speed, following.profile.speed) + 1e-6
        return off < max(params["WP_RADIUS"], params["TURN_RADIUS"]) and gentle and slow

    def _aim(self, leg: Leg) -> None:
        """However slowly the point goes on, it asks for the speed of the plan: that is what draws the rover along."""
        place, vel, acc = self._motion(leg)
        north, east = leg.end
        self._rover.sp.follow((north + place[0], east + place[1]), (vel[0], vel[1]), (acc[0], acc[1]))
