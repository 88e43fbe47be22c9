"""ORBIT and DO_CHANGE_ALTITUDE of the simulated PX4."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.sim.sensors.troubles import FINE, Trouble

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion

NAN = math.nan


def ask(companion: Companion, radius: float, speed: float, behaviour: float, north: float, east: float) -> list[int]:
    place = companion.vehicle.px4.place((north, east, -5.0))
    return companion.command(34, radius, speed, behaviour, NAN, place.lat_deg, place.lon_deg, place.alt_amsl_m)


@pytest.mark.parametrize(("radius", "clockwise"), [(8.0, True), (-8.0, False)])
def test_it_flies_round_a_place_with_its_nose_to_it(companion: Companion, radius: float, clockwise: bool) -> None:
    companion.take_off()
    assert ask(companion, radius, 2.0, 0, 10.0, 0.0) == [0]
    companion.world.step(9.0)
    for _ in range(4):
        companion.world.step(1.5)
        sense = companion.vehicle.px4.sense
        north, east = sense.north - 10.0, sense.east
        # Its velocity loop lags behind a velocity that turns: wider and slower than asked, by what its drag makes.
        assert math.hypot(north, east) == pytest.approx(8.0, abs=1.2)
        assert math.hypot(sense.vn, sense.ve) == pytest.approx(1.7, abs=0.3)
        assert (north * sense.ve - east * sense.vn > 0) is clockwise
        to_centre = math.atan2(-east, -north)
        assert abs(math.remainder(sense.yaw - to_centre, math.tau)) < 0.35
    assert companion.flying == "ORBIT"
    assert companion.ned[2] == pytest.approx(-5.0, abs=0.3)
    status = companion.all("ORBIT_EXECUTION_STATUS")[-1]
    assert status["radius"] == radius and status["frame"] == 0
    beat = companion.all("HEARTBEAT")[-1]
    assert beat["custom_mode"] == 3 << 16 | 1 << 24


def test_what_is_too_fast_for_its_circle_is_slowed(companion: Companion) -> None:
    companion.take_off()
    assert ask(companion, 2.0, 9.0, 3, 0.0, 0.0) == [0]
    companion.world.step(8.0)
    sense = companion.vehicle.px4.sense
    assert companion.vehicle.px4.navigator.orbit.speed == pytest.approx(2.0)  # v^2 / r = 2 m/s^2
    assert 1.0 < math.hypot(sense.vn, sense.ve) < 2.0


def test_a_failsafe_ends_it_for_good(companion: Companion) -> None:
    companion.take_off()
    assert ask(companion, 5.0, 1.0, 0, 0.0, 0.0) == [0]
    companion.world.step(2.0)
    seat = companion.vehicle.node.seat
    seat.fleet.sensors.troubles.put(seat.index, "test", Trouble(gps_lost=True))
    companion.until(lambda: companion.flying == "DESCEND", 8.0)
    seat.fleet.sensors.troubles.put(seat.index, "test", FINE)
    companion.until(lambda: companion.flying != "DESCEND", 5.0)
    assert companion.flying == "HOLD"


def test_a_change_of_altitude_keeps_the_place(companion: Companion) -> None:
    companion.take_off()
    amsl = companion.vehicle.px4.place((0.0, 0.0, -9.0)).alt_amsl_m
    assert companion.command(186, amsl) == [0]
    companion.until(lambda: companion.near(0.0, 0.0, -9.0, 0.3))
    assert companion.command(186, NAN) == [2]


def test_modes_without_a_target_are_refused(companion: Companion) -> None:
    companion.take_off()
    assert companion.mode(4, 8) == [0, 1]  # FOLLOW
    assert companion.mode(4, 9) == [0, 1]  # PRECLAND
