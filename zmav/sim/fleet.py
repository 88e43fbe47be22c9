"""All vehicles of one airframe: physics, estimate and controllers stepped together, and a row of plain numbers for
each autopilot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zmav.sim.arrays import Array
from zmav.sim.control.cascade import Cascade
from zmav.sim.control.setpoints import SetpointHandle, Setpoints
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.sensors.estimate import Estimator

OUTER_EVERY = 2  # ticks


class Sense(NamedTuple):
    """What one autopilot knows at a tick: metres, m/s NED of the world; radians; m/s^2 body; fractions."""

    north: float
    east: float
    down: float
    vn: float
    ve: float
    vd: float
    roll: float
    pitch: float
    yaw: float
    p: float
    q: float
    r: float
    fx: float
    fy: float
    fz: float
    qw: float
    qx: float
    qy: float
    qz: float
    ref_vn: float  # velocity the reference asks for
    ref_ve: float
    want_qw: float  # attitude asked for
    want_qx: float
    want_qy: float
    want_qz: float
    want_yaw: float
    throttle: float  # mean of the rotors, 0..1
    current_a: float
    contact: float  # 1 on the ground
    impact: float  # down speed of a touch since the last tick, m/s
    true_north: float
    true_east: float
    true_down: float


class CopterFleet:
    """N copters of one airframe. ``start`` (3, N) metres NED of the world, ``yaw`` (N,) radians."""

    def __init__(
        self, airframe: Airframe, start: Array, yaw: Array, dt: float, rng: np.random.Generator, gps_noise_m: float
    ) -> None:
        self.airframe = airframe
        self.dynamics = CopterDynamics(airframe, start, yaw, dt)
        self.setpoints = Setpoints(start.shape[1])
        self.estimate = Estimator(self.dynamics, rng, gps_noise_m)
        self.cascade = Cascade(airframe, self.setpoints, start, yaw)
        self._dt = dt
        self._ticks = 0
        self._table: Array = np.zeros((len(Sense._fields), start.shape[1]))

    def handle(self, index: int) -> SetpointHandle:
        return self.setpoints.handle(index)

    def advance(self, steps: int) -> None:
        """One tick: ``steps`` steps of inner loops and physics, then the sensors; every other tick the outer loops
        first.
        """
        est, dyn = self.estimate, self.dynamics
        if self._ticks % OUTER_EVERY == 0:
            self.cascade.outer(est, OUTER_EVERY * steps * self._dt)
        self._ticks += 1
        self.cascade.level(est)
        for _ in range(steps):
            dyn.throttle = self.cascade.inner(est, self._dt)
            dyn.step()
            est.refresh()
        est.observe(steps * self._dt)

    def senses(self) -> list[Sense]:
        """One row of plain floats per vehicle; a touch of the ground is reported once."""
        est, dyn, cascade = self.estimate, self.dynamics, self.cascade
        table = self._table
        # In the order of Sense.
        table[0:3] = est.pos
        table[3:6] = est.vel
        table[6:9] = est.euler
        table[9:12] = est.rate
        table[12:15] = est.force
        table[15:19] = est.q
        table[19:21] = cascade.reference.vel[:2]
        table[21:25] = cascade.attitude
        table[25] = cascade.yaw
        table[26] = dyn.throttle.mean(0)
        table[27] = self._current()
        table[28] = dyn.contact
        table[29] = dyn.impact
        table[30:33] = dyn.pos
        dyn.impact[:] = 0.0
        return [Sense._make(row) for row in table.T.tolist()]

    def _current(self) -> Array:
        """Battery current, A: the induced power of each rotor goes with its thrust to the 3/2 (momentum theory)."""
        frame = self.airframe
        share = self.dynamics.thrust / frame.hover_thrust_n
        result: Array = (share * np.sqrt(share)).mean(0) * frame.hover_current_a
        return result
