"""Multirotors of one airframe: physics, estimate and controllers stepped together, and a row of plain numbers for
each autopilot.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from zmav.sim.air import density
from zmav.sim.arrays import Array, any_of, dot
from zmav.sim.control.cascade import Cascade
from zmav.sim.control.gains import arducopter_gains, px4_gains
from zmav.sim.control.px4 import Px4Cascade
from zmav.sim.control.setpoints import FLY, SetpointHandle, Setpoints
from zmav.sim.dynamics.airframe import Airframe
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.environment import Vector
from zmav.sim.fleets.base import AIR_EVERY, Fleet, Surroundings, Wanted

OUTER_EVERY = 2  # ticks


class CopterFleet(Fleet):
    """N copters of one airframe. ``start`` (3, N) metres NED of the world, ``yaw`` (N,) radians. ``px4``: their loops
    are PX4's, else ArduCopter's.
    """

    THINKS_EVERY: ClassVar[int] = 2  # just before the outer loops, which are what it steers

    dynamics: CopterDynamics

    def __init__(
        self,
        airframe: Airframe,
        start: Array,
        yaw: Array,
        dt: float,
        around: Surroundings,
        *,
        px4: bool = False,
    ) -> None:
        # What controllers and autopilots take it for; the physics has the bench's figures.
        self.airframe = airframe.at(float(density(np.array(around.place.alt_amsl_m))))
        super().__init__(CopterDynamics(airframe, start, yaw, dt), around, airframe.pack)
        n = start.shape[1]
        self.setpoints = Setpoints(n, px4_gains(n) if px4 else arducopter_gains(n))
        loops = Px4Cascade if px4 else Cascade
        self.cascade = loops(self.airframe, self.setpoints, start, yaw)
        self.sensors.throttle = self._table[26]
        self.estimate.jumped, self.estimate.turned = self._jumped, self._turned

    def handle(self, index: int) -> SetpointHandle:
        return self.setpoints.handle(index)

    def advance(self, steps: int) -> None:
        super().advance(steps)
        self.dynamics.supply = self.battery.volts / self.airframe.battery_v

    def control_tick(self, number: int, tick_s: float) -> None:
        """Every other tick the outer loops."""
        if number % (AIR_EVERY * self.pace) == 0:
            self.dynamics.density = self.thickness()
        outer_every = OUTER_EVERY * self.pace
        if number % outer_every == 0:
            self.cascade.outer(self.estimate, outer_every * tick_s)
        if any_of(self.setpoints.spool == FLY):
            self.cascade.level(self.estimate)

    def stands(self) -> bool:
        # Not by what its controllers had before: they look on, at an estimate that may wander.
        return self.dynamics.still and not any(self.setpoints.spool.tolist())

    def control_step(self) -> None:
        self.dynamics.throttle = self.cascade.inner(self.estimate, self.dynamics.dt)

    def _jumped(self, index: int, by: Vector) -> None:
        """A filter has set the position again: what is held and flown to moves along, so that nobody darts off."""
        shift = np.array(by)
        self.cascade.reference.pos[:, index] += shift
        self.setpoints.pos[:, index] += shift

    def _turned(self, index: int, by: float) -> None:
        """A filter has set the heading again."""
        self.cascade.yaw[index] += by
        self.setpoints.yaw[index] += by

    def outputs(self, index: int) -> list[float]:
        throttles: list[float] = self.dynamics.throttle[:, index].tolist()
        return throttles

    def rotor_speeds(self, index: int) -> list[float]:
        speeds: list[float] = self.dynamics.rotor[:, index].tolist()
        return speeds

    def wanted(self, index: int) -> Wanted:
        loops = self.cascade
        vel, acc, rate = (rows[:, index].tolist() for rows in (loops.want_vel, loops.want_acc, loops.want_rate))
        full = self.airframe.thrust_max_n * len(self.airframe.rotors)
        return Wanted(tuple(vel), tuple(acc), tuple(rate), float(loops.thrust[index]) / full)

    def sense_more(self, table: Array) -> None:
        dyn, cascade = self.dynamics, self.cascade
        table[19:21] = cascade.reference.vel[:2]
        table[21:25] = cascade.attitude
        table[25] = cascade.yaw
        table[26] = np.add.reduce(dyn.throttle) * (1.0 / len(dyn.throttle))
        air = dyn.vel - dyn.wind
        table[30] = np.sqrt(dot(air, air))
