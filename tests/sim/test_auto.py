"""AUTO in the simulated ArduCopter: when it starts, each command, the end, and what happens under way.

Figures that are said to be measured are ArduCopter SITL's on the same plan.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.sim.conftest import Gcs
from tests.sim.plans import at, do, fly, reached, takeoff, upload
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.sim.conftest import MakeGcs

GUIDED, AUTO, LOITER, RTL, LAND = 4, 3, 5, 6, 9
ACCEPTED, DENIED, FAILED = 0, 2, 4
ARM, SET_MODE, START, PAUSE = 400, 176, 300, 193
UP = takeoff(5.0)


@pytest.fixture
def ready(gcs: Gcs) -> Gcs:
    gcs.world.step(1.0)
    return gcs


def mode(gcs: Gcs) -> int:
    return gcs.vehicle.copter.mode.number


def done(gcs: Gcs, seq: int, within: float = 60.0) -> float:
    """Wait until an item is reached; the simulated seconds that took."""
    return gcs.until(lambda: seq in reached(gcs), within)


def aloft(gcs: Gcs, plan: list[dict[str, object]]) -> None:
    """Fly the plan, from where its takeoff ends on."""
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    assert upload(gcs, [UP, *plan]) == ACCEPTED
    gcs.put_up(5.0)
    assert gcs.command(SET_MODE, 1, AUTO) == ACCEPTED
    # A command that is done at once takes the takeoff's place in what is reported.
    gcs.until(lambda: bool(reached(gcs)))


class TestStart:
    def test_disarmed_it_is_accepted_without_a_mission_and_arming_is_then_refused(self, ready: Gcs) -> None:
        assert ready.command(SET_MODE, 1, AUTO) == ACCEPTED
        assert ready.command(START) == ACCEPTED
        assert ready.command(ARM, 1) == FAILED
        assert ready.texts()[-1] == "Arm: Mode requires mission"
        assert upload(ready, [UP]) == ACCEPTED
        assert ready.command(ARM, 1) == FAILED
        assert ready.texts()[-1] == "Arm: AUTO mode not armable"

    @pytest.mark.parametrize(
        ("plan", "words"),
        [
            ([], ["Mode change to AUTO failed: init failed"]),
            ([at(16, 5, 0, 5)], ["Auto: Missing Takeoff Cmd", "Mode change to AUTO failed: init failed"]),
        ],
    )
    def test_armed_on_the_ground_it_needs_a_mission_that_takes_off(
        self, ready: Gcs, plan: list[dict[str, object]], words: list[str]
    ) -> None:
        assert upload(ready, plan) == ACCEPTED
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        assert ready.command(ARM, 1) == ACCEPTED
        ready.clear("STATUSTEXT")
        assert ready.command(START) == FAILED
        assert ready.texts() == words
        assert mode(ready) == GUIDED

    def test_chosen_with_the_stick_down_it_waits_for_throttle(self, ready: Gcs) -> None:
        assert upload(ready, [UP]) == ACCEPTED
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        assert ready.command(ARM, 1) == ACCEPTED
        assert ready.command(SET_MODE, 1, AUTO) == ACCEPTED
        ready.world.step(6.0)
        assert ready.ned[2] == 0.0
        ready.vehicle.copter.pilot.sticks(throttle=0.5)
        done(ready, 1)

    def test_in_the_air_it_climbs_to_the_takeoff_s_height(self, ready: Gcs) -> None:
        assert upload(ready, [takeoff(10.0), at(16, 20, 0, 10)]) == ACCEPTED
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        assert ready.command(ARM, 1) == ACCEPTED
        assert ready.command(22, 0, 0, 0, 0, 0, 0, 3.0) == ACCEPTED
        ready.until(lambda: ready.near(0, 0, -3, 0.2))
        assert ready.command(SET_MODE, 1, AUTO) == ACCEPTED
        done(ready, 1)
        assert ready.near(0, 0, -10, 0.3)
        done(ready, 2)

    def test_left_waiting_it_disarms(self, ready: Gcs) -> None:
        assert upload(ready, [UP]) == ACCEPTED
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        assert ready.command(ARM, 1) == ACCEPTED
        assert ready.command(SET_MODE, 1, AUTO) == ACCEPTED
        took = ready.until(lambda: not ready.vehicle.copter.armed)
        assert took == pytest.approx(10.0, abs=0.5)  # DISARM_DELAY

    @pytest.mark.parametrize("p", [(1, 0), (0, 2)])
    def test_parts_of_a_mission_cannot_be_started(self, ready: Gcs, p: tuple[int, int]) -> None:
        assert ready.command(START, *p) == DENIED


class Record:
    """One flight: where it was every tenth of a second since MISSION_START, and when it reached and said what."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs = gcs
        self.track: list[tuple[float, float, float]] = []
        self.speeds: list[tuple[float, float]] = []
        self.reached: dict[int, float] = {}
        self.order: list[int] = []
        self.said: dict[str, float] = {}
        self.disarmed: float | None = None

    def note(self, t: float) -> None:
        copter, sense = self.gcs.vehicle.copter, self.gcs.vehicle.copter.sense
        self.track.append(copter.local)
        self.speeds.append((sense.vn, sense.ve))
        for seq in reached(self.gcs):
            self.reached[seq] = t
            self.order.append(seq)
        for text in self.gcs.texts():
            self.said.setdefault(text, t)
        if not copter.armed and self.disarmed is None:
            self.disarmed = t
        self.gcs.frames.clear()

    def at(self, t: float) -> tuple[float, float, float]:
        """Where it was then: north, east, up."""
        north, east, down = self.track[min(round(t * 10), len(self.track) - 1)]
        return north, east, -down

    def speed(self, t: float) -> float:
        return math.hypot(*self.speeds[round(t * 10)])


