"""The plant: one vehicle's body, air and sensors on a clock of their own, driven by actuator values."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zmav import rotation
from zmav.hil.craft import Craft, drive, settle
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.fleets.base import Fleet, Sense, Surroundings
from zmav.sim.geo import from_ned

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

AIR_EVERY_S = 0.01  # gusts and the battery go at the pace of the world's ticks, however short a step is


class Truth:
    """A body's state as plain numbers, and what follows from it: world NED, body forward-right-down, SI units."""

    __slots__ = ("accel", "contact", "pos", "q", "rate", "vel", "wind")

    def __init__(self, fleet: Fleet) -> None:
        body = fleet.dynamics
        self.pos: list[float] = body.pos[:, 0].tolist()
        self.vel: list[float] = body.vel[:, 0].tolist()
        self.accel: list[float] = body.accel[:, 0].tolist()
        self.q: list[float] = body.q[:, 0].tolist()
        self.rate: list[float] = body.rate[:, 0].tolist()
        self.wind: list[float] = body.wind[:, 0].tolist()
        self.contact = bool(body.contact[0])

    def to_body(self, x: float, y: float, z: float) -> Vector:
        """A world vector in body axes."""
        return rotation.to_body(self.q, (x, y, z))

    @property
    def specific_force(self) -> Vector:
        """What an ideal accelerometer reads, m/s^2 body: (0, 0, -9.81) at rest."""
        x, y, z = self.accel
        return self.to_body(x, y, z - GRAVITY)

    @property
    def air_velocity(self) -> Vector:
        """Through the air, m/s body."""
        return self.to_body(*(v - w for v, w in zip(self.vel, self.wind, strict=True)))

    @property
    def euler(self) -> Vector:
        """Roll, pitch, yaw, rad."""
        return rotation.euler(self.q)


class Plant(Fleet):
    """A fleet of one, without controllers: :meth:`drive` sets its actuators, :meth:`run` moves its time on.

    ``start``: m NED of the world; ``yaw``: rad. ``time_s``: its own seconds since the start, or since :meth:`reset`.
    """

    def __init__(self, craft: Craft, start: Vector, yaw: float, dt: float, around: Surroundings) -> None:
        self.craft = craft
        self.place = from_ned(*start, around.place)
        """Where it starts: its home."""
        self.start = start
        self._yaw = yaw
        self._stand(dt, around)

    def _stand(self, dt: float, around: Surroundings) -> None:
        """Put it at the start, at rest, with sensors just switched on."""
        start = np.array([self.start], dtype=float).T
        body, pack = self.craft.make(start, np.array([self._yaw]), dt)
        super().__init__(body, around, pack)
        self.time_s = 0.0
        self.values: list[float] = [0.0] * len(self.craft.channels)
        self._since_air = 0.0

    def reset(self) -> None:
        """Back to the start at time 0: its flight stack has started again. What has failed stays so, and the battery is
        as empty as it was.
        """
        battery, troubles, efficiency = self.battery, self.sensors.troubles, self.efficiency
        self._stand(self.dynamics.dt, self.around)
        self.battery = battery
        troubles.hand_on(self.sensors.troubles)
        self.efficiency[:] = efficiency

    def drive(self, values: Sequence[float]) -> None:
        """Set the actuators: rotors and throttles 0 to 1, surfaces and steering -1 to 1, in the craft's order."""
        self.values = list(values)
        drive(self.dynamics, values)

    def run(self, seconds: float) -> None:
        """One step of the physics, this long."""
        body = self.dynamics
        if body.dt != seconds:
            body.dt = seconds
        body.step()
        self.time_s += seconds
        self._since_air += seconds
        if self._since_air >= AIR_EVERY_S - 1e-9:
            self._since_air -= AIR_EVERY_S
            self.blow(AIR_EVERY_S)
            self.battery.step(body.current(), AIR_EVERY_S)
            settle(self)

    def truth(self) -> Truth:
        return Truth(self)

    # ---- as any fleet

    def advance(self, steps: int) -> None:
        """``steps`` of the body's own step."""
        for _ in range(steps):
            self.run(self.dynamics.dt)

    def outputs(self, index: int) -> list[float]:
        return list(self.values)

    def senses(self) -> list[Sense]:
        """The truth: what its flight stack makes of the sensors is not known here."""
        now, battery = self.truth(), self.battery
        u, v, w = now.air_velocity
        throttle = sum(self.values) / len(self.values)
        impact = float(self.dynamics.impact[0])
        self.dynamics.impact[:] = 0.0
        state = (*now.pos, *now.vel, *now.euler, *now.rate, *now.specific_force, *now.q)
        wanted = (0.0, 0.0, *now.q, now.euler[2], throttle)  # nothing but what there is
        felt = (float(battery.current[0]), float(now.contact), impact, math.sqrt(u * u + v * v + w * w))
        return [Sense._make((*state, *wanted, *felt, float(battery.volts[0]), *now.pos))]
