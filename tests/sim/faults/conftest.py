"""A copter in the air, for faults to come upon."""

from __future__ import annotations

import pytest

from tests.sim.conftest import Gcs, MakeGcs

HEIGHT, CLIMB = 10.0, 2.0  # m: where it hovers, and how much of that it has climbed


@pytest.fixture
def aloft(make_gcs: MakeGcs) -> Gcs:
    """It hovers 10 m up in GUIDED. Most of the way it is lifted, and its controllers with it."""
    gcs = make_gcs()
    gcs.take_off(CLIMB)
    seat = gcs.vehicle.node.seat
    dynamics, estimate = seat.fleet.dynamics, seat.fleet.estimate
    dynamics.pos[2, seat.index] -= HEIGHT - CLIMB
    estimate.refresh()
    estimate.jumped(seat.index, (0.0, 0.0, CLIMB - HEIGHT))
    gcs.until(lambda: gcs.near(0.0, 0.0, -HEIGHT, within=0.05))
    gcs.clear()
    return gcs