PLANS: dict[str, list[dict[str, object]]] = {
    "measured": [
        takeoff(10.0),
        at(16, 30, 0, 10),
        at(16, 30, 30, 15, 3.0),
        do(178, 1, 3.0, -1),
        at(16, 60, 30, 15),
        at(16, 60, 60, 12),
        do(20),
    ],
    "delay": [UP, at(16, 8, 0, 5, 2.0), at(16, 16, 0, 5)],
    "through": [UP, at(16, 15, 0, 5), at(16, 30, 0, 5)],
    "heights": [
        UP,
        at(16, 5, 0, 8, 1.0),
        at(16, 10, 0, 584.09 + 6.0, 1.0, frame=0),
        at(16, 15, 0, 0.0, 1.0),
        at(16, 20, 0, 7, 1.0, frame=10),
    ],
    "here": [UP, {"command": 16, "frame": 6, "z": 9.0}, at(16, 5, 0, 9)],
    "line": [UP, at(16, 30, 0, 15)],
    "unlimited": [UP, at(17, 6, 0, 5), do(20)],
    "time": [UP, at(19, 6, 0, 5, 4.0), do(20)],
    "return": [UP, at(16, 5, 0, 5), do(20)],
    "land there": [UP, at(21, 8, 3), at(16, 50, 0, 5)],
    "land": [UP, do(21)],
    "jumps": [UP, at(16, 3, 0, 5), at(16, 6, 0, 5), do(177, 2, 2), at(16, 9, 0, 5)],
    "no end": [UP, do(177, 3, -1), do(177, 2, -1)],
    "home": [UP, at(179, 3, 4, 584.09, 0.0, frame=0), at(16, 5, 0, 5)],
}
FLOWN_S = 65.0


@pytest.fixture(scope="module")
def flown() -> Iterator[dict[str, Record]]:
    """All plans at once, each on a copter of its own that starts where the worlds' home is."""
    specs = [VehicleSpec(start_ned_m=(0.0, 0.0, 0.0)) for _ in PLANS]
    world = World(specs, ready_s=0.5, epoch_s=86400.0 * 20000)  # midnight
    records = {name: Record(Gcs(world, vehicle)) for name, vehicle in zip(PLANS, world.vehicles, strict=True)}
    world.step(1.0)
    for name, record in records.items():
        fly(record.gcs, PLANS[name])
    start = world.time_s
    while world.time_s - start < FLOWN_S:
        for record in records.values():
            record.note(world.time_s - start)
        world.step(0.1)
    yield records
    world.close()


