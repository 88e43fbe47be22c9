"""The estimate that controllers and telemetry see: the truth, plus the error that a navigation filter makes of the
sensors' errors.

A filter that follows its GPS has the receiver's wandering error, smoothed; one without it slides away; one that
takes a shifted solution for true jumps to it. *When* it does so is up to the autopilot's own filter, which steers one
vehicle's column by a :class:`Belief`. Where nothing is wrong the estimate is the truth itself and costs nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from zmav.sim.arrays import (
    Array,
    Flags,
    euler_from_matrix,
    quat_from_euler,
    quat_multiply,
    rotation_matrix,
)
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.dynamics.body import Body
from zmav.sim.environment import Vector
from zmav.sim.sensors.noise import NoiseRows, Wander
from zmav.sim.sensors.suite import SLOW_PERIOD_S, SensorSuite

SMOOTHING_S = 1.0
BELIEVED_SPEED_S, BELIEVED_TURN_S = 2.0, 30.0  # correlation times of the filter's own errors
_WEIGHT = np.array([[0.0], [0.0], [GRAVITY]])


class Estimator:
    """``pos``, ``vel`` (3, N) NED metres; ``q`` (4, N); ``rate`` (3, N) rad/s; ``euler`` and ``force`` as they were at
    the last :meth:`observe`.

    ``jumped(index, (north, east, down))`` and ``turned(index, angle)`` are told when a filter sets one vehicle's
    position or heading again, so that its controllers can move with it.
    """

    def __init__(self, dynamics: Body, sensors: SensorSuite, seed: tuple[int, ...] = (0,)) -> None:
        self._dyn = dynamics
        self._sensors = sensors
        n, noise = dynamics.n, sensors.noise
        self.jumped: Callable[[int, Vector], None] = lambda index, by: None
        self.turned: Callable[[int, float], None] = lambda index, by: None
        self.slip: Array = np.zeros((3, n))  # of the velocity, m/s
        self.yaw_error: Array = np.zeros(n)
        self.taken: Array = np.zeros((3, n))  # how much of the solution's shift the filter has taken for true
        self.following: Flags = np.ones(n, dtype=bool)  # the GPS
        self._believes = max(noise.believed_speed_mps, noise.believed_tilt, noise.believed_yaw) > 0.0
        self._belief = Wander(
            NoiseRows(seed, "belief", n, 6),
            np.array([noise.believed_speed_mps] * 3 + [noise.believed_tilt] * 2 + [noise.believed_yaw]),
            np.array([BELIEVED_SPEED_S] * 3 + [BELIEVED_TURN_S] * 3),
            SLOW_PERIOD_S,
        )
        self._baro_height = noise.baro_drift_m > 0.0
        self.offset: Array = self.target()  # of the position, m
        self.led: set[int] = set()  # vehicles whose filter has a say
        self._twist: Array | None = None
        self._twisted = False  # the Euler angles are of an attitude that was
        self._vel_error: Array | None = None
        self._observed: tuple[Array, Array] | None = None
        self.settle()
        self.refresh()
        self.observe(0.0)

    @property
    def exact(self) -> bool:
        """The truth itself: nothing wanders."""
        return not self._astray and self._vel_error is None and self._twist is None

    def belief(self, index: int) -> Belief:
        """What one vehicle's filter steers."""
        return Belief(self, self._sensors, index)

    def refresh(self) -> None:
        """Take over the state after a step of the physics."""
        dyn = self._dyn
        self.pos: Array = dyn.pos + self.offset if self._astray else dyn.pos
        self.vel: Array = dyn.vel if self._vel_error is None else dyn.vel + self._vel_error
        self.q: Array = dyn.q if self._twist is None else quat_multiply(self._twist, dyn.q)
        self.rate: Array = dyn.rate

    def observe(self, dt: float, *, moved: bool = True) -> None:
        """Once a tick: errors; Euler angles and accelerometers are read anew. ``moved``: the bodies may have, since the
        last.
        """
        if not moved:
            self.refresh()
        if self._sensors.tick(dt) and self._believes:
            self._belief.step()
            self.settle()
        if self._astray:
            self._wander(dt)
        twisted, self._twisted = self._twisted, self._twist is not None
        if moved or twisted or self._twisted:
            self._observed = None

    @property
    def euler(self) -> Array:
        """Roll, pitch, yaw (3, N), rad."""
        return self._observe()[0]

    @property
    def force(self) -> Array:
        """Accelerometer reading (3, N), m/s^2 body."""
        return self._observe()[1]

    def _observe(self) -> tuple[Array, Array]:
        """Worked out when the first asks: not every autopilot looks at every tick."""
        if self._observed is None:
            body = rotation_matrix(self._dyn.q)
            euler = euler_from_matrix(body if self._twist is None else rotation_matrix(self.q))
            felt = self._dyn.accel - _WEIGHT
            self._observed = euler, np.add.reduce(body * felt[:, None])  # the latter from the world to the body
        return self._observed

    def target(self) -> Array:
        """(3, N) m NED: the error of a filter that follows its sensors."""
        error: Array = self._sensors.gps_error + self.taken
        if self._baro_height:
            error[2] = self.taken[2] - self._sensors.baro_drift
        return error

    def _wander(self, dt: float) -> None:
        share = min(dt / SMOOTHING_S, 1.0)
        if not self.led:
            self.offset += (self.target() - self.offset) * share
            return
        drawn = (self.target() - self.offset) * share
        drawn[:2] *= self.following
        self.offset += drawn + self.slip * dt

    def lead(self, index: int, *, led: bool) -> None:
        """A vehicle's filter has a say from now on, or none any more."""
        if led:
            self.led.add(index)
        else:
            self.led.discard(index)
        self.settle()

    def settle(self) -> None:
        """See what differs from the truth, after a change."""
        self._astray = bool(self.led) or self._sensors.wanders or self._baro_height
        self._vel_error = self._belief.value[:3] + self.slip if self._believes or self.slip.any() else None
        turned = self._believes or self.yaw_error.any()
        belief = self._belief.value
        self._twist = quat_from_euler(belief[3], belief[4], belief[5] + self.yaw_error) if turned else None


