"""A navigation filter (EKF) as its autopilot and a ground station see it: which sensors it trusts, and for how long it
goes on without them. What ArduPilot's and PX4's have in common; the sensors' errors are in :mod:`zmav.sim.sensors`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Generic, Protocol, TypeVar

from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.fleets.base import Sense
from zmav.sim.sensors.estimate import Belief

GATE = 5.0  # standard deviations that a measurement may be off
DEAD_RECKONING = 0.02  # m/s^2 that a tilt error of a tenth of a degree makes
TURNED_ENOUGH = 0.5  # rad of error that flying can show
SHOWN_MPS = 6.0  # of speed gained the wrong way, until the heading is taken from the GPS


class Autopilot(Protocol):
    """What a filter looks at."""

    now: float
    armed: bool
    sense: Sense


V = TypeVar("V", bound=Autopilot)


class NavigationFilter(ABC, Generic[V]):
    """One vehicle's filter. :meth:`update` is called ten times a second."""

    USUAL: ClassVar[dict[str, float]]
    """test ratios where nothing is wrong"""
    POSITION_VARIANCE: ClassVar[float]
    """m^2 of a GPS innovation per axis"""
    HEIGHT_VARIANCE: ClassVar[float]
    GROWTH: ClassVar[float]
    """m^2/s of the position's variance without fusion"""
    REACQUIRE_S: ClassVar[float]
    """from the GPS's return until it is used again, after it was given up"""
    RESET_AFTER_S: ClassVar[float]
    """of solutions that are not believed, until one is taken for true"""
    HEIGHT_RETRY_S: ClassVar[float] = math.inf
    """after which a height that is out of its gate is taken for true"""

    def __init__(self, vehicle: V) -> None:
        self._vehicle = vehicle
        self.belief: Belief | None = None
        """what it steers: the estimate of the body that the autopilot sits in"""
        self.power_on()

    def power_on(self) -> None:
        """Start from nothing."""
        self._leading = False
        self._passed = self._height_passed = self._vehicle.now
        self._shown = self._turn_seen = 0.0
        self._by_course = False
        self._back_at: float | None = None
        self._slip = (0.0, 0.0)
        self._variance = self.POSITION_VARIANCE
        self.glitching = False
        self.ratios = dict(self.USUAL)
        if self.belief is not None and self.belief.led:
            self.belief.forget()

    # ---- what it knows

    @property
    @abstractmethod
    def good(self) -> bool:
        """Its position is one to go by, once there has been one."""

    @property
    def has_fix(self) -> bool:
        """The GPS has a solution."""
        return self.belief is None or self.belief.has_fix

    @property
    def aiding(self) -> bool:
        """It goes by the GPS."""
        return True

    # ---- ten times a second

    def update(self, dt: float) -> None:
        belief = self.belief
        if belief is None or not (belief.troubled or self._leading) or not self.started:
            return
        if not self._leading:
            self._leading = True
            self._passed = self._height_passed = self._vehicle.now
            self.begin()
            belief.lead(True)
        self.watch_gps(belief, dt)
        self.watch_compass(belief, dt)
        self._watch_height(belief)
        if not belief.troubled and self.recovered(belief):
            self._leading = False
            belief.lead(False)

    @property
    def started(self) -> bool:
        """There has been a position."""
        return True

    def begin(self) -> None:
        """Something has begun to be wrong."""

    def recovered(self, belief: Belief) -> bool:
        """Nothing is left of what was wrong."""
        close = max(map(abs, belief.innovation)) < 0.05 and abs(belief.yaw_error) < 0.005
        return close and self.good and not self.glitching

    def watch_gps(self, belief: Belief, dt: float) -> None:
        """Follow the GPS, or not."""
        now = self._vehicle.now
        if not belief.has_fix:
            # Dead reckoning: an error of the tilt, which nobody corrects, becomes speed.
            self._back_at = None
            belief.follow(False)
            gain, way = DEAD_RECKONING * dt, self.drift()
            self._slip = self._slip[0] + gain * way[0], self._slip[1] + gain * way[1]
            if self.aiding:
                belief.slide(*self._slip)
            self.without_fix(belief)
            return
        self._back_at = now if self._back_at is None else self._back_at
        if not self.listens:
            if now - self._back_at >= self.REACQUIRE_S:
                self.reset(belief)
            return
        self._slip = (0.0, 0.0)
        belief.slide(0.0, 0.0)
        ratio = self.position_ratio(belief.innovation[0], belief.innovation[1])
        self.ratios["position"] = max(ratio, self.USUAL["position"])
        if ratio < 1.0:
            self._passed, self._variance = now, self.POSITION_VARIANCE
            belief.follow(True)
            self.judge(believed=True)
            return
        belief.follow(False)
        self._variance += self.GROWTH * dt
        self.judge(believed=False)
        if now - self._passed > self.RESET_AFTER_S:
            self.reset(belief)

    def reset(self, belief: Belief) -> None:
        """Take the GPS's place and speed for true."""
        belief.reset_position()
        self._slip = (0.0, 0.0)
        self._passed, self._variance = self._vehicle.now, self.POSITION_VARIANCE
        self.ratios["position"], self.ratios["velocity"] = self.USUAL["position"], self.USUAL["velocity"]

    def drift(self) -> tuple[float, float]:
        """Which way it slides without GPS, north and east."""
        return 1.0, 0.5

    @abstractmethod
    def without_fix(self, belief: Belief) -> None:
        """There is no solution: give the position up after a while."""

    @property
    @abstractmethod
    def listens(self) -> bool:
        """It has not given the GPS up."""

    @abstractmethod
    def position_ratio(self, north: float, east: float) -> float:
        """Of a GPS innovation, m, to its gate."""

    @abstractmethod
    def judge(self, *, believed: bool) -> None:
        """A solution was within its gate, or beyond it: what it thinks of the GPS."""

    @abstractmethod
    def watch_compass(self, belief: Belief, dt: float) -> None:
        """Follow the compass, or not."""

    def course_taken(self) -> None:
        """The heading was taken from the GPS's velocity."""

    def _follow_compass(self, belief: Belief, share: float) -> None:
        """Turn toward what the compass says."""
        turn, error = belief.compass_turn, belief.yaw_error
        error += math.remainder(turn - error, math.tau) * min(share, 1.0)
        if error != belief.yaw_error:
            belief.turn(0.0 if abs(error) < 1e-4 and turn == 0.0 else error)

    def _watch_course(self, belief: Belief, dt: float) -> None:
        """A wrong heading shows in the GPS's velocity as soon as the vehicle speeds up: it goes the wrong way."""
        sense, error = self._vehicle.sense, belief.yaw_error
        astray = GRAVITY * math.hypot(sense.roll, sense.pitch) * abs(2.0 * math.sin(error / 2.0))
        if self.aiding and belief.has_fix:
            wanted = self.USUAL["velocity"] + 0.35 * astray
            self.ratios["velocity"] += (wanted - self.ratios["velocity"]) * min(dt, 1.0)
        if self._vehicle.armed and abs(error) > TURNED_ENOUGH:
            self._shown += astray * dt
            if self._shown >= SHOWN_MPS:
                self._by_course, self._shown = True, 0.0
                belief.turn(0.0, reset=True)
                self.course_taken()

    def _watch_height(self, belief: Belief) -> None:
        """Without a barometer the GPS and the accelerometers hold it."""
        if belief.baro_lost:
            return
        now, ratio = self._vehicle.now, abs(belief.innovation[2]) / (GATE * math.sqrt(self.HEIGHT_VARIANCE))
        self.ratios["height"] = max(ratio, self.USUAL["height"])
        if ratio < 1.0:
            self._height_passed = now
            belief.follow_height()
        elif now - self._height_passed > self.HEIGHT_RETRY_S:
            belief.reset_height()
            self._height_passed = now