def test_a_whole_mission_takes_as_long_as_the_real_one(flown: dict[str, Record]) -> None:
    """Measured, from MISSION_START to each item: 10.5, 19.2, 30.4, 42.5 and 54.4 s; corners passed as near."""
    record = flown["measured"]
    assert [record.reached[seq] for seq in (1, 2, 4, 5, 6)] == pytest.approx([10.5, 19.2, 30.4, 42.5, 54.4], rel=0.06)
    # In the middle of the first corner, measured (28.9, 1.3).
    assert record.at(record.reached[2])[:2] == pytest.approx((28.9, 1.3), abs=0.4)
    assert 3 not in record.reached  # items 3 and 4 are done at once: the last one is told
    fields = record.gcs.last("MISSION_CURRENT")
    assert (fields["seq"], fields["total"], fields["mission_state"], fields["mission_mode"]) == (7, 7, 3, 1)


class TestCommands:
    def test_a_waypoint_with_a_delay_waits_there(self, flown: dict[str, Record]) -> None:
        record = flown["delay"]
        left = record.reached[2]
        assert record.at(left - 1.9) == pytest.approx((8, 0, 5), abs=0.5)
        assert record.speed(left - 1.0) < 0.1
        assert "Reached command #2" in record.said

    def test_a_waypoint_without_one_is_flown_through(self, flown: dict[str, Record]) -> None:
        record = flown["through"]
        assert record.speed(record.reached[2]) > 1.0
        assert record.speed(record.reached[3] + 1.0) < 0.3

    def test_heights_above_home_above_the_sea_and_left_open(self, flown: dict[str, Record]) -> None:
        record = flown["heights"]
        assert [record.at(record.reached[seq])[2] for seq in (2, 3, 4, 5)] == pytest.approx([8, 6, 6, 7], abs=0.2)

    def test_a_place_left_open_is_here(self, flown: dict[str, Record]) -> None:
        record = flown["here"]
        assert record.at(record.reached[2]) == pytest.approx((0, 0, 9), abs=0.7)

    def test_a_straight_line_is_kept_in_height_too(self, flown: dict[str, Record]) -> None:
        record = flown["line"]
        half = next(point for point in record.track if point[0] > 15.0)
        assert half[2] == pytest.approx(-10.0, abs=0.4)

    def test_loiter_unlimited_stays(self, flown: dict[str, Record]) -> None:
        record = flown["unlimited"]
        assert record.at(FLOWN_S) == pytest.approx((6, 0, 5), abs=0.3)
        assert record.order == [1]

    def test_loiter_time(self, flown: dict[str, Record]) -> None:
        record = flown["time"]
        assert record.at(record.reached[2] - 3.8) == pytest.approx((6, 0, 5), abs=0.6)
        assert record.at(record.reached[2] - 6.5)[0] < 5.5

    def test_return_lands_and_disarms(self, flown: dict[str, Record]) -> None:
        record = flown["return"]
        assert record.disarmed is not None
        assert record.at(FLOWN_S) == pytest.approx((0, 0, 0), abs=0.3)
        assert record.order[-1] == 3
        assert mode(record.gcs) == AUTO

    @pytest.mark.parametrize(("name", "place"), [("land there", (8, 3, 0)), ("land", (0, 0, 0))])
    def test_a_landing_ends_it_all(self, flown: dict[str, Record], name: str, place: tuple[int, ...]) -> None:
        record = flown[name]
        assert record.disarmed is not None
        assert record.at(FLOWN_S) == pytest.approx(place, abs=0.3)
        assert record.order == [1]  # the landing is not reported: the mission stops in it

    def test_jumps_are_counted(self, flown: dict[str, Record]) -> None:
        record = flown["jumps"]
        assert [seq for seq in record.order if seq in (2, 3, 5)] == [2, 3, 2, 3, 2, 3, 5]
        assert [t for t in record.said if "Jump" in t] == ["Mission: 4 Jump 1/2", "Mission: 4 Jump 2/2"]

    def test_jumps_without_end_do_not_hang_it(self, flown: dict[str, Record]) -> None:
        record = flown["no end"]
        assert record.at(FLOWN_S)[2] == pytest.approx(5.0, abs=0.3)
        assert record.gcs.last("MISSION_CURRENT")["mission_state"] == 5

    def test_home_can_be_moved(self, flown: dict[str, Record]) -> None:
        assert flown["home"].gcs.vehicle.copter.home_world == pytest.approx((3.0, 4.0, 0.0), abs=0.05)
        assert 3 in flown["home"].reached


