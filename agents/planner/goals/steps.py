"""What a goal comes down to: steps that the agent takes one after another, and what it must know of the fleet for them.

Steps are in the solver's frame (ENU metres about the fleet's origin, seconds); what came from vehicles is NED, as on
the wire, and named so. Nothing here moves anything: the agent plans, verifies and executes each step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.planner.model.problem import Floats, Motion
from agents.planner.solve.loiter import LoiterCircle
from zmav import wire
from zmav.errors import BadInput, TimedOut
from zmav.wire.base import Vector


@dataclass(frozen=True)
class VehicleView:
    """One vehicle as the planner knows it now."""

    name: str
    kind: str
    """copter, rover, plane...: as :class:`zmav.wire.swarm.BodyReport` says it"""
    body: wire.swarm.Body
    pos_ned: Vector
    """m NED about the fleet's origin"""
    vel_ned: Vector = (0.0, 0.0, 0.0)
    airborne: bool = False
    """False for rovers and boats, which are where they go"""
    home_ned: Vector | None = None
    """where it took off; None: not known"""
    ground: float | None = None
    """m down, of the ground at its home, which it says all the time"""
    armed: bool = False
    room: float = 0.0
    """m, of the body's radius, that are there because it may be elsewhere than it says, across"""

    @property
    def flies(self) -> bool:
        return self.kind not in GROUND

    @property
    def floor(self) -> float:
        """m down, of the ground as far as it tells: at its home, else where it is."""
        if self.home_ned is not None:
            return self.home_ned[2]
        return self.pos_ned[2] if self.ground is None else self.ground

    @property
    def floor_known(self) -> bool:
        """False: :attr:`floor` is only the height at which it flies now."""
        return self.home_ned is not None or self.ground is not None or not self.airborne

    @property
    def hovers(self) -> bool:
        return self.kind not in WINGED

    @property
    def accel(self) -> float:
        """m/s² that motions and plans may use, and the verifier allows."""
        return HEADROOM * self.body.accel if self.hovers else self.body.accel


HEADROOM = 0.7
"""share of its acceleration that a plan uses: the rest is for stopping on the way, in a turn, too"""
GROUND = ("rover", "boat")
WINGED = ("plane", "vtol")


@dataclass(frozen=True)
class FleetView:
    """The vehicles that a goal may name."""

    vehicles: Mapping[str, VehicleView]

    def pick(self, names: Sequence[str]) -> list[VehicleView]:
        """Those, in that order. Raises :class:`BadInput` for none, for one twice, and for one that nobody heard of."""
        if not names:
            raise BadInput("the goal names no vehicle", field="vehicles", value=[], expected="one name or more")
        twice = sorted({name for name in names if list(names).count(name) > 1})
        if twice:
            text = f"the goal names {', '.join(twice)} more than once"
            raise BadInput(text, field="vehicles", value=twice, expected="each vehicle once")
        unknown = [name for name in names if name not in self.vehicles]
        if unknown:
            known = ", ".join(sorted(self.vehicles)) or "none"
            text = f"no vehicle {', '.join(unknown)} is known; known are: {known}"
            raise BadInput(text, field="vehicles", value=unknown, expected=known)
        return [self.vehicles[name] for name in names]


@dataclass(frozen=True)
class PlanTo:
    """To places by a plan of the solver's, from wherever the vehicles are then, all at rest at the end."""

    vehicles: tuple[str, ...]
    places: Floats
    """(N, 3) ENU"""
    labelled: bool = True
    """the first to the first; else each place to whichever vehicle the solver gives it"""
    text: str = ""
    """what is going on, in words; so in every step"""


@dataclass(frozen=True)
class Pictures:
    """What a vehicle's camera does over its lanes."""

    every: float
    """m from one picture to the next, by which the autopilot triggers it; 0: somebody else does"""
    heading: float
    """rad clockwise from north that the vehicle looks to: along its lanes, so that pictures lie across them"""


@dataclass(frozen=True)
class Fly:
    """Prepared motions, to be verified and executed as they are on one clock.

    All start at t = 0 at rest where the step before ended, and end at rest. Where the verifier objects, or an
    obstacle has come since, ``instead`` is done in their place, one after another.
    """

    motions: Mapping[str, Motion]
    """by vehicle: (T, 4) t, x, y, z ENU"""
    instead: tuple[PlanTo, ...] = ()
    text: str = ""
    figures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """by vehicle, for who has it previewed: numbers by their names"""
    pictures: Mapping[str, Pictures] = field(default_factory=dict)
    """by vehicle that takes some on the way"""

    @property
    def vehicles(self) -> tuple[str, ...]:
        return tuple(self.motions)


@dataclass(frozen=True)
class VehicleOrder:
    """One order to one vehicle: ``do/{verb}`` with these arguments (as on the wire: NED, degrees where so named)."""

    vehicle: str
    verb: str
    args: Mapping[str, Any] = field(default_factory=dict)
    after: tuple[int, ...] = ()
    """the places in :attr:`Orders.orders` of those that must be done before this one is sent"""


@dataclass(frozen=True)
class Orders:
    """Orders that the vehicles carry out by themselves (takeoff, landing); the step is done when all are."""

    orders: tuple[VehicleOrder, ...]
    text: str = ""

    @property
    def vehicles(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(order.vehicle for order in self.orders))

    @property
    def lands(self) -> bool:
        """All of it brings down: who is lost on the way keeps nobody else in the air."""
        return all(order.verb == "land" for order in self.orders)


@dataclass(frozen=True)
class Loiter:
    """Planes on their way to circles that they fly from then on: they never hover and need no time tags.

    Each first reaches the height of its circle where it is, and then flies there. The heights are such that no two
    meet, whenever each is where.
    """

    circles: tuple[LoiterCircle, ...]
    text: str = ""

    @property
    def vehicles(self) -> tuple[str, ...]:
        return tuple(circle.vehicle for circle in self.circles)


@dataclass(frozen=True)
class Track:
    """Stay beside something that moves, until the goal is cancelled: :mod:`agents.planner.goals.follow` says how."""

    goal: wire.swarm.Follow
    text: str = ""

    @property
    def vehicles(self) -> tuple[str, ...]:
        return tuple(self.goal.vehicles)


@dataclass(frozen=True)
class Stop:
    """Come to rest along the way that is being flown and stay there."""

    vehicles: tuple[str, ...]
    text: str = ""


Step = PlanTo | Fly | Orders | Loiter | Track | Stop


def without(step: PlanTo, gone: set[str]) -> PlanTo:
    """The step for those who are left; of places that are anybody's, the first."""
    keep = [i for i, name in enumerate(step.vehicles) if name not in gone]
    places = step.places[keep] if step.labelled else step.places[: len(keep)]
    return PlanTo(tuple(step.vehicles[i] for i in keep), np.ascontiguousarray(places), step.labelled, step.text)


def for_the_rest(step: Step, lost: set[str]) -> Step:
    """The step without those who are lost (of a landing, as it is); raises :class:`TimedOut` for one that is nothing
    without them.
    """
    if isinstance(step, PlanTo):
        return without(step, lost)
    if isinstance(step, Orders) and step.lands:
        return step
    if missing := sorted(lost & set(step.vehicles)):
        raise TimedOut(f"not heard any more: {', '.join(missing)}", vehicles=missing)
    return step
