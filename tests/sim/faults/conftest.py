"""A copter in the air, for faults to come upon."""

from __future__ import annotations

import pytest

from tests.sim.conftest import Desk, MakeDesk

HEIGHT, CLIMB = 10.0, 2.0  # m: where it hovers, and how much of that it has climbed


@pytest.fixture
def aloft(make_desk: MakeDesk) -> Desk:
    """It hovers 10 m up in GUIDED. Most of the way it is lifted, and its controllers with it."""
    desk = make_desk()
    desk.take_off(CLIMB)
    seat = desk.vehicle.node.seat
    dynamics, estimate = seat.fleet.dynamics, seat.fleet.estimate
    dynamics.pos[2, seat.index] -= HEIGHT - CLIMB
    estimate.refresh()
    estimate.jumped(seat.index, (0.0, 0.0, CLIMB - HEIGHT))
    desk.until(lambda: desk.near(0.0, 0.0, -HEIGHT, within=0.05))
    desk.clear()
    return desk