def test_wind_does_not_blow_it_off(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(wind=(3.0, 5.0, 0.0))
    aloft(gcs, [at(16, 20, 0, 5)])
    while 2 not in reached(gcs):
        gcs.world.step(0.2)
        assert abs(gcs.ned[1]) < 1.5
    assert gcs.near(20, 0, -5, 2.0)


def test_speeds_are_changed_for_this_mission_only(ready: Gcs) -> None:
    aloft(ready, [do(178, 1, 2.0), at(16, 60, 0, 5)])
    ready.until(lambda: ready.ned[0] > 8.0)
    assert ready.vehicle.copter.sense.vn == pytest.approx(2.0, abs=0.1)
    assert ready.command(178, 1, 4.0) == ACCEPTED  # from the ground, under way
    ready.world.step(3.0)
    assert ready.vehicle.copter.sense.vn == pytest.approx(4.0, abs=0.2)
    assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert ready.vehicle.copter.sp.limit_of("speed") == pytest.approx(10.0)


class TestUnderWay:
    def test_at_the_end_it_stays_where_it_is(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 10, 0, 5)])
        done(ready, 2)
        ready.world.step(6.0)
        assert ready.near(10, 0, -5, 0.4)
        assert mode(ready) == AUTO
        assert ready.last("MISSION_CURRENT")["mission_state"] == 5

    @pytest.mark.parametrize(("restart", "first"), [(0, 3), (1, 1)])
    def test_coming_back_it_goes_on_or_starts_again(self, make_gcs: MakeGcs, restart: int, first: int) -> None:
        gcs = make_gcs([VehicleSpec(params={"MIS_RESTART": restart})])
        aloft(gcs, [at(16, 10, 0, 5), at(16, 30, 0, 5)])
        done(gcs, 2)
        assert gcs.command(SET_MODE, 1, LOITER) == ACCEPTED
        assert gcs.last("MISSION_CURRENT")["mission_state"] == 2
        gcs.vehicle.copter.pilot.sticks(throttle=0.5)
        gcs.world.step(3.0)
        gcs.clear("MISSION_ITEM_REACHED")
        assert gcs.command(SET_MODE, 1, AUTO) == ACCEPTED
        gcs.until(lambda: bool(reached(gcs)))
        assert reached(gcs)[0] == first

    def test_after_its_end_it_starts_again(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 5, 0, 5)])
        done(ready, 2)
        ready.world.step(1.0)
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        ready.clear("MISSION_ITEM_REACHED")
        assert ready.command(SET_MODE, 1, AUTO) == ACCEPTED
        done(ready, 2)
        assert reached(ready)[0] == 1

    def test_another_item_can_be_made_current(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 60, 0, 5), at(16, 0, 60, 5), at(16, 5, 5, 5)])
        ready.world.step(2.0)
        ready.send("MISSION_SET_CURRENT", seq=4)
        ready.until(lambda: ready.near(5, 5, -5, 1.0))
        assert reached(ready) == [1]

    def test_a_running_mission_cannot_be_cleared(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 40, 0, 5)])
        ready.send("MISSION_CLEAR_ALL")
        assert ready.all("MISSION_ACK")[-1]["type"] == 1
        assert ready.command(SET_MODE, 1, GUIDED) == ACCEPTED
        ready.send("MISSION_CLEAR_ALL")
        assert ready.all("MISSION_ACK")[-1]["type"] == 0

    def test_the_pilot_takes_over(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 60, 0, 5)])
        ready.vehicle.pilot_mode("LOITER")
        ready.world.step(4.0)
        assert mode(ready) == LOITER
        there = ready.ned
        ready.world.step(2.0)
        assert ready.near(*there, within=0.3)

    def test_where_it_goes_is_reported(self, ready: Gcs) -> None:
        aloft(ready, [at(16, 40, 0, 5)])
        ready.world.step(1.0)
        target = ready.last("POSITION_TARGET_GLOBAL_INT")
        assert target["lat_int"] == at(16, 40, 0)["x"]
        assert ready.last("NAV_CONTROLLER_OUTPUT")["wp_dist"] > 30
        assert ready.last("EXTENDED_SYS_STATE")["landed_state"] == 2
