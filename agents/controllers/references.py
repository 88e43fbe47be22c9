"""What a controller is to follow, cycle by cycle: a place, a trajectory, the pilot's sticks, and what is injected.

Trajectories are the swarm's own segments, interpolated here: a bad link delays the next one, and not control.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from agents.controllers.inject import Inject, Injection
from agents.controllers.types import Level, Reference, State, plain
from zmav import wire
from zmav.errors import BadInput
from zmav.rotation import from_euler, wrap
from zmav.services.authority.trajectory import MAX_STEP, Segment

BRAKE = 3.0
"""m/s² at which a vehicle that is taken over in motion is brought to rest"""
STICK_LEVELS: tuple[Level, ...] = ("velocity", "attitude", "rates")
ORIGIN = wire.Origin(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0)
"""segments are only interpolated here, in their own frame"""


class References:
    """One vehicle's. ``limits``: what full sticks ask for, by the names of :mod:`agents.controllers.settings`. Not
    thread-safe: its user sees to that.
    """

    def __init__(self, limits: Mapping[str, float]) -> None:
        self._limits = limits
        self._pos, self._vel, self._yaw, self._since = np.zeros(3), np.zeros(3), 0.0, 0.0
        """where and how fast the vehicle was when it was to stop, and when"""
        self._segments: deque[Segment] = deque()
        self._stick_level: Level | None = None
        self._injection: Injection | None = None
        self._hover = 0.5
        self.injected = 0.0
        """what the injection added last"""

    # What to follow, from now on.

    def hold(self, state: State) -> None:
        """Come to rest from here, by the present heading."""
        self._pos, self._vel, self._yaw = state.pos.copy(), state.vel.copy(), state.yaw
        self._since = state.t
        self._segments.clear()
        self._stick_level = self._injection = None

    def goto(self, pos: wire.Vector, yaw: float | None, speed: float, accel: float, state: State) -> float:
        """To a place and back to rest, as smooth as a polynomial of the fifth degree; gives the seconds it takes.
        Raises :class:`BadInput` for what lasts too long, and as :meth:`follow`.
        """
        start = self._at(state)
        away = math.dist(pos, start.pos)
        # Of this polynomial the peaks are 15/8 of the mean speed and 10/sqrt(3) of way / time².
        lasts = max(1.875 * away / speed, math.sqrt(5.774 * away / accel), 1.0)
        if yaw is not None:
            lasts = max(lasts, abs(wrap(yaw - start.yaw)) / 1.0)
        if lasts > MAX_STEP:
            text = (
                f"the way takes {lasts:.0f} s, and {MAX_STEP:.0f} s are flown at once: go faster, or part of it first"
            )
            raise BadInput(text, field="speed", value=speed, expected=f"arrival within {MAX_STEP:.0f} s")
        rest = (0.0, 0.0, 0.0)
        points = [
            wire.SegmentPoint(t=state.t, pos=plain(start.pos), vel=rest, acc=rest, yaw=start.yaw),
            wire.SegmentPoint(t=state.t + lasts, pos=pos, vel=rest, acc=rest, yaw=start.yaw if yaw is None else yaw),
        ]
        self.follow(points, state)
        return lasts

    def follow(self, points: list[wire.SegmentPoint], state: State) -> None:
        """A trajectory; one that begins later takes the place of the present one when its time has come. Raises
        :class:`BadInput` naming the point and the field.
        """
        segment = Segment(points, ORIGIN, state.t)
        while self._segments and self._segments[-1].start >= segment.start:
            self._segments.pop()
        if segment.start > state.t and not self._segments:
            first = points[0].pos
            if math.dist(first, self._at(state).pos) > 1.0:
                text = "the segment begins in the future and elsewhere: more than a metre from what is followed now"
                raise BadInput(text, field="segment[0].pos", value=list(first), expected="where the reference is")
        self._segments.append(segment)
        self._stick_level = None

    def by_sticks(self, level: str, state: State, hover: float) -> None:
        """The pilot's sticks, as velocities, attitudes or rates; ``hover``: the thrust of the throttle's middle."""
        known = next((each for each in STICK_LEVELS if each == level), None)
        if known is None:
            raise BadInput.wrong("level", level, ", ".join(STICK_LEVELS), f"there are no sticks for {level}")
        if math.isnan(state.sticks[2]):
            raise BadInput("the pilot's radio is not heard", field="level", value=level, expected="RC_CHANNELS")
        self.hold(state)
        self._stick_level, self._hover = known, hover

    def inject(self, args: Inject, state: State) -> None:
        """On top of what is followed. Raises :class:`BadInput`."""
        self._injection = Injection(args, self.level, state.t)

    @property
    def level(self) -> Level:
        return self._stick_level or "position"

    @property
    def what(self) -> str:
        """In words."""
        if self._stick_level:
            return f"the sticks as {self._stick_level}"
        return "a trajectory" if self._segments else "a place"

    @property
    def ends(self) -> float:
        """UTC s at which the last trajectory comes to rest; 0: there is none."""
        return self._segments[-1].end if self._segments else 0.0

    # Each cycle.

    def lost(self, state: State) -> str | None:
        """Why there is nothing to follow any more: rates of zero would keep it as inclined as it is."""
        if self._stick_level == "rates" and math.isnan(state.sticks[2]):
            return "the pilot's radio is not heard any more, and the rates are his"
        return None

    def at(self, state: State) -> Reference:
        """For this cycle."""
        reference = self._by_sticks(state) if self._stick_level else self._at(state)
        self.injected = 0.0
        if self._injection is not None:
            self.injected = self._injection.apply(reference, state.t)
            if self._injection.done(state.t):
                self._injection = None
        return reference

    def _at(self, state: State) -> Reference:
        while len(self._segments) > 1 and self._segments[1].start <= state.t:
            self._segments.popleft()
        if self._segments and self._segments[0].start <= state.t:
            pos, vel, acc, yaw = self._segments[0].local(state.t)
            self._pos, self._vel, self._since = np.array(pos), np.zeros(3), state.t
            self._yaw = self._yaw if yaw is None else yaw
            return Reference("position", np.array(pos), np.array(vel), np.array(acc), self._yaw)
        return self._braking(state)

    def _braking(self, state: State) -> Reference:
        """From what it had to rest, evenly."""
        speed = float(np.linalg.norm(self._vel))
        if speed < 1e-3:
            return Reference("position", self._pos, yaw=self._yaw)
        lasts = speed / BRAKE
        t = min(max(state.t - self._since, 0.0), lasts)
        left = 1.0 - t / lasts
        pos = self._pos + self._vel * (t - 0.5 * t * t / lasts)
        acc = -self._vel / lasts if left > 0.0 else np.zeros(3)
        return Reference("position", pos, self._vel * left, acc, self._yaw)

    def _by_sticks(self, state: State) -> Reference:
        roll, pitch, throttle, yaw = (float(each) for each in state.sticks)
        tilt, turn, rate = (math.radians(self._limits[f"stick_{name}"]) for name in ("tilt_deg", "yaw_dps", "rate_dps"))
        speed, climb = self._limits["stick_speed"], self._limits["stick_climb"]
        if math.isnan(throttle):  # his radio went: level and at rest
            roll = pitch = yaw = 0.0
            throttle = 0.5
        self._yaw += yaw * turn * state.dt
        reference = Reference(self.level, state.pos.copy(), yaw=self._yaw, yaw_rate=yaw * turn)
        # Below the middle down to nothing, above it up to everything.
        reference.thrust = self._hover * throttle * 2.0 if throttle < 0.5 else self._lift(throttle)
        if self._stick_level == "rates":
            reference.rates = np.array([roll * rate, pitch * rate, yaw * turn])
        elif self._stick_level == "attitude":
            reference.attitude = np.array(from_euler(roll * tilt, pitch * tilt, self._yaw))
        else:
            c, s = math.cos(self._yaw), math.sin(self._yaw)
            ahead, right = -pitch * speed, roll * speed
            reference.vel = np.array([c * ahead - s * right, s * ahead + c * right, (1.0 - 2.0 * throttle) * climb])
        return reference

    def _lift(self, throttle: float) -> float:
        return self._hover + (1.0 - self._hover) * (2.0 * throttle - 1.0)
