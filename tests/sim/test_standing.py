"""Who stands still is not computed, which changes nothing: beside each fleet moves its twin, of which every step is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from zmav.sim.control.setpoints import Spool
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.dynamics.roverframe import CAR
from zmav.sim.dynamics.wing import TRAINER
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Fleet, Surroundings
from zmav.sim.fleets.copter import CopterFleet
from zmav.sim.fleets.plane import PlaneFleet
from zmav.sim.fleets.rover import RoverFleet

DT, STEPS = 1 / 200, 2
Order = Callable[[Any], object]
"""to a fleet; of its two vehicles it means the second"""


class RestlessCopters(CopterFleet):
    def stands(self) -> bool:
        return False


class RestlessRovers(RoverFleet):
    def unchanged(self, *known: object) -> bool:
        return False


class RestlessPlanes(PlaneFleet):
    def unchanged(self, *known: object) -> bool:
        return False


def together(fleets: Sequence[Fleet], orders: Sequence[tuple[Order, float]], steps: int = STEPS) -> float:
    """Give them the same orders, each followed by so many seconds; how long the first stood still, s."""
    stood = 0
    for number, (order, seconds) in enumerate(orders):
        for fleet in fleets:
            order(fleet)
        for tick in range(round(seconds / DT / steps)):
            for fleet in fleets:
                fleet.advance(steps)
            stood += fleets[0].stands()
            saved, full = (np.array([*fleet.senses()[1], *fleet.outputs(1)]) for fleet in fleets)
            # But for what a motor that has stopped still gave.
            assert np.allclose(saved, full, rtol=0.0, atol=1e-9), f"order {number}, tick {tick}"
    return stood * DT * steps


def around(noise: str = "none", north: float = 0.0) -> Surroundings:
    return Surroundings(environment=Environment(wind=(north, 0.0, 0.0)), noise=noise)


def ask(order: Callable[[Any], object]) -> Order:
    return lambda fleet: order(fleet.handle(1))


def frozen(yes: bool) -> Order:
    return lambda fleet: fleet.freeze(1, frozen=yes)


def turned(angle: float) -> Order:
    """The compass is off by so much."""
    return lambda fleet: fleet.estimate.belief(1).turn(angle)


@pytest.mark.parametrize(("noise", "px4"), [("none", False), ("typical", True)])
def test_copters(noise: str, px4: bool) -> None:
    kinds = CopterFleet, RestlessCopters
    fleets = [kind(airframe("quad"), np.zeros((3, 2)), np.ones(2), DT, around(noise), px4=px4) for kind in kinds]

    def turn(spool: Spool, height: float) -> Order:
        return ask(lambda copter: (copter.spool(spool), copter.move(pos=(1.0, 0.0, -height))))

    orders = [(turn(Spool.OFF, 0.0), 1.0), (turned(0.5), 0.1), (turned(0.0), 0.1)]
    orders += [(turn(Spool.IDLE, 0.0), 0.5), (turn(Spool.FLY, 0.5), 1.5), (turn(Spool.FLY, -1.0), 2.0)]
    orders += [(turn(Spool.OFF, 0.0), 3.0), (frozen(True), 0.2), (turn(Spool.FLY, 0.5), 0.2), (frozen(False), 1.0)]
    orders += [(lambda fleet: fleet.battery.drain(1, 0.0), 3.0), (turn(Spool.OFF, 0.0), 0.3)]
    assert together(fleets, orders) > 2.0


@pytest.mark.parametrize("pace", [1, 2])
def test_rovers(pace: int) -> None:
    starts = np.array([[0.0, 0.0], [0.0, 9.0], [0.0, 0.0]])
    fleets = [kind(CAR, starts, np.zeros(2), DT, around(north=-5.0)) for kind in (RoverFleet, RestlessRovers)]
    for fleet in fleets:
        fleet.pace = pace

    orders: list[tuple[Order, float]] = [
        (ask(lambda rover: rover.coast()), 1.0),
        (ask(lambda rover: (rover.power(True), rover.direct(0.5, 0.4))), 0.5),
        (ask(lambda rover: rover.direct(0.5, 0.0)), 4.0),
        (ask(lambda rover: rover.direct(-1.0, 0.0)), 1.0),
        (turned(0.4), 0.2),
        (turned(0.0), 0.2),
        (frozen(True), 0.2),
        (ask(lambda rover: rover.direct(0.0, 0.5)), 0.3),
        (frozen(False), 1.0),
        (ask(lambda rover: rover.go((2.0, 9.0))), 2.0),
        (ask(lambda rover: rover.stop()), 4.0),
        (ask(lambda rover: rover.tune("turn_p", 0.3)), 0.2),
        (ask(lambda rover: rover.power(False)), 1.0),
        (ask(lambda rover: (rover.power(True), rover.head(1.0, 1.0))), 1.0),
    ]
    assert together(fleets, orders, STEPS // pace) > 3.0


def test_planes() -> None:
    starts = np.array([[0.0, 0.0], [0.0, 30.0], [0.0, 0.0]])
    fleets = [kind(TRAINER, starts, np.zeros(2), DT, around()) for kind in (PlaneFleet, RestlessPlanes)]

    orders: list[tuple[Order, float]] = [
        (ask(lambda plane: plane.off()), 1.0),
        (turned(0.4), 0.2),
        (turned(0.0), 0.2),
        (ask(lambda plane: plane.surfaces(0.3, -0.2, 0.1)), 1.0),
        (frozen(True), 0.2),
        (ask(lambda plane: plane.power(1.0)), 0.3),
        (frozen(False), 1.5),
        (ask(lambda plane: (plane.roll(math.radians(10.0)), plane.pitch(0.1))), 1.0),
        (ask(lambda plane: plane.off()), 6.0),
    ]
    assert together(fleets, orders) > 1.0
