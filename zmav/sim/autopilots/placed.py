"""Where a vehicle believes to be, whatever autopilot believes it."""

from __future__ import annotations

from zmav.sim.control.setpoints import Vector
from zmav.sim.fleets.base import Sense
from zmav.sim.geo import Position, from_ned


class Placed:
    """``sense``: what it senses now; ``world``: the origin of the world's NED; ``origin_world``: of the EKF, there."""

    sense: Sense
    world: Position
    origin_world: Vector

    @property
    def local(self) -> Vector:
        """Position about the EKF origin, metres NED."""
        o, s = self.origin_world, self.sense
        return s.north - o[0], s.east - o[1], s.down - o[2]

    @property
    def position(self) -> Position:
        return self.place((self.sense.north, self.sense.east, self.sense.down))

    def place(self, world: Vector) -> Position:
        """A point of the world's NED, in degrees."""
        return from_ned(*world, self.world)
