"""Rovers of one frame: physics, estimate and controllers stepped together, and a row of plain numbers for each
autopilot.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from zmav.sim.arrays import Array, dot
from zmav.sim.control.rover import RoverControl
from zmav.sim.control.roversetpoints import RoverHandle, RoverSetpoints
from zmav.sim.dynamics.rover import RoverDynamics
from zmav.sim.dynamics.roverframe import RoverFrame
from zmav.sim.fleets.base import Fleet, Surroundings


class RoverFleet(Fleet):
    """N rovers of one frame. ``start`` (3, N) metres NED of the world, ``yaw`` (N,) radians; they stand on the ground,
    whatever their start's height.
    """

    ACTUATORS: ClassVar[tuple[str, ...]] = ("steering", "throttle")
    THINKS_EVERY: ClassVar[int] = 2  # ArduRover's loop runs at 50 Hz (SCHED_LOOP_RATE), its controllers with it

    dynamics: RoverDynamics

    def __init__(self, frame: RoverFrame, start: Array, yaw: Array, dt: float, around: Surroundings) -> None:
        self.airframe = frame
        super().__init__(RoverDynamics(frame, start, yaw, dt), around, frame.pack)
        n = start.shape[1]
        self.setpoints = RoverSetpoints(n)
        self.control = RoverControl(self.setpoints, start)

    def handle(self, index: int) -> RoverHandle:
        handle = self.setpoints.handle(index)
        handle.point = lambda: self.point(index)
        return handle

    def control_tick(self, number: int, tick_s: float) -> None:
        """The controllers' outputs to steering and motor."""
        every = self.THINKS_EVERY * self.pace
        if number % every:
            return
        tick_s *= every
        est, dyn, control, asked = self.estimate, self.dynamics, self.control, self.setpoints
        still = not any(dyn.speed.tolist())
        self._stands = still and self.unchanged((tick_s, asked.tuned), asked, control, *control.loops)
        if not self._stands:
            control.update(est, tick_s)
            dyn.steering, dyn.throttle = control.steering, control.throttle

    def outputs(self, index: int) -> list[float]:
        """Steering and throttle, -1 to 1."""
        return [float(row[index]) for row in (self.dynamics.steering, self.dynamics.throttle)]

    def point(self, index: int) -> tuple[float, float]:
        """The moving point that a rover on a path keeps to, m north and east of the world's origin."""
        north, east = self.control.point[:, index].tolist()
        return north, east

    def sense_more(self, table: Array) -> None:
        est, dyn, control = self.estimate, self.dynamics, self.control
        yaw = est.euler[2]
        table[19], table[20] = control.speed * np.cos(yaw), control.speed * np.sin(yaw)
        table[21:25] = est.q
        table[25] = yaw
        table[26] = dyn.throttle
        air = dyn.vel - dyn.wind
        table[30] = np.sqrt(dot(air, air))
