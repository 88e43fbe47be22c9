"""A rover's way to a place in AUTO, RTL and SMART_RTL: straight legs with limited speed, acceleration and jerk that
run into each other in the corners, and turns on the spot where it can.

After ArduRover's waypoint navigation (ardupilot.org, "Rover: Tuning Navigation", "Pivot Turns"): a point runs along the
leg, slower where the rover falls behind.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.rotation import wrap
from zmav.sim.autopilots.arducopter.profile import Profile
from zmav.sim.control.roversetpoints import Point

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardurover.rover import ArduRover

SLOWEST = 0.05  # m/s that a speed may be set to
PIVOT_DONE = math.radians(5.0)
STILL = 0.1  # m/s at which a turn on the spot begins
AHEAD = 0.05  # of the speed, that the point gains on the rover
PATIENCE_S = 0.5  # after which a way that nobody drove is begun anew


class Leg:
    """One straight from ``start`` to ``end``."""

    def __init__(self, start: Point, end: Point, limits: tuple[float, float, float]) -> None:
        self.start, self.end = start, end
        length = math.dist(start, end)
        self.profile = Profile(length, *limits)
        self.along = ((end[0] - start[0]) / length, (end[1] - start[1]) / length) if length > 0 else (0.0, 0.0)
        self.time = 0.0

    @property
    def left(self) -> float:
        """Seconds to the end."""
        return max(self.profile.duration - self.time, 0.0)

    def motion(self) -> tuple[float, float, float]:
        """Distance gone, speed and acceleration now."""
        return self.profile.at(self.time)

    def passed(self, place: Point) -> bool:
        """Beyond the line through the end, across the leg."""
        return (place[0] - self.end[0]) * self.along[0] + (place[1] - self.end[1]) * self.along[1] >= 0.0


class Travel:
    """One rover's way."""

    def __init__(self, rover: ArduRover) -> None:
        self._rover = rover
        self.begin()

    def begin(self, speed: float = 0.0) -> None:
        """Forget what was; ``speed``: the highest, m/s (0: WP_SPEED)."""
        self.base_speed = max(speed if speed > 0.0 else self._rover.params["WP_SPEED"], SLOWEST)
        self.destination: Point | None = None
        self.reached = False
        self.reversed = False
        self._onward: Point | None = None
        self._leg: Leg | None = None
        self._next: Leg | None = None
        self._last: Leg | None = None
        self._pivoting = self._pivot_next = False
        self._pivot_until: float | None = None
        self._pace = 1.0
        self._planned = self.base_speed
        self._driven_at = -math.inf

    # ---- what it knows

    @property
    def here(self) -> Point:
        s = self._rover.sense
        return s.north, s.east

    @property
    def distance(self) -> float:
        """To the destination, m."""
        return math.dist(self.here, self.destination) if self.destination is not None else 0.0

    @property
    def bearing(self) -> float:
        """To the destination, rad."""
        if self.destination is None:
            return 0.0
        north, east = self.here
        return math.atan2(self.destination[1] - east, self.destination[0] - north)

    @property
    def cross_track(self) -> float:
        """Metres off the leg, positive to its left."""
        if self._leg is None:
            return 0.0
        north, east = self.here[0] - self._leg.start[0], self.here[1] - self._leg.start[1]
        along = self._leg.along
        if along == (0.0, 0.0):
            return math.hypot(north, east)
        return north * along[1] - east * along[0]

    @property
    def acceleration(self) -> float:
        """The highest along the way, m/s^2."""
        params = self._rover.params
        decel = params["ATC_DECEL_MAX"] if params["ATC_DECEL_MAX"] > 0 else params["ATC_ACCEL_MAX"]
        most = min(params["ATC_ACCEL_MAX"], decel)
        most = most if most > 0 else 20.0
        return max(min(params["WP_ACCEL"], most) if params["WP_ACCEL"] > 0 else most, 0.05)

    @property
    def jerk(self) -> float:
        return max(self._rover.params["WP_JERK"] if self._rover.params["WP_JERK"] > 0 else self.acceleration, 0.05)

    def stopping_place(self) -> Point:
        """Where it comes to a stop if it brakes now."""
        s, params = self._rover.sense, self._rover.params
        decel = params["ATC_DECEL_MAX"] if params["ATC_DECEL_MAX"] > 0 else params["ATC_ACCEL_MAX"]
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
            self._begin_pivot(destination, forced=self._pivot_next)
        self._next, self._pivot_next = None, False
        self.destination, self.reached, self._driven_at = destination, False, now
        self._onward = onward
        if onward is not None and self._would_pivot(start, destination, onward):
            self._onward, self._pivot_next = None, True

    def _plan(self, start: Point, end: Point) -> Leg:
        self._planned = self._speed
        return Leg(start, end, (self._planned, self.acceleration, self.jerk))

    @property
    def _speed(self) -> float:
        """The highest now: the pilot may ask for more with the throttle stick."""
        return max(self.base_speed, abs(self._rover.nudged(-self.base_speed if self.reversed else self.base_speed)))

    # ---- turns on the spot

    def _heading(self) -> float:
        return self.bearing + (math.pi if self.reversed else 0.0)

    def _can_pivot(self) -> bool:
        return self._rover.frame.skid and self._rover.params["WP_PIVOT_ANGLE"] > math.degrees(PIVOT_DONE)

    def _would_pivot(self, start: Point, corner: Point, onward: Point) -> bool:
        if not self._can_pivot():
            return False
        before = math.atan2(corner[1] - start[1], corner[0] - start[0])
        after = math.atan2(onward[1] - corner[1], onward[0] - corner[0])
        return abs(wrap(after - before)) > math.radians(self._rover.params["WP_PIVOT_ANGLE"])

    def _begin_pivot(self, destination: Point, *, forced: bool = False) -> None:
        """Turn first where the way there is far off the nose."""
        north, east = self.here
        yaw = math.atan2(destination[1] - east, destination[0] - north) + (math.pi if self.reversed else 0.0)
        off = abs(wrap(yaw - self._rover.sense.yaw))
        self._pivoting = self._can_pivot() and (forced or off > math.radians(self._rover.params["WP_PIVOT_ANGLE"]))
        self._pivot_until = None

    def turn_first(self, destination: Point) -> None:
        """Before a way that somebody else leads: turn on the spot where the place is far off the nose."""
        self._begin_pivot(destination)

    def pivots(self) -> bool:
        """Turn on the spot if that is due; True while it does."""
        if self._pivoting:
            self._pivot()
        return self._pivoting

    def _pivot(self) -> None:
        rover = self._rover
        yaw = self._heading()
        still = abs(rover.speed_ahead) < STILL
        if still:
            rover.sp.head(yaw, 0.0, math.radians(max(rover.params["WP_PIVOT_RATE"], 1.0)))
        else:
            rover.sp.turn(0.0, 0.0)
        if abs(wrap(yaw - rover.sense.yaw)) < PIVOT_DONE and self._pivot_until is None:
            self._pivot_until = rover.now + min(max(rover.params["WP_PIVOT_DELAY"], 0.0), 60.0)
        if self._pivot_until is not None and rover.now >= self._pivot_until:
            self._pivoting = False

    # ---- driving

    def ready(self) -> None:
        """Hand the limits and the direction to the controllers."""
        self._rover.sp.back(self.reversed)
        self._rover.sp.limits(self._speed, self.acceleration, self.jerk)

    def update(self) -> None:
        """Once a tick: the next target, and whether it is there."""
        rover, leg = self._rover, self._leg
        self._driven_at = rover.now
        self.ready()
        if leg is None or self.destination is None:
            rover.stop()
            return
        if self.pivots():
            return
        self._advance(leg)
        self._aim(leg)
        if not self.reached:
            if self._next is not None:
                self.reached = self._next.time >= leg.left
            elif leg.left == 0.0:
                self.reached = self.distance <= rover.params["WP_RADIUS"] or leg.passed(self.here)

    def _advance(self, leg: Leg) -> None:
        """The point goes on, as fast as the rover can follow."""
        rover = self._rover
        wanted = self._speed / max(self._planned, SLOWEST)
        _, speed, _ = leg.motion()
        if speed > 0.0:
            along, s = leg.along, rover.sense
            gone, _, _ = leg.motion()
            behind = gone - ((s.north - leg.start[0]) * along[0] + (s.east - leg.start[1]) * along[1])
            keeps_up = AHEAD + (s.vn * along[0] + s.ve * along[1] - rover.params["PSC_POS_P"] * behind) / speed
            wanted = min(wanted, max(keeps_up, 0.0))
        self._pace += (wanted - self._pace) * min(rover.dt * self.jerk / self.acceleration, 1.0)
        step = rover.dt * max(self._pace, 0.0)
        leg.time += step
        if self._last is not None:
            self._last.time += step
            if self._last.left == 0.0:
                self._last = None
        if self._next is not None:
            self._next.time += step
        elif self._onward is not None and not self.reached and leg.left <= leg.profile.ramp:
            self._begin_turn(leg, self._onward)

    def _begin_turn(self, leg: Leg, onward: Point) -> None:
        """Begin the next leg where the middle of the turn passes the corner close and gently enough."""
        params = self._rover.params
        following = self._plan(leg.end, onward)
        if leg.left > following.profile.ramp:
            return
        half = 0.5 * leg.left
        gone, speed, slowing = leg.profile.at(leg.time + half)
        on, start, rising = following.profile.at(half)
        before = gone - leg.profile.length
        off = [a * before + b * on for a, b in zip(leg.along, following.along, strict=True)]
        push = [a * slowing + b * rising for a, b in zip(leg.along, following.along, strict=True)]
        turn = [a * speed + b * start for a, b in zip(leg.along, following.along, strict=True)]
        radius = max(params["WP_RADIUS"], params["TURN_RADIUS"])
        if (
            math.hypot(*off) < radius
            and math.hypot(*push) < params["ATC_TURN_MAX_G"] * 9.81
            and math.hypot(*turn) <= max(leg.profile.speed, following.profile.speed) + 1e-6
        ):
            self._next = following

    def _aim(self, leg: Leg) -> None:
        """The sum of what the legs of a corner ask for."""
        gone, speed, accel = leg.motion()
        parts = [(leg.along, gone - leg.profile.length, speed, accel)]
        if self._last is not None:
            gone, speed, accel = self._last.motion()
            parts.append((self._last.along, gone - self._last.profile.length, speed, accel))
        if self._next is not None:
            parts.append((self._next.along, *self._next.motion()))
        corner = leg.end
        north, east = (corner[i] + sum(part[0][i] * part[1] for part in parts) for i in (0, 1))
        # However slowly the point goes on, it asks for the speed of the plan: that is what draws the rover along.
        vn, ve = (sum(part[0][i] * part[2] for part in parts) for i in (0, 1))
        an, ae = (sum(part[0][i] * part[3] for part in parts) for i in (0, 1))
        self._rover.sp.follow((north, east), (vn, ve), (an, ae))
