"""Missions of an ArduPlane in AUTO."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tests.sim.plane.conftest import ARM, AUTO, LOITER, RTL
from tests.sim.plans import Fields, at, do, reached, upload

if TYPE_CHECKING:
    from tests.sim.plane.conftest import Field

TAKEOFF, WAYPOINT, FOREVER, TURNS, TIME, HOME, LAND, CHANGE_ALT, TO_ALT, LAND_START = (
    22,
    16,
    17,
    18,
    19,
    20,
    21,
    30,
    31,
    189,
)


def takeoff(up: float) -> Fields:
    return {"command": TAKEOFF, "frame": 6, "z": up, "param1": 15.0}


def start(field: Field, items: list[Fields]) -> None:
    """In the air, in AUTO with that mission."""
    assert upload(field.gcs, items) == 0
    field.gcs.clear()
    assert field.mode(AUTO) == 0


def test_a_mission_from_the_ground_and_back_to_it(field: Field) -> None:
    field.set("LAND_DISARMDELAY", 2)
    field.ready()
    items = [takeoff(30), at(WAYPOINT, 250, 0, 35), at(WAYPOINT, 250, -200, 35), at(LAND, -50, -200)]
    assert upload(field.gcs, items) == 0
    assert field.mode(AUTO) == 0
    assert field.gcs.command(ARM, 1) == 0
    assert field.gcs.last("MISSION_CURRENT")["mission_state"] == 3
    field.gcs.until(lambda: not field.plane.armed, 150.0)
    assert reached(field.gcs) == [1, 2, 3]
    assert field.away(-50.0, -200.0) < 60.0
    texts = field.gcs.texts()
    for text in (
        "Mission: 1 Takeoff",
        "Holding course",
        "Takeoff complete at 30",
        "Reached waypoint #2 dist",
        "Mission: 4 Land",
        "Landing approach start at ",
        "Flare ",
        "Auto disarmed",
    ):
        assert any(each.startswith(text) for each in texts), text
    assert field.plane.mode.number == AUTO
    # In AUTO disarming does not begin the mission again.
    field.wait(1.0)
    assert field.plane.mission.current == 4


def test_waypoints_are_turned_at_early_and_lines_are_kept(flying: Field) -> None:
    start(flying, [at(WAYPOINT, 150, 0, 60), at(WAYPOINT, 150, 350, 60), at(FOREVER, 150, 900, 60)])
    flying.gcs.until(lambda: reached(flying.gcs) == [1])
    assert 20.0 < flying.away(150.0, 0.0) < 60.0  # WP_RADIUS, or the turn's distance
    flying.wait(13.0)
    assert abs(flying.plane.sense.north - 150.0) < 6.0
    assert flying.plane.height == pytest.approx(60.0, abs=3.0)
    flying.gcs.until(lambda: reached(flying.gcs) == [1, 2])
    assert flying.away(150.0, 350.0) < 20.0  # straight on: no turn to begin early


def test_loiters_by_time_and_height(flying: Field) -> None:
    start(flying, [at(TIME, 100, 0, 60, 2, 0, -1), at(TO_ALT, 100, 0, 72, 0, 70), at(FOREVER, 100, 0, 72)])
    flying.gcs.until(lambda: flying.plane.way.turned > 0.5)
    s = flying.plane.sense
    assert (s.north - 100.0) * s.ve - s.east * s.vn < 0.0  # counter-clockwise
    flying.gcs.until(lambda: reached(flying.gcs) == [1, 2], 90.0)
    assert flying.plane.height == pytest.approx(72.0, abs=6.0)
    texts = flying.gcs.texts()
    assert [t for t in texts if t.startswith("Loiter")] == ["Loiter time complete", "Loiter to alt complete"]


def test_speeds_jumps_and_the_end_of_the_mission(flying: Field) -> None:
    start(
        flying, [do(178, 0, 26, 0), at(WAYPOINT, 150, 0, 60), do(177, 2, 1), do(178, 0, -2), at(WAYPOINT, 200, 0, 66)]
    )
    flying.gcs.until(lambda: flying.plane.mode.number == RTL, 60.0)
    texts = flying.gcs.texts()
    assert "Set airspeed 26 m/s" in texts
    assert texts.count("Mission: 2 WP") == 2
    assert "Mission: 3 Jump 1/1" in texts
    assert "Mission complete, changing mode to RTL" in texts
    assert flying.plane.airspeed_wanted == 22.0


def test_it_goes_on_where_it_was_left(flying: Field) -> None:
    start(flying, [at(WAYPOINT, 100, 0, 60), at(WAYPOINT, 600, 0, 60), at(FOREVER, 800, 0, 60)])
    flying.gcs.until(lambda: flying.plane.mission.current == 2)
    assert flying.mode(LOITER) == 0
    flying.wait(3.0)
    assert flying.mode(AUTO) == 0
    assert flying.plane.mission.current == 2
    assert flying.gcs.command(224, 3) == 0
    flying.wait(0.3)
    assert flying.plane.mission.current == 3


def test_a_return_in_the_mission(flying: Field) -> None:
    start(flying, [do(HOME)])
    flying.wait(0.3)
    assert flying.plane.mode.number == RTL


def test_a_landing_comes_down_its_slope(flying: Field) -> None:
    start(flying, [at(WAYPOINT, 100, 0, 45), at(LAND, 550, 0)])
    flying.gcs.until(lambda: int(flying.plane.landing.leg) >= 1)
    flying.wait(6.0)
    for _ in range(4):
        flying.wait(1.0)
        if flying.plane.landing.flaring:
            break
        wanted = flying.plane.sp.flown().height
        assert flying.plane.height == pytest.approx(wanted + flying.plane.home_world[2], abs=4.0)
    flying.gcs.until(lambda: flying.plane.landing.flaring)
    assert flying.plane.landing.height < 9.0
    assert 50.0 < flying.plane.way.distance < 130.0  # recorded: 90 m
    assert flying.plane.eas == pytest.approx(16.0, abs=1.5)


def test_heights_between_places_change_on_a_slope(flying: Field) -> None:
    start(flying, [at(WAYPOINT, 110, 0, 60), at(WAYPOINT, 560, 0, 90), at(FOREVER, 900, 0, 90)])
    flying.gcs.until(lambda: flying.plane.mission.current == 2)
    flying.gcs.until(lambda: flying.plane.way.share > 0.5)
    assert flying.plane.height == pytest.approx(75.0, abs=6.0)


def test_auto_without_a_mission_returns(flying: Field) -> None:
    assert flying.mode(AUTO) == 0
    assert flying.plane.mode.number == RTL


def test_a_nameless_place_is_here(flying: Field) -> None:
    start(flying, [{"command": FOREVER, "frame": 6, "x": 0, "y": 0, "z": 0.0}])
    here = flying.plane.here
    assert math.hypot(flying.plane.way.end[0] - here[0], flying.plane.way.end[1] - here[1]) < 3.0
    assert flying.plane.way.end[2] == pytest.approx(here[2], abs=1.0)
