"""Fixed wings of one type: physics, estimate and controllers stepped together, and a row of plain numbers for each
autopilot.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from zmav.sim.air import SEA_LEVEL_DENSITY, density
from zmav.sim.arrays import Array, all_of, quat_from_euler
from zmav.sim.control.plane import PlaneControl
from zmav.sim.control.planetargets import PlaneHandle, PlaneTargets
from zmav.sim.dynamics.plane import PlaneDynamics
from zmav.sim.dynamics.wing import Wing
from zmav.sim.fleets.base import AIR_EVERY, Fleet, Surroundings

NAVIGATE_EVERY = 5  # ticks


class PlaneFleet(Fleet):
    """N planes of one type. ``start`` (3, N) metres NED of the world, ``yaw`` (N,) radians."""

    ACTUATORS: ClassVar[tuple[str, ...]] = ("surface", "throttle")
    dynamics: PlaneDynamics

    def __init__(self, wing: Wing, start: Array, yaw: Array, dt: float, around: Surroundings) -> None:
        self.airframe = wing
        dynamics = PlaneDynamics(wing, start, yaw, dt)
        super().__init__(dynamics, around, wing.pack)
        dynamics.density = self.thickness()
        # Airspeeds that controllers are told are equivalent ones; the ratio is that of the world's origin.
        eas2tas = math.sqrt(SEA_LEVEL_DENSITY / float(density(np.array(around.place.alt_amsl_m))))
        self.targets = PlaneTargets(start.shape[1])
        self.control = PlaneControl(self.targets, eas2tas)
        self.sensors.throttle = self._table[26]

    def handle(self, index: int) -> PlaneHandle:
        return PlaneHandle(self.targets, index, lambda: self.control.flown(index), self.control.eas2tas)

    def control_tick(self, number: int, tick_s: float) -> None:
        """Attitude and rates, every fifth time guidance and energy."""
        est, dyn, control = self.estimate, self.dynamics, self.control
        if number % (AIR_EVERY * self.pace) == 0:
            dyn.density = self.thickness()
        navigate_every = self._still.steps = NAVIGATE_EVERY * self.pace
        loops = self.targets, control, control.l1, control.tecs, control.rate_loops
        self._stands = all_of(dyn.resting) and self.unchanged((tick_s, self.targets.tuned), *loops)
        if self._stands:
            return
        control.level(est, est.euler, est.force, dyn.airspeed, tick_s)
        if number % navigate_every == 0:
            control.navigate(est, est.euler, dyn.airspeed, navigate_every * tick_s)
        dyn.surface, dyn.throttle = control.surface, control.throttle

    def launch(self, index: int, speed: float, pitch: float = 0.2) -> None:
        """Throw one standing plane by hand: m/s along its nose, radians of pitch."""
        self.dynamics.launch(index, speed, pitch)

    def outputs(self, index: int) -> list[float]:
        """Aileron, elevator, throttle, rudder: in the order of the servo outputs."""
        aileron, elevator, rudder = self.dynamics.surface[:, index].tolist()
        return [aileron, elevator, float(self.dynamics.throttle[index]), rudder]

    def rotor_speeds(self, index: int) -> list[float]:
        """Of the propeller: its thrust goes with the square."""
        return [math.sqrt(float(self.dynamics.throttle[index]))]

    def sense_more(self, table: Array) -> None:
        est, control = self.estimate, self.control
        table[19:21] = est.vel[:2]
        table[21:25] = quat_from_euler(control.roll, control.pitch, est.euler[2])
        table[25] = control.l1.bearing
        table[26] = self.dynamics.throttle
        table[30] = self.dynamics.airspeed
