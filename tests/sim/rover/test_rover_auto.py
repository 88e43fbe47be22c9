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
WAYPOINT, LOITER_UNLIM, LOITER_TURNS, LOITER_TIME, RTL, DELAY, YAW_SPEED = 16, 17, 18, 19, 20, 93, 213
GUIDED_ENABLE, SPEED, REVERSE, JUMP, CONDITION_DISTANCE, LIMITS = 92, 178, 194, 177, 114, 222
MISSION = [
    do(SPEED, 3), at(WAYPOINT, 15, 0), at(WAYPOINT, 15, 10, 0, 2), at(LOITER_TIME, 5, 10, 0, 3),
    do(YAW_SPEED, 90, 1), do(DELAY, 2), at(LOITER_TURNS, 5, 20, 0, 1, 0, 5), do(REVERSE, 1), at(WAYPOINT, 0, 10),
    do(REVERSE, 0), do(JUMP, 9, 1), do(RTL),
]  # fmt: skip
# What the real one said of these, from DO_SET_MODE to the end.
SAID = [
    "Mission: 1 ChangeSpeed", "Mission: 2 WP", "Reached waypoint #2", "Mission: 3 WP",
    "Reached waypoint #3. Loiter for 2 seconds", "Mission: 4 LoitTime", "Reached waypoint #4. Loiter for 3 seconds",
    "Finished active loiter", "Mission: 5 SetYawSpd", "Mission: 6 Delay", "Delaying 2 sec", "Mission: 7 LoitTurns",
    "Mission: 8 SetReverse", "Mission: 9 WP", "Reached waypoint #9", "Mission: 10 SetReverse", "Mission: 11 Jump 1/1",
    "Mission: 9 WP", "Reached waypoint #9", "Mission: 10 SetReverse", "Mission: 12 RTL", "Mission Complete",
]  # fmt: skip

# Seconds that the real one took from one of these to another.
TOOK = {
    ("Mission: 3 WP", "Reached waypoint #3. Loiter for 2 seconds"): 6.6,
    ("Mission: 4 LoitTime", "Reached waypoint #4. Loiter for 3 seconds"): 11.1,
    ("Mission: 5 SetYawSpd", "Mission: 6 Delay"): 3.0,
    ("Mission: 7 LoitTurns", "Mission: 8 SetReverse"): 14.1,
}


def begin(yard: Yard, items: list[plans.Fields], *, home: bool = True) -> None:
    """Upload, arm and start; items are placed about where the rover stands."""
    yard.desk.until(lambda: yard.rover.position_ok)
    place = yard.rover.position
    moved = []
    for item in items:
        if "x" in item:
            x = item["x"] + round((place.lat_deg - plans.HOME_LAT) * 1e7)
            item = {**item, "x": x, "y": item["y"] + round((place.lon_deg - plans.HOME_LON) * 1e7)}
        moved.append(item)
    assert plans.upload(yard.desk, moved, home=home) == 0
    yard.ready(15)
    assert yard.desk.command(300) == 0


def test_the_whole_mission(yard: Yard) -> None:
    begin(yard, MISSION)
    assert yard.rover.mode.number == AUTO
    corner, backwards = math.inf, False
    start = yard.desk.world.time_s
    said: dict[str, float] = {}
    while "Mission Complete" not in yard.desk.texts():
        assert yard.desk.world.time_s - start < 150.0, yard.desk.texts()
        yard.desk.world.step(0.2)
        for text in yard.desk.texts()[len(said) :]:
            said.setdefault(text, yard.desk.world.time_s)
        corner = min(corner, math.dist(yard.place, (15.0, 0.0)))
        backwards |= yard.speed < -1.0
    assert yard.desk.texts() == SAID
    took = {pair: said[pair[1]] - said[pair[0]] for pair in TOOK}
    assert took == pytest.approx(TOOK, abs=1.5)
    assert plans.reached(yard.desk) == [1, 2, 3, 4, 5, 6, 8, 10, 10, 12]
    assert corner < yard.rover.params["WP_RADIUS"]
    assert backwards
    yard.desk.until(yard.stands)
    assert yard.rover.from_home < yard.rover.params["WP_RADIUS"]
    current = yard.desk.last("MISSION_CURRENT")
    assert (current["seq"], current["total"], current["mission_state"], current["mission_mode"]) == (12, 12, 5, 1)


def test_what_is_kept_of_a_mission(yard: Yard) -> None:
    """As the real one gives it back."""
    yard.desk.until(lambda: yard.rover.position_ok)
    assert plans.upload(yard.desk, MISSION) == 0
    kept = plans.download(yard.desk)
    assert [item["command"] for item in kept[1:]] == [item["command"] for item in MISSION]
    assert (kept[5]["param1"], kept[5]["param2"], kept[5]["frame"]) == (90.0, 1.0, 0)
    assert (kept[7]["param1"], kept[7]["param3"]) == (1.0, 5.0)
    assert kept[8]["param1"] == 1.0