class Belief:
    """One vehicle's share of the estimate, for the filter of its autopilot."""

    def __init__(self, estimate: Estimator, sensors: SensorSuite, index: int) -> None:
        self._estimate = estimate
        self._sensors = sensors
        self._index = index

    @property
    def troubled(self) -> bool:
        """Something is wrong with a sensor."""
        return self._sensors.troubles.any[self._index]

    @property
    def has_fix(self) -> bool:
        return self._sensors.has_fix(self._index)

    @property
    def innovation(self) -> Vector:
        """Where the estimate is about what GPS (and, down, the barometer) say, m NED."""
        est, i, troubles = self._estimate, self._index, self._sensors.troubles
        off = est.offset[:, i] - est.target()[:, i] + est.taken[:, i]
        shift = troubles.gps_shift[:, i]
        north, east, down = off.tolist()
        return north - float(shift[0]), east - float(shift[1]), down + float(troubles.baro_shift[i])

    @property
    def level_field(self) -> float:
        """Of the Earth's magnetic field, what lies level, gauss."""
        return math.hypot(*self._sensors.field[:2])

    @property
    def field_difference_mg(self) -> float:
        """Between the field that the compass shows, by the estimate's attitude, and the one there should be: the larger
        of its parts to the north and the east, milligauss.
        """
        angle = self.yaw_error - self.compass_turn
        north, east, _ = self._sensors.field
        c, s = math.cos(angle), math.sin(angle)
        return 1000.0 * max(abs(north * c - east * s - north), abs(north * s + east * c - east))

    @property
    def compass_turn(self) -> float:
        return float(self._sensors.troubles.compass_turn[self._index])

    @property
    def compass_lost(self) -> bool:
        return bool(self._sensors.troubles.compass_lost[self._index])

    @property
    def baro_lost(self) -> bool:
        return bool(self._sensors.troubles.baro_lost[self._index])

    @property
    def yaw_error(self) -> float:
        return float(self._estimate.yaw_error[self._index])

    @property
    def led(self) -> bool:
        """The filter has a say in the estimate now."""
        return self._index in self._estimate.led

    def lead(self, led: bool) -> None:
        """Have a say from now on, or leave the estimate to itself."""
        self._estimate.lead(self._index, led=led)

    def forget(self) -> None:
        """Start again: at what the sensors say now."""
        self.reset_position()
        self.reset_height()
        self.turn(0.0)
        self.lead(False)

    def follow(self, gps: bool) -> None:
        """Follow the GPS's horizontal position, with whatever it is off by, or do not."""
        self._estimate.following[self._index] = gps
        if gps:
            self._estimate.taken[:2, self._index] = self._sensors.troubles.gps_shift[:2, self._index]

    def follow_height(self) -> None:
        """Follow the barometer, with whatever it is off by."""
        self._estimate.taken[2, self._index] = -self._sensors.troubles.baro_shift[self._index]

    def slide(self, north: float, east: float) -> None:
        """The velocity is off by that, m/s; without a GPS to follow the position goes with it."""
        self._estimate.slip[:2, self._index] = north, east
        self._estimate.settle()

    def reset_position(self) -> None:
        """Take the GPS's solution for true at once; velocity as well."""
        est, i = self._estimate, self._index
        before = est.offset[:2, i].copy()
        self.follow(True)
        self.slide(0.0, 0.0)
        est.offset[:2, i] = est.target()[:2, i]
        north, east = (est.offset[:2, i] - before).tolist()
        est.refresh()  # so that controllers see no error between the old place and the new target
        est.jumped(i, (north, east, 0.0))

    def reset_height(self) -> None:
        """Take the barometer's height for true at once."""
        est, i = self._estimate, self._index
        before = float(est.offset[2, i])
        self.follow_height()
        est.offset[2, i] = est.target()[2, i]
        est.refresh()
        est.jumped(i, (0.0, 0.0, float(est.offset[2, i]) - before))

    def turn(self, error: float, *, reset: bool = False) -> None:
        """The heading is off by ``error`` rad from now on; ``reset``: the controllers turn with it."""
        est, i = self._estimate, self._index
        by = error - float(est.yaw_error[i])
        est.yaw_error[i] = error
        est.settle()
        est.refresh()
        if reset and by:
            est.turned(i, by)
