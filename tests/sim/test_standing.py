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
from zmav.sim.fleets.still import Standstill

DT, STEPS = 1 / 200, 2
Order = Callable[[Any], object]
"""to the second of a fleet's two vehicles"""


class RestlessCopters(CopterFleet):
    def stands(self) -> bool:
        return False


class RestlessRovers(RoverFleet):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._still = Standstill(1_000_000)


class RestlessPlanes(PlaneFleet):
    def stands(self) -> bool:
        return False

    def control_tick(self, number: int, tick_s: float) -> None:
        self._still = Standstill()  # has seen nothing
        super().control_tick(number, tick_s)


def together(fleets: Sequence[Fleet], orders: Sequence[tuple[Order, float]]) -> float:
    """Give them the same orders, each followed by so many seconds; how long the first stood still, s."""
    stood = 0
    for order, seconds in orders:
        for fleet in fleets:
            order(fleet.handle(1))  # type: ignore[attr-defined]
        for _ in range(round(seconds / DT / STEPS)):
            for fleet in fleets:
                fleet.advance(STEPS)
            stood += fleets[0].stands()
        saved, full = (np.array(fleet.senses()) for fleet in fleets)
        assert np.allclose(saved, full, rtol=0.0, atol=1e-9), "but for what a motor that has stopped still gave"
        assert [fleets[0].outputs(i) for i in (0, 1)] == [fleets[1].outputs(i) for i in (0, 1)]
    return stood * DT * STEPS


def around(noise: str = "none", wind: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Surroundings:
    return Surroundings(environment=Environment(wind=wind), noise=noise)


@pytest.mark.parametrize(("noise", "px4"), [("none", False), ("typical", True)])
def test_copters(noise: str, px4: bool) -> None:
    kinds = CopterFleet, RestlessCopters
    fleets = [kind(airframe("quad"), np.zeros((3, 2)), np.ones(2), DT, around(noise), px4=px4) for kind in kinds]

    def ask(spool: Spool, height: float) -> Order:
        return lambda handle: (handle.spool(spool), handle.move(pos=(1.0, 0.0, -height)))

    orders = [(ask(Spool.OFF, 0.0), 1.5), (ask(Spool.IDLE, 0.0), 0.5), (ask(Spool.FLY, 0.5), 1.5)]
    orders += [(ask(Spool.FLY, -1.0), 2.0), (ask(Spool.OFF, 0.0), 3.0), (ask(Spool.FLY, 0.5), 1.0)]
    assert together(fleets, orders) > 2.0


def test_rovers() -> None:
    fleets = [
        kind(CAR, np.array([[0.0, 0.0], [0.0, 9.0], [0.0, 0.0]]), np.zeros(2), DT, around(wind=(-5.0, 0.0, 0.0)))
        for kind in (RoverFleet, RestlessRovers)
    ]
    orders: list[tuple[Order, float]] = [
        (lambda handle: handle.coast(), 1.0),
        (lambda handle: (handle.power(True), handle.direct(0.5, 0.4)), 0.5),
        (lambda handle: handle.direct(0.5, 0.0), 4.0),
        (lambda handle: handle.direct(-1.0, 0.0), 1.0),
        (lambda handle: handle.go((2.0, 9.0)), 2.0),
        (lambda handle: handle.stop(), 4.0),
        (lambda handle: handle.power(False), 1.0),
        (lambda handle: (handle.power(True), handle.head(1.0, 1.0)), 1.0),
    ]
    assert together(fleets, orders) > 3.0


def test_planes() -> None:
    fleets = [
        kind(TRAINER, np.array([[0.0, 0.0], [0.0, 30.0], [0.0, 0.0]]), np.zeros(2), DT, around())
        for kind in (PlaneFleet, RestlessPlanes)
    ]
    orders: list[tuple[Order, float]] = [
        (lambda handle: handle.off(), 1.0),
        (lambda handle: handle.surfaces(0.3, -0.2, 0.1), 1.0),
        (lambda handle: handle.power(1.0), 2.0),
        (lambda handle: (handle.roll(math.radians(10.0)), handle.pitch(0.1)), 1.0),
    ]
    assert together(fleets, orders) > 1.0