def test_corners_are_cut_and_stops_are_not(yard: Yard) -> None:
    """A waypoint with another after it is passed; the last one is a stop."""
    begin(yard, [at(WAYPOINT, 20, 0), at(WAYPOINT, 40, 2)])
    slowest = math.inf
    while yard.place[0] < 28.0:
        yard.desk.world.step(0.2)
        if yard.place[0] > 12.0:
            slowest = min(slowest, yard.speed)
    assert slowest > 2.0
    yard.desk.until(lambda: "Mission Complete" in yard.desk.texts() and yard.stands(), 40.0)
    assert math.dist(yard.place, (40.0, 2.0)) < 1.5


def test_speed_is_kept_to(yard: Yard) -> None:
    begin(yard, [do(SPEED, 1, 2.0), at(WAYPOINT, 25, 0)])
    yard.desk.until(lambda: "speed: 2.0 m/s" in yard.desk.texts(), 1.0)
    yard.desk.until(lambda: yard.place[0] > 10.0, 40.0)
    assert yard.speed == pytest.approx(2.0, abs=0.25)


def test_stays_for_ever(yard: Yard) -> None:
    begin(yard, [at(LOITER_UNLIM, 6, 0), at(WAYPOINT, 30, 0)])
    yard.desk.until(lambda: "Reached waypoint #1" in yard.desk.texts(), 30.0)
    yard.desk.world.step(4.0)
    assert abs(yard.speed) < 0.5
    assert yard.place[0] == pytest.approx(6.0, abs=1.5)


def test_hands_over_and_takes_back(yard: Yard) -> None:
    """GUIDED_ENABLE: others steer until DO_GUIDED_LIMITS end it."""
    begin(yard, [do(LIMITS, 4.0), do(GUIDED_ENABLE, 1), at(WAYPOINT, -20, 0)])
    yard.desk.world.step(0.2)
    assert yard.rover.takes_targets
    yard.goto(20.0, 0.0)
    yard.desk.world.step(3.0)
    assert yard.speed > 1.0
    yard.desk.until(lambda: "Mission: 3 WP" in yard.desk.texts(), 3.0)
    assert not yard.rover.takes_targets


def test_a_condition_waits_for_the_distance(yard: Yard) -> None:
    begin(yard, [at(WAYPOINT, 5, 0), do(CONDITION_DISTANCE, 10), do(SPEED, 1, 1.0), at(WAYPOINT, 30, 0)])
    yard.desk.until(lambda: "speed: 1.0 m/s" in yard.desk.texts(), 40.0)
    assert yard.place[0] == pytest.approx(20.0, abs=1.0)


def test_a_command_it_does_not_know_is_passed(yard: Yard) -> None:
    """A takeoff is none of a rover's."""
    begin(yard, [plans.takeoff(10.0), at(WAYPOINT, 5, 0)])
    yard.desk.until(lambda: "Mission Complete" in yard.desk.texts(), 30.0)


@pytest.mark.parametrize(("behaviour", "mode"), [(0, "AUTO"), (1, "AUTO"), (2, "ACRO"), (3, "MANUAL")])
def test_after_the_mission(make_yard: MakeYard, behaviour: int, mode: str) -> None:
    """MIS_DONE_BEHAVE."""
    yard = make_yard(params={"MIS_DONE_BEHAVE": behaviour})
    begin(yard, [at(WAYPOINT, 3, 0)])
    yard.desk.until(lambda: "Mission Complete" in yard.desk.texts(), 30.0)
    yard.desk.world.step(0.5)
    assert yard.rover.mode.name == mode


def test_a_changed_mission_is_begun_again(yard: Yard) -> None:
    begin(yard, [at(WAYPOINT, 60, 0)])
    yard.desk.world.step(3.0)
    place = yard.rover.position
    far = at(WAYPOINT, 0, 40)
    far = {**far, "x": round(place.lat_deg * 1e7), "y": round(place.lon_deg * 1e7) + 4000}
    assert plans.upload(yard.desk, [far]) == 0
    yard.desk.world.step(0.3)
    assert "Auto mission changed, restarted command" in yard.desk.texts()
    yard.desk.until(lambda: yard.place[1] > 4.0, 40.0)


def test_disarmed_in_auto_it_keeps_its_place(yard: Yard) -> None:
    begin(yard, [at(WAYPOINT, 4, 0), at(WAYPOINT, 30, 0)])
    yard.desk.until(lambda: yard.rover.mission.current == 2, 20.0)
    yard.desk.command(400, 0)
    assert yard.rover.mission.current == 2
    yard.mode(4)
    yard.desk.command(400, 1)
    yard.desk.command(400, 0)
    assert yard.rover.mission.current == 0
