"""The geofence of the simulated PX4: its cylinder, polygons and circles, and what a breach of them does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.mavlink.event import event_id

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion, MakeCompanion

INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
Corner = tuple[float, float]


def upload(companion: Companion, rows: list[tuple[int, float, Corner]]) -> int:
    """Fence items of (command, param1, place about home in metres); gives the MAV_MISSION_RESULT."""
    px4 = companion.vehicle.px4
    companion.send("MISSION_COUNT", count=len(rows), mission_type=1)
    for seq, (command, p1, (north, east)) in enumerate(rows):
        place = px4.place((north, east, 0.0))
        companion.send(
            "MISSION_ITEM_INT",
            seq=seq,
            frame=0,
            command=command,
            current=0,
            autocontinue=1,
            param1=p1,
            mission_type=1,
            x=round(place.lat_deg * 1e7),
            y=round(place.lon_deg * 1e7),
            z=0.0,
        )
    companion.world.step(0.5)
    return int(companion.all("MISSION_ACK")[-1]["type"])


def square(half: float, command: int, about: Corner = (0.0, 0.0)) -> list[tuple[int, float, Corner]]:
    corners = [(half, half), (half, -half), (-half, -half), (-half, half)]
    return [(command, 4.0, (about[0] + n, about[1] + e)) for n, e in corners]


def fly_north(companion: Companion, until: float, sim_s: float = 30.0) -> float:
    """Streams 3 m/s to the north until the mode changes or it is there; gives how far it came."""
    companion.until(
        lambda: companion.ned[0] > until or companion.flying != "OFFBOARD",
        sim_s,
        say=lambda: companion.velocity(3.0, 0.0),
    )
    return companion.ned[0]


def ready(companion: Companion) -> None:
    companion.beat()
    companion.offboard(lambda: companion.position(0.0, 0.0, -6.0), 6.0)


@pytest.mark.parametrize(
    ("rows", "edge"),
    [
        (square(10.0, INCLUSION), 10.0),
        ([(CIRCLE_IN, 8.0, (0.0, 0.0))], 8.0),
        (square(3.0, EXCLUSION, (15.0, 0.0)), 12.0),
        ([(CIRCLE_OUT, 4.0, (15.0, 0.0))], 11.0),
    ],
    ids=["polygon", "circle", "polygon kept out", "circle kept out"],
)
def test_every_kind_of_area_stops_it_at_its_edge(
    companion: Companion, rows: list[tuple[int, float, Corner]], edge: float
) -> None:
    companion.ready()
    assert upload(companion, rows) == 0
    ready(companion)
    stopped = fly_north(companion, edge + 5.0)
    assert edge - 0.1 < stopped < edge + 1.5
    assert companion.flying == "HOLD"
    assert companion.vehicle.px4.system_status == 5
    assert "Geofence: approaching or outside geofence" in companion.texts()
    assert event_id("check_gf_violation_custom_gf") in companion.events()


@pytest.mark.parametrize(("action", "mode"), [(2, "HOLD"), (3, "RTL"), (5, "LAND")])
def test_the_cylinder_acts_as_told(make_companion: MakeCompanion, action: int, mode: str) -> None:
    companion = make_companion(params={"GF_MAX_HOR_DIST": 9.0, "GF_ACTION": float(action), "COM_FAIL_ACT_T": 0.0})
    ready(companion)
    assert fly_north(companion, 20.0) < 12.0
    assert companion.flying == mode
    assert "Geofence: exceeding maximum distance to Home" in companion.texts()
    # The pilot gets it out again: another mode is flown, with the breach still there.
    assert companion.mode(4, 3) == [0, 0]
    companion.world.step(0.5)
    assert companion.flying == "HOLD"


def test_the_height_counts_too(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"GF_MAX_VER_DIST": 9.0})
    ready(companion)
    say = lambda: companion.velocity(0.0, 0.0, -2.0)  # noqa: E731
    companion.until(lambda: companion.flying != "OFFBOARD", say=say)
    assert -11.0 < companion.ned[2] < -9.0
    companion.world.step(2.0)  # reports of the checks lie so far apart
    assert "Geofence: exceeding maximum altitude above Home" in companion.texts()


def test_a_warning_only_warns(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"GF_MAX_HOR_DIST": 6.0, "GF_ACTION": 1.0})
    ready(companion)
    assert fly_north(companion, 15.0) > 15.0
    assert companion.flying == "OFFBOARD" and companion.vehicle.px4.system_status == 4
    assert "Failsafe activated\t" in companion.texts()


def test_termination_stops_the_motors_for_good(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"GF_MAX_HOR_DIST": 6.0, "GF_ACTION": 4.0})
    ready(companion)
    fly_north(companion, 15.0)
    assert companion.flying == "TERMINATION"
    companion.until(lambda: companion.ned[2] > -0.5)
    assert companion.mode(4, 3)[-1] == 1
    assert companion.command(400, 0, 21196) == [0]
    assert companion.arm() == [1]


def test_without_an_action_nothing_happens(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"GF_MAX_HOR_DIST": 6.0, "GF_ACTION": 0.0})
    ready(companion)
    assert fly_north(companion, 15.0) > 15.0
    assert not [text for text in companion.texts() if "eofence" in text]


def test_an_area_without_home_is_not_taken(companion: Companion) -> None:
    companion.ready()
    companion.beat()
    assert upload(companion, square(5.0, INCLUSION, (40.0, 0.0))) == 0
    assert "Geofence invalid, doesn't contain Home position\t" in companion.texts()
    assert companion.arm() == [0]


@pytest.mark.parametrize("corners", [math.inf, 3e38])
def test_an_area_of_more_corners_than_were_sent_keeps_nobody(companion: Companion, corners: float) -> None:
    assert upload(companion, [(INCLUSION, corners, (50.0, 50.0)), (INCLUSION, corners, (60.0, 50.0))]) == 0
    assert companion.vehicle.failed is None
    assert companion.vehicle.px4.checks_ok


def test_an_area_without_the_flying_vehicle_is_not_taken(companion: Companion) -> None:
    companion.beat()
    companion.put_up(2.5)
    assert upload(companion, [(CIRCLE_OUT, 3.0, (20.0, 0.0))]) == 0
    assert not [text for text in companion.texts() if "invalid" in text]
    place = companion.vehicle.px4.place((20.0, 0.0, -2.5))
    x, y = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
    assert companion.command_int(192, x=x, y=y, z=place.alt_amsl_m, param1=-1, param2=1, param4=math.nan) == [0]
    companion.world.step(3.0)
    assert "Reposition is outside geofence\t" in companion.texts()
    assert companion.near(0.0, 0.0, -2.5, 0.6)


def test_a_breach_on_the_ground_stands_against_arming(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"GF_MAX_HOR_DIST": 5.0}, start_ned_m=(0.0, 0.0, 0.0))
    companion.ready()
    place = companion.vehicle.px4.place((30.0, 0.0, 0.0))
    nan = math.nan
    assert companion.command(179, 0, 0, 0, nan, place.lat_deg, place.lon_deg, place.alt_amsl_m) == [0]
    companion.world.step(0.5)
    assert companion.arm() == [1]
