"""Missions on the simulated ArduRover: what it does and says, beside what the real one did with the same items."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tests.sim import plans
from tests.sim.plans import at, do

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

AUTO = 10
WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL, SPEED, JUMP = 16, 17, 19, 20, 178, 177
MISSION = [
    do(SPEED, 3),
    at(WAYPOINT, 15, 0),
    at(WAYPOINT, 15, 10, 0, 2),
    at(LOITER_TIME, 5, 10, 0, 3),
    at(WAYPOINT, 0, 10),
    do(JUMP, 5, 1),
    do(RTL),
]
# What the real one said of these, from DO_SET_MODE to the end.
SAID = [
    "Mission: 1 ChangeSpeed",
    "Mission: 2 WP",
    "Reached waypoint #2",
    "Mission: 3 WP",
    "Reached waypoint #3. Loiter for 2 seconds",
    "Mission: 4 LoitTime",
    "Reached waypoint #4. Loiter for 3 seconds",
    "Finished active loiter",
    "Mission: 5 WP",
    "Reached waypoint #5",
    "Mission: 6 Jump 1/1",
    "Mission: 5 WP",
    "Reached waypoint #5",
    "Mission: 7 RTL",
    "Mission Complete",
]

# Seconds that the real one took from one of these to another.
TOOK = {
    ("Mission: 3 WP", "Reached waypoint #3. Loiter for 2 seconds"): 6.6,
    ("Mission: 4 LoitTime", "Reached waypoint #4. Loiter for 3 seconds"): 11.1,
}


def begin(yard: Yard, items: list[plans.Fields], *, home: bool = True) -> None:
    """Upload, arm and start; items are placed about where the rover stands."""
    yard.gcs.until(lambda: yard.rover.position_ok)
    place = yard.rover.position
    moved = []
    for item in items:
        if "x" in item:
            x = item["x"] + round((place.lat_deg - plans.HOME_LAT) * 1e7)
            item = {**item, "x": x, "y": item["y"] + round((place.lon_deg - plans.HOME_LON) * 1e7)}
        moved.append(item)
    assert plans.upload(yard.gcs, moved, home=home) == 0
    yard.ready(15)
    assert yard.gcs.command(300) == 0


def test_the_whole_mission(yard: Yard) -> None:
    begin(yard, MISSION)
    assert yard.rover.mode.number == AUTO
    corner = math.inf
    start = yard.gcs.world.time_s
    said: dict[str, float] = {}
    while "Mission Complete" not in yard.gcs.texts():
        assert yard.gcs.world.time_s - start < 150.0, yard.gcs.texts()
        yard.gcs.world.step(0.2)
        for text in yard.gcs.texts()[len(said) :]:
            said.setdefault(text, yard.gcs.world.time_s)
        corner = min(corner, math.dist(yard.place, (15.0, 0.0)))
    assert yard.gcs.texts() == SAID
    took = {pair: said[pair[1]] - said[pair[0]] for pair in TOOK}
    assert took == pytest.approx(TOOK, abs=1.5)
    assert plans.reached(yard.gcs) == [1, 2, 3, 4, 5, 5, 7]
    assert corner < yard.rover.params["WP_RADIUS"]
    yard.gcs.until(yard.stands)
    assert yard.rover.from_home < yard.rover.params["WP_RADIUS"]
    current = yard.gcs.last("MISSION_CURRENT")
    assert (current["seq"], current["total"], current["mission_state"], current["mission_mode"]) == (7, 7, 5, 1)


def test_corners_are_cut_and_stops_are_not(yard: Yard) -> None:
    """A waypoint with another after it is passed; the last one is a stop."""
    begin(yard, [at(WAYPOINT, 20, 0), at(WAYPOINT, 40, 2)])
    slowest = math.inf
    while yard.place[0] < 28.0:
        yard.gcs.world.step(0.2)
        if yard.place[0] > 12.0:
            slowest = min(slowest, yard.speed)
    assert slowest > 2.0
    yard.gcs.until(lambda: "Mission Complete" in yard.gcs.texts() and yard.stands(), 40.0)
    assert math.dist(yard.place, (40.0, 2.0)) < 1.5


def test_speed_is_kept_to(yard: Yard) -> None:
    begin(yard, [do(SPEED, 1, 2.0), at(WAYPOINT, 25, 0)])
    yard.gcs.until(lambda: "speed: 2.0 m/s" in yard.gcs.texts(), 1.0)
    yard.gcs.until(lambda: yard.place[0] > 10.0, 40.0)
    assert yard.speed == pytest.approx(2.0, abs=0.25)


def test_stays_for_ever(yard: Yard) -> None:
    begin(yard, [at(LOITER_UNLIM, 6, 0), at(WAYPOINT, 30, 0)])
    yard.gcs.until(lambda: "Reached waypoint #1" in yard.gcs.texts(), 30.0)
    yard.gcs.world.step(4.0)
    assert abs(yard.speed) < 0.5
    assert yard.place[0] == pytest.approx(6.0, abs=1.5)


def test_a_command_it_does_not_know_is_passed(yard: Yard) -> None:
    """A takeoff is none of a rover's."""
    begin(yard, [plans.takeoff(10.0), at(WAYPOINT, 5, 0)])
    yard.gcs.until(lambda: "Mission Complete" in yard.gcs.texts(), 30.0)


@pytest.mark.parametrize(("behaviour", "mode"), [(0, "AUTO"), (1, "AUTO"), (3, "MANUAL")])
def test_after_the_mission(make_yard: MakeYard, behaviour: int, mode: str) -> None:
    """MIS_DONE_BEHAVE."""
    yard = make_yard(params={"MIS_DONE_BEHAVE": behaviour})
    begin(yard, [at(WAYPOINT, 3, 0)])
    yard.gcs.until(lambda: "Mission Complete" in yard.gcs.texts(), 30.0)
    yard.gcs.world.step(0.5)
    assert yard.rover.mode.name == mode


def test_disarmed_in_auto_it_keeps_its_place(yard: Yard) -> None:
    begin(yard, [at(WAYPOINT, 4, 0), at(WAYPOINT, 30, 0)])
    yard.gcs.until(lambda: yard.rover.mission.current == 2, 20.0)
    yard.gcs.command(400, 0)
    assert yard.rover.mission.current == 2
    yard.mode(4)
    yard.gcs.command(400, 1)
    yard.gcs.command(400, 0)
    assert yard.rover.mission.current == 0
