"""The mission service as the simulated ArduCopter offers it: missions, fences and rally points, up and down."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from tests.sim.plans import HOME, RELATIVE, at, degrees, do, download, takeoff, upload

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255
ACCEPTED, ERROR, BAD_FRAME, UNSUPPORTED, NO_SPACE = 0, 1, 2, 3, 4
INVALID_SEQUENCE, DENIED, CANCELLED = 13, 14, 15
PLAN = [takeoff(10.0), at(16, 20.0, 5.0, 12.0), do(20)]
SQUARE = [at(5001, n, e, 0.0, 4.0) for n, e in ((-20, -20), (-20, 20), (20, 20), (20, -20))]

AnotherGcs = Callable[..., "Gcs"]


@pytest.fixture
def ready(gcs: Gcs) -> Gcs:
    """A copter that has found its home."""
    gcs.world.step(1.0)
    return gcs


def acks(gcs: Gcs) -> list[int]:
    return [m["type"] for m in gcs.all("MISSION_ACK")]


def count(gcs: Gcs, kind: int = MISSION) -> int:
    gcs.clear("MISSION_COUNT")
    gcs.send("MISSION_REQUEST_LIST", mission_type=kind)
    return int(gcs.all("MISSION_COUNT")[-1]["count"])


class TestUpload:
    def test_a_plan_comes_back_as_it_is_kept(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        assert "Flight plan received" in ready.texts()
        home, up, waypoint, back = download(ready)
        assert (home["command"], home["frame"], home["x"], home["y"]) == (16, 0, *degrees(0.0, 0.0))
        assert home["z"] == pytest.approx(584.09)  # where it is, whatever was uploaded
        assert (up["command"], up["frame"], up["z"]) == (22, 3, 10.0)
        assert (waypoint["x"], waypoint["y"], waypoint["z"]) == (*degrees(20.0, 5.0), 12.0)
        assert (back["command"], back["frame"], back["autocontinue"]) == (20, 0, 1)
        assert {item["target_system"] for item in (home, up)} == {255}

    def test_before_anything_there_is_nothing_and_then_home(self, gcs: Gcs) -> None:
        assert count(gcs) == 0
        gcs.world.step(1.0)
        assert count(gcs) == 1
        assert gcs.vehicle.copter.params["MIS_TOTAL"] == 1.0

    def test_the_vehicle_asks_item_by_item_for_the_one_it_needs(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=3)
        for seq, item in enumerate([HOME, *PLAN[:2]]):
            assert [m["seq"] for m in ready.all("MISSION_REQUEST")] == [seq]
            ready.clear("MISSION_REQUEST")
            ready.send("MISSION_ITEM_INT", seq=seq, **item)
        assert acks(ready) == [ACCEPTED]

    def test_what_is_not_answered_is_asked_for_every_second_and_given_up_after_eight(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=2)
        ready.world.step(7.9)
        assert [m["seq"] for m in ready.all("MISSION_REQUEST")] == [0] * 8
        assert acks(ready) == []
        ready.world.step(0.3)
        assert acks(ready) == [CANCELLED]
        assert ready.texts()[-1] == "Mission upload timeout"
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        assert acks(ready)[-1] == ERROR

    def test_a_late_item_is_still_taken(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=2)
        ready.world.step(5.0)
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        ready.world.step(5.0)
        ready.send("MISSION_ITEM_INT", seq=1, **PLAN[0])
        assert acks(ready) == [ACCEPTED]

    def test_another_number_than_the_one_asked_for_is_refused_and_the_upload_goes_on(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=2)
        ready.send("MISSION_ITEM_INT", seq=1, **PLAN[0])
        assert acks(ready) == [INVALID_SEQUENCE]
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        ready.send("MISSION_ITEM_INT", seq=1, **PLAN[0])
        assert acks(ready)[-1] == ACCEPTED

    def test_a_new_count_of_the_same_one_starts_again(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=3)
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        ready.clear("MISSION_REQUEST")
        ready.send("MISSION_COUNT", count=2)
        assert [m["seq"] for m in ready.all("MISSION_REQUEST")] == [0]

    def test_one_at_a_time(self, ready: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(ready.world, ready.vehicle, sysid=254)
        ready.send("MISSION_COUNT", count=2)
        other.send("MISSION_COUNT", count=5)
        other.send("MISSION_REQUEST_LIST")
        other.send("MISSION_REQUEST_INT", seq=0)
        other.send("MISSION_CLEAR_ALL")
        assert acks(other) == [DENIED, DENIED, DENIED, DENIED, ERROR]
        other.send("MISSION_ITEM_INT", seq=0, **HOME)
        assert acks(ready) == [DENIED]  # answers go to the link of the upload
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        ready.send("MISSION_ITEM_INT", seq=1, **PLAN[0])
        assert acks(ready)[-1] == ACCEPTED
        assert count(other) == 2

    def test_a_link_that_closes_ends_its_upload(self, ready: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(ready.world, ready.vehicle, sysid=254)
        other.send("MISSION_COUNT", count=5)
        ready.vehicle.node.close_channel(other.channel)
        assert upload(ready, PLAN) == ACCEPTED

    def test_a_broken_off_upload_leaves_what_came_and_what_there_was(self, ready: Gcs) -> None:
        assert upload(ready, [takeoff(5.0), at(16, 1.0, 1.0, 5.0), at(16, 2.0, 2.0, 5.0)]) == ACCEPTED
        ready.send("MISSION_COUNT", count=3)
        ready.send("MISSION_ITEM_INT", seq=0, **HOME)
        ready.send("MISSION_ITEM_INT", seq=1, **takeoff(77.0))
        ready.world.step(8.5)
        assert [item["z"] for item in download(ready)[1:]] == [77.0, 5.0]

    @pytest.mark.parametrize(
        ("item", "result"),
        [
            ({"command": 999}, UNSUPPORTED),
            ({"command": 0}, 5),
            ({"command": 16, "frame": 1}, BAD_FRAME),
            ({"command": 16, "x": 950_000_000}, 10),
            ({"command": 16, "y": 1_900_000_000}, 11),
            ({"command": 16, "z": 90_000.0}, 12),
            ({"command": 16, "param1": math.nan}, 6),
            ({"command": 16, "param2": math.inf}, 7),
            ({"command": 183, "param3": math.nan}, 8),
            ({"command": 183, "param4": math.nan}, 9),
            ({"command": 177, "param1": 0.0}, ERROR),
            ({"command": 177, "param1": 9.0}, ERROR),
        ],
    )
    def test_items_that_make_no_sense_end_it(self, ready: Gcs, item: dict[str, Any], result: int) -> None:
        assert upload(ready, [takeoff(5.0), {"frame": RELATIVE, **item}, do(20)]) == result
        ready.world.step(9.0)
        assert len(ready.all("MISSION_ACK")) == 1

    def test_yaw_may_be_left_open(self, ready: Gcs) -> None:
        assert upload(ready, [{**at(16, 5.0, 0.0, 5.0), "param4": math.nan}]) == ACCEPTED
        assert download(ready)[1]["param4"] == 0.0

    def test_parameters_are_kept_as_they_are_stored(self, ready: Gcs) -> None:
        items = [
            at(16, 1.0, 0.0, 5.678, 2.9, 7.0, 7.0, 7.0),  # only a delay in whole seconds, and centimetres
            at(19, 0.0, 0.0, 5.0, 3.0, 0.0, -7.0),
            do(183, 9.0, 1700.0, 5.0),
            do(177, 2.0, -1.0),
            do(1000, -30.0, 20.0, 0.0, 0.0),  # a gimbal, that there is not
        ]
        assert upload(ready, items) == ACCEPTED
        kept = [tuple(item[f"param{i}"] for i in range(1, 5)) for item in download(ready)[1:]]
        assert kept == [
            (2.0, 0.0, 0.0, 0.0),
            (3.0, 0.0, -1.0, 0.0),
            (9.0, 1700.0, 0.0, 0.0),
            (2.0, -1.0, 0.0, 0.0),
            (-30.0, 20.0, 0.0, 0.0),
        ]
        assert download(ready)[1]["z"] == pytest.approx(5.67)

    @pytest.mark.parametrize(("kind", "most"), [(MISSION, 650), (FENCE, 70), (RALLY, 46)])
    def test_there_is_so_much_room(self, ready: Gcs, kind: int, most: int) -> None:
        ready.send("MISSION_COUNT", count=most + 1, mission_type=kind)
        assert acks(ready) == [NO_SPACE]
        assert ready.texts()[-1] == f"Only {most} items are supported"
        ready.send("MISSION_COUNT", count=most, mission_type=kind)
        assert len(ready.all("MISSION_REQUEST")) == 1

    def test_a_long_one(self, ready: Gcs) -> None:
        plan = [takeoff(10.0), *(at(16, float(i), 0.0, 10.0) for i in range(120))]
        assert upload(ready, plan) == ACCEPTED
        assert [item["x"] for item in download(ready)[2:]] == [item["x"] for item in plan[1:]]

    def test_kinds_that_do_not_exist(self, ready: Gcs) -> None:
        ready.send("MISSION_COUNT", count=1, mission_type=3)
        ready.send("MISSION_REQUEST_LIST", mission_type=3)
        ready.send("MISSION_CLEAR_ALL", mission_type=ALL)
        ready.send("MISSION_ITEM_INT", mission_type=3)
        assert acks(ready) == [UNSUPPORTED] * 4


class TestOldMessages:
    def test_items_with_degrees_in_single_precision(self, ready: Gcs) -> None:
        x, y = degrees(20.0, 5.0)
        ready.send("MISSION_COUNT", count=2)
        ready.send("MISSION_ITEM", seq=0, command=16)
        ready.send("MISSION_ITEM", seq=1, command=16, frame=3, x=x * 1e-7, y=y * 1e-7, z=12.0)
        assert acks(ready) == [ACCEPTED]
        kept = download(ready)[1]
        assert kept["x"] == pytest.approx(x, abs=30)
        assert kept["y"] == pytest.approx(y, abs=100)

    def test_a_download_in_that_form(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        ready.send("MISSION_REQUEST", seq=2)
        item = ready.all("MISSION_ITEM")[-1]
        assert item["x"] == pytest.approx(degrees(20.0, 5.0)[0] * 1e-7, abs=1e-5)

    @pytest.mark.parametrize(("x", "y", "result"), [(95.0, 0.0, 10), (0.0, math.nan, 11)])
    def test_places_that_there_are_not(self, ready: Gcs, x: float, y: float, result: int) -> None:
        ready.send("MISSION_COUNT", count=2)
        ready.send("MISSION_ITEM", seq=0, command=16, x=x, y=y)
        assert acks(ready) == [result]

    def test_a_waypoint_for_guided_at_once(self, ready: Gcs) -> None:
        ready.put_up(5.0)
        x, y = degrees(6.0, 0.0)
        item = {"command": 16, "frame": 3, "current": 2, "x": x, "y": y, "z": 5.0}
        ready.send("MISSION_ITEM_INT", **item)
        assert acks(ready) == [ACCEPTED]
        ready.until(lambda: ready.near(6.0, 0.0, -5.0))
        assert ready.command(176, 1, 17) == ACCEPTED
        ready.send("MISSION_ITEM_INT", **item)
        assert acks(ready)[-1] == ERROR


class TestDownload:
    def test_home_can_always_be_read_and_nothing_beyond_the_end(self, ready: Gcs) -> None:
        ready.send("MISSION_REQUEST_INT", seq=0)
        assert ready.all("MISSION_ITEM_INT")[-1]["command"] == 16
        ready.send("MISSION_REQUEST_INT", seq=4)
        assert acks(ready) == [INVALID_SEQUENCE]
        assert ready.all("MISSION_COUNT")[-1]["count"] == 1  # so that the client learns

    def test_two_may_read_at_once(self, ready: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(ready.world, ready.vehicle, sysid=254)
        assert upload(ready, PLAN) == ACCEPTED
        assert len(download(ready)) == len(download(other)) == 4


class TestClearing:
    def test_makes_it_empty(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        ready.clear("MISSION_ACK")
        ready.send("MISSION_CLEAR_ALL")
        assert acks(ready) == [ACCEPTED]
        assert count(ready) == 0

    def test_the_length_is_a_parameter_that_everyone_is_told(self, ready: Gcs) -> None:
        ready.clear("PARAM_VALUE")
        assert upload(ready, PLAN) == ACCEPTED
        told = [m for m in ready.all("PARAM_VALUE") if m["param_id"] == "MIS_TOTAL"]
        assert told[-1]["param_value"] == 4.0

    def test_a_list_of_nothing_is_accepted(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        ready.clear("MISSION_ACK")
        ready.send("MISSION_COUNT", count=0)
        assert acks(ready) == [ACCEPTED]
        assert count(ready) == 0

    def test_a_mission_outlives_a_reboot(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        assert ready.command(246, 1) == 0
        ready.world.step(1.5)
        assert count(ready) == 4


class TestCurrent:
    def current(self, gcs: Gcs) -> tuple[int, int, int, int]:
        fields = gcs.last("MISSION_CURRENT")
        return fields["seq"], fields["total"], fields["mission_state"], fields["mission_mode"]

    def test_says_what_there_is(self, ready: Gcs) -> None:
        assert self.current(ready) == (0, 0, 1, 0)  # no mission
        assert upload(ready, PLAN) == ACCEPTED
        assert self.current(ready) == (0, 3, 2, 0)  # not started

    def test_is_set_by_message_and_the_number_comes_back(self, ready: Gcs) -> None:
        assert upload(ready, PLAN) == ACCEPTED
        ready.clear("MISSION_CURRENT")
        ready.send("MISSION_SET_CURRENT", seq=2)
        assert [m["seq"] for m in ready.all("MISSION_CURRENT")] == [2]
        assert self.current(ready)[0] == 2
        ready.clear("MISSION_CURRENT")
        ready.send("MISSION_SET_CURRENT", seq=9)
        assert ready.all("MISSION_CURRENT") == []

    def test_is_set_by_command(self, ready: Gcs) -> None:
        assert ready.command(224, 1) == 2  # denied: there is no such item
        assert upload(ready, PLAN) == ACCEPTED
        assert ready.command(224, 2) == 0
        assert self.current(ready)[0] == 2
        assert ready.command(224, 4) == 2


class TestRally:
    def test_points_go_up_and_down(self, ready: Gcs) -> None:
        points = [at(5100, 10.0, 0.0, 20.7), {**at(5100, 0.0, 10.0, 600.0), "frame": 0}]
        assert upload(ready, points, RALLY) == ACCEPTED
        found = download(ready, RALLY)
        assert [(p["command"], p["frame"], p["z"]) for p in found] == [(5100, 3, 20.0), (5100, 0, 600.0)]
        assert ready.vehicle.copter.params["RALLY_TOTAL"] == 2.0
        ready.send("MISSION_CLEAR_ALL", mission_type=RALLY)
        assert count(ready, RALLY) == 0

    @pytest.mark.parametrize(
        ("point", "result"),
        [({"command": 16}, UNSUPPORTED), ({"frame": 2}, BAD_FRAME), ({"z": 40000.0}, 12), ({"x": 2**31 - 1}, 10)],
    )
    def test_what_is_no_point(self, ready: Gcs, point: dict[str, Any], result: int) -> None:
        assert upload(ready, [{**at(5100, 0.0, 0.0, 5.0), **point}], RALLY) == result


class TestFence:
    def test_polygons_and_circles_go_up_and_down(self, ready: Gcs) -> None:
        assert upload(ready, [*SQUARE, at(5004, 10.0, 0.0, 0.0, 3.5)], FENCE) == ACCEPTED
        found = download(ready, FENCE)
        assert [(f["command"], f["param1"], f["frame"], f["autocontinue"]) for f in found] == [
            *[(5001, 4.0, 0, 0)] * 4,
            (5004, 3.5, 0, 0),
        ]
        assert "Fence Indexed OK" in ready.texts()

    @pytest.mark.parametrize(
        ("items", "result", "text"),
        [
            (SQUARE[:3], ERROR, "Incorrect item count"),
            ([at(5001, 0, 0, 0, 2.0)] * 2, ERROR, "Invalid vertex count (2)"),
            ([at(5003, 0, 0, 0, 0.0)], ERROR, "Non-positive circle radius"),
            ([SQUARE[0], at(5002, 0, 0, 0, 4.0)], ERROR, "Received incorrect vertex type"),
            ([SQUARE[0], at(5001, 0, 0, 0, 3.0)], ERROR, "Unexpected vertex count want=4 got=3"),
            ([SQUARE[0], at(5003, 0, 0, 0, 4.0)], ERROR, "Received incorrect type"),
            ([at(5000, 0, 0), at(5000, 1, 0)], ERROR, "Multiple return points"),
            ([{**at(5003, 0, 0, 0, 4.0), "x": 2**31 - 1}], ERROR, "Bad lat or lon"),
            ([at(16, 0, 0)], UNSUPPORTED, ""),
            ([{**at(5003, 0, 0, 0, 4.0), "frame": 1}], BAD_FRAME, ""),
            ([at(5001, 0, 0, 0, 300.0)], 6, ""),
        ],
    )
    def test_what_is_no_fence_leaves_the_old_one(
        self, ready: Gcs, items: list[dict[str, Any]], result: int, text: str
    ) -> None:
        assert upload(ready, SQUARE, FENCE) == ACCEPTED
        assert upload(ready, items, FENCE) == result
        assert not text or text in ready.texts()
        assert count(ready, FENCE) == 4
        assert len(ready.vehicle.copter.fence.items.areas) == 1
