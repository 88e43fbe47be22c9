"""What every simulated autopilot has: where it believes to be, its battery, its clock, and whom it tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from zmav.sim.autopilots.navigation import NavigationFilter
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.battery import BatteryHandle
from zmav.sim.fleets.base import Seat, Sense
from zmav.sim.geo import Position, from_ned
from zmav.sim.protocol.params import ParamStore

A = TypeVar("A")
H = TypeVar("H")


@dataclass(frozen=True)
class Installation(Generic[A, H]):
    """What an autopilot is built into: its airframe and the handle of its controllers, its parameters, what it senses
    first, the origin of the world's NED, and how many seconds it takes to boot.
    """

    airframe: A
    setpoint: H
    params: ParamStore
    sense: Sense
    world: Position
    ready_s: float


class Autopilot:
    """``sense``: what it senses now; ``world``: the origin of the world's NED; ``origin_world``: of the EKF, there.

    ``say(severity, text)``, ``beat()`` (a heartbeat now) and ``announce()`` (home and origin) are the protocol's.
    """

    filter: NavigationFilter[Any]

    def __init__(self, into: Installation[Any, Any]) -> None:
        sense = into.sense
        self.params, self.sense, self.world = into.params, sense, into.world
        self.origin_world: Vector = (sense.true_north, sense.true_east, sense.true_down)
        self.home_world: Vector = self.origin_world
        self.now = self.booted_at = 0.0
        self.armed = False
        self.power = BatteryHandle.bench()
        self._consumed_before = 0.0
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.beat: Callable[[], None] = lambda: None
        self.announce: Callable[[], None] = lambda: None

    def plug(self, power: BatteryHandle) -> None:
        """Take the battery of the body that it sits in."""
        self.power = power

    def sit(self, seat: Seat) -> None:
        """Take the sensors of the body that it sits in."""
        self.filter.belief = seat.belief()

    @property
    def uptime(self) -> float:
        """Seconds since its own boot."""
        return self.now - self.booted_at

    @property
    def consumed_mah(self) -> float:
        """Since its own boot."""
        return self.power.consumed_mah - self._consumed_before

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
