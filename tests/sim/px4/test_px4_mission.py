"""Missions of the simulated PX4: kept as a whole or not at all, and flown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion

WAYPOINT, RETURN, LAND, TAKEOFF, JUMP, SPEED = 16, 20, 21, 22, 177, 178
ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE = 0, 1, 3, 4
Item = dict[str, Any]


def item(
    companion: Companion, command: int, north: float = 0.0, east: float = 0.0, up: float = 5.0, **more: Any
) -> Item:
    place = companion.vehicle.px4.place((north, east, 0.0))
    x, y = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
    frame = 2 if command in (RETURN, JUMP, SPEED) else 6  # MAV_FRAME_MISSION where there is no place
    return {"command": command, "frame": frame, "x": x, "y": y, "z": up, "autocontinue": 1, **more}


def upload(companion: Companion, items: list[Item], kind: int = 0) -> list[int]:
    """What was asked for, and at the end the verdict."""
    companion.clear()
    companion.send("MISSION_COUNT", count=len(items), mission_type=kind)
    asked: list[int] = []
    while not companion.all("MISSION_ACK"):
        requests = [m["seq"] for m in companion.all("MISSION_REQUEST_INT")]
        asked.append(requests[-1])
        companion.send("MISSION_ITEM_INT", seq=requests[-1], mission_type=kind, **items[requests[-1]])
    return [*asked, companion.all("MISSION_ACK")[-1]["type"]]


def download(companion: Companion, kind: int = 0) -> list[tuple[int, float]]:
    companion.clear()
    companion.send("MISSION_REQUEST_LIST", mission_type=kind)
    count = companion.all("MISSION_COUNT")[-1]["count"]
    for seq in range(count):
        companion.send("MISSION_REQUEST_INT", seq=seq, mission_type=kind)
    return [(m["command"], m["z"]) for m in companion.all("MISSION_ITEM_INT")]


class TestKeeping:
    def test_what_was_uploaded_comes_back_without_an_item_for_home(self, companion: Companion) -> None:
        plan = [item(companion, TAKEOFF, up=4.0), item(companion, WAYPOINT, 5.0), item(companion, LAND, 5.0, up=0.0)]
        assert upload(companion, plan) == [0, 1, 2, ACCEPTED]
        assert download(companion) == [(TAKEOFF, 4.0), (WAYPOINT, 5.0), (LAND, 0.0)]

    def test_each_list_has_a_number_of_its_own(self, companion: Companion) -> None:
        def number() -> int:
            return int(companion.all("MISSION_ACK")[-1]["opaque_id"])

        upload(companion, [item(companion, WAYPOINT)])
        first = number()
        upload(companion, [item(companion, WAYPOINT, up=6.0)])
        assert number() != first
        upload(companion, [item(companion, WAYPOINT)])
        assert number() == first != 0
        download(companion)
        assert companion.all("MISSION_COUNT")[-1]["opaque_id"] == first
        upload(companion, [{"command": 5100, "frame": 6, "x": 1, "y": 1, "z": 1.0}], kind=2)
        assert number() not in (0, first)
        assert len(download(companion)) == 1

    def test_an_upload_that_breaks_off_leaves_the_old_one(self, companion: Companion) -> None:
        upload(companion, [item(companion, WAYPOINT, up=7.0)])
        companion.send("MISSION_COUNT", count=2)
        companion.send("MISSION_ITEM_INT", seq=0, **item(companion, WAYPOINT, up=1.0))
        companion.clear()
        companion.world.step(4.9)
        # It asks again, four times a second, for the one that is missing.
        assert {m["seq"] for m in companion.all("MISSION_REQUEST_INT")} == {1}
        assert len(companion.all("MISSION_REQUEST_INT")) == pytest.approx(19, abs=1)
        companion.world.step(0.3)
        companion.clear()
        companion.world.step(1.0)
        assert companion.all("MISSION_REQUEST_INT") == []
        assert download(companion) == [(WAYPOINT, 7.0)]

    @pytest.mark.parametrize(
        ("bad", "verdict"), [({"command": 31000}, UNSUPPORTED), ({"frame": 1}, 2), ({"z": math.inf}, 12)]
    )
    def test_so_does_an_item_it_does_not_take(self, companion: Companion, bad: Item, verdict: int) -> None:
        upload(companion, [item(companion, WAYPOINT, up=7.0)])
        assert upload(companion, [item(companion, WAYPOINT), {**item(companion, WAYPOINT), **bad}]) == [0, 1, verdict]
        assert download(companion) == [(WAYPOINT, 7.0)]

    @pytest.mark.parametrize("frame", [0, 3, 5, 6])
    @pytest.mark.parametrize("command", [RETURN, JUMP, SPEED])
    def test_an_item_without_a_place_is_taken_in_its_own_frame_only(
        self, companion: Companion, command: int, frame: int
    ) -> None:
        """Measured on 1.16.1."""
        bad = {**item(companion, command), "frame": frame}
        assert upload(companion, [item(companion, WAYPOINT), bad]) == [0, 1, UNSUPPORTED]
        assert upload(companion, [item(companion, WAYPOINT), {**bad, "frame": 2}]) == [0, 1, ACCEPTED]
        assert upload(companion, [{**item(companion, WAYPOINT), "frame": 2}]) == [0, UNSUPPORTED]

    def test_one_that_is_too_long_or_for_nothing_known_is_refused(self, companion: Companion) -> None:
        for fields, verdict in (({"count": 501}, NO_SPACE), ({"count": 1, "mission_type": 9}, UNSUPPORTED)):
            companion.clear()
            companion.send("MISSION_COUNT", **fields)
            assert [m["type"] for m in companion.all("MISSION_ACK")] == [verdict]

    def test_clearing_one_leaves_the_others(self, companion: Companion) -> None:
        upload(companion, [item(companion, WAYPOINT)])
        upload(companion, [{"command": 5100, "frame": 6, "x": 1, "y": 1, "z": 1.0}], kind=2)
        companion.send("MISSION_CLEAR_ALL", mission_type=0)
        assert (len(download(companion)), len(download(companion, kind=2))) == (0, 1)


class TestFlying:
    def test_it_takes_off_flies_the_points_and_lands(self, companion: Companion) -> None:
        plan = [
            item(companion, TAKEOFF, up=4.0),
            item(companion, SPEED, param1=1.0, param2=3.0),
            item(companion, WAYPOINT, 10.0, 0.0, param1=1.0),
            item(companion, WAYPOINT, 10.0, 8.0),
            item(companion, LAND, 10.0, 8.0, up=0.0),
        ]
        upload(companion, plan)
        companion.ready()
        assert companion.command(300) == [0]
        fastest = 0.0

        def over() -> bool:
            nonlocal fastest
            sense = companion.vehicle.px4.sense
            fastest = max(fastest, math.hypot(sense.vn, sense.ve))
            return not companion.vehicle.px4.armed

        companion.until(over, 120.0)
        assert [m["seq"] for m in companion.all("MISSION_ITEM_REACHED")] == [0, 1, 2, 3, 4]
        assert companion.near(10.0, 8.0, 0.0, 1.0)
        assert fastest < 3.4
        current = [m for m in companion.all("MISSION_CURRENT") if m["total"] == 5]
        assert {m["mission_state"] for m in current} >= {3, 5}
        assert [m["seq"] for m in current] == sorted(m["seq"] for m in current)

    def test_only_the_message_sets_the_current_item(self, companion: Companion) -> None:
        """DO_SET_MISSION_CURRENT (224) is unknown to PX4."""
        upload(companion, [item(companion, WAYPOINT, north, 0.0) for north in (3.0, 6.0)])
        assert companion.command(224, 1) == [UNSUPPORTED]
        assert companion.vehicle.px4.mission.current == 0
        companion.send("MISSION_SET_CURRENT", seq=1)
        assert companion.vehicle.px4.mission.current == 1

    def test_after_the_last_point_it_holds_and_a_jump_repeats(self, companion: Companion) -> None:
        plan = [
            item(companion, WAYPOINT, 4.0, 0.0),
            item(companion, WAYPOINT, 0.0, 0.0),
            item(companion, JUMP, param1=0.0, param2=1.0),
        ]
        upload(companion, plan)
        companion.put_up()
        assert companion.mode(4, 4) == [0, 0]
        companion.until(lambda: companion.flying == "HOLD", 90.0)
        assert [m["seq"] for m in companion.all("MISSION_ITEM_REACHED")] == [0, 1, 0, 1, 2]

    def test_an_interrupted_one_goes_on_where_it_was(self, companion: Companion) -> None:
        upload(companion, [item(companion, WAYPOINT, n, 0.0) for n in (3.0, 40.0)] + [item(companion, RETURN)])
        companion.put_up()
        companion.mode(4, 4)
        companion.until(lambda: companion.vehicle.px4.mission.current == 1)
        companion.mode(4, 3)
        companion.world.step(1.0)
        companion.mode(4, 4)
        companion.world.step(0.1)
        assert companion.vehicle.px4.mission.current == 1
        companion.send("MISSION_SET_CURRENT", seq=2)
        companion.world.step(0.1)
        assert companion.flying == "RTL"
