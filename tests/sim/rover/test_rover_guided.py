"""GUIDED on the simulated ArduRover, against what the real one was seen to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tests.sim.conftest import VELOCITY

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

VELOCITY_AND_TURN, VELOCITY_AND_YAW, TURN_ONLY, YAW_ONLY = 0x5C7, 0x9C7, 0x5FF, 0x9FF
BODY, BODY_OFFSET, OFFSET = 8, 9, 7
QUIET = "target not received last 3secs, stopping"


def test_drives_to_a_place_and_stops(yard: Yard) -> None:
    """Within WP_RADIUS, and says so; the way there as the real one's was, second by second."""
    yard.ready()
    yard.goto(20.0, 0.0)
    real = [0.7, 2.6, 5.4, 9.2, 12.6, 15.0, 17.5, 19.1]
    track = []
    for _ in range(9):
        yard.gcs.world.step(1.0)
        track.append(yard.place[0])
    assert track[1:] == pytest.approx(real, abs=2.0)
    yard.gcs.until(lambda: bool(yard.gcs.all("MISSION_ITEM_REACHED")))
    yard.gcs.until(yard.stands)
    assert math.dist(yard.place, (20.0, 0.0)) < 1.0
    assert [m["seq"] for m in yard.gcs.all("MISSION_ITEM_REACHED")] == [0]
    yard.gcs.world.step(1.0)
    there = yard.place
    yard.gcs.world.step(2.0)
    assert math.dist(yard.place, there) < 0.05


def test_says_where_it_goes(yard: Yard) -> None:
    yard.ready()
    yard.goto(0.0, 20.0)
    yard.gcs.world.step(1.0)
    nav = yard.gcs.last("NAV_CONTROLLER_OUTPUT")
    assert (nav["target_bearing"], nav["nav_bearing"]) == (90, 0)
    assert nav["wp_dist"] in (19, 20)
    target = yard.gcs.last("POSITION_TARGET_GLOBAL_INT")
    assert (target["coordinate_frame"], target["type_mask"]) == (0, 0xFDF8)
    scaled, hud = yard.gcs.last("RC_CHANNELS_SCALED"), yard.gcs.last("VFR_HUD")
    servo = yard.gcs.last("SERVO_OUTPUT_RAW")
    assert scaled["chan3_scaled"] == pytest.approx((servo["servo3_raw"] - 1500) * 20.0, abs=10)
    assert hud["airspeed"] == hud["groundspeed"] > 0.1
    assert hud["throttle"] == pytest.approx((servo["servo3_raw"] - 1500) / 5.0, abs=1.0)


def test_a_place_is_held_for_ever(yard: Yard) -> None:
    yard.ready()
    yard.goto(12.0, 0.0)
    yard.gcs.until(lambda: yard.place[0] > 11.0, 40.0)
    assert QUIET not in yard.gcs.texts()


def test_frames_of_a_place(yard: Yard) -> None:
    """About the origin, or about where it is; the body's axes are turned by the heading."""
    yard.ready()
    yard.goto(5.0, 0.0)
    yard.gcs.until(lambda: yard.place[0] > 4.0 and yard.stands(), 30.0)
    for frame, end in ((1, (0.0, 12.0)), (OFFSET, (5.0, 12.0)), (BODY_OFFSET, (5.0, 12.0))):
        yard.goto(0.0, 12.0, frame=frame)
        assert yard.rover.guided.place is not None
        north, east = (a - b for a, b in zip(yard.rover.guided.place[:2], yard.rover.origin_world[:2], strict=True))
        assert (north, east) == pytest.approx(end, abs=1.0), frame


def test_velocity_and_its_timeout(yard: Yard) -> None:
    """The velocity's direction is the heading; three seconds after the last one it stops, and says so."""
    yard.ready()
    yard.keep(8.0, lambda: yard.goto(0.0, 0.0, mask=VELOCITY, vx=0.0, vy=2.0))
    assert yard.rover.sense.ve == pytest.approx(2.0, abs=0.15)
    assert yard.rover.sense.yaw == pytest.approx(math.pi / 2.0, abs=0.05)
    yard.gcs.world.step(2.7)
    assert QUIET not in yard.gcs.texts()
    assert yard.speed == pytest.approx(2.0, abs=0.15)
    yard.gcs.world.step(0.5)
    assert yard.gcs.texts() == [QUIET]
    assert yard.gcs.until(yard.stands) < 3.5


def test_no_faster_than_it_may(yard: Yard) -> None:
    yard.ready()
    yard.keep(9.0, lambda: yard.goto(0.0, 0.0, mask=VELOCITY, vx=15.0, vy=0.0))
    assert yard.speed == pytest.approx(yard.rover.params["WP_SPEED"], rel=0.1)


def test_velocity_with_a_turn_rate(yard: Yard) -> None:
    """Forward and turning; a negative velocity ahead backs up."""
    yard.ready()
    yard.keep(7.0, lambda: yard.goto(0.0, 0.0, BODY_OFFSET, VELOCITY_AND_TURN, vx=2.0, yaw_rate=0.5))
    assert yard.speed == pytest.approx(2.0, abs=0.3)
    assert yard.rover.sense.r == pytest.approx(0.5, abs=0.06)
    yard.keep(5.0, lambda: yard.goto(0.0, 0.0, BODY_OFFSET, VELOCITY_AND_TURN, vx=-1.0))
    assert yard.speed == pytest.approx(-1.0, abs=0.3)


def test_velocity_with_a_heading(yard: Yard) -> None:
    yard.ready()
    yard.keep(8.0, lambda: yard.goto(0.0, 0.0, 1, VELOCITY_AND_YAW, vx=1.5, yaw=-0.7))
    assert yard.rover.sense.yaw == pytest.approx(-0.7, abs=0.05)
    assert yard.speed == pytest.approx(1.5, abs=0.3)


def test_front_wheels_turn_nothing_on_the_spot(yard: Yard) -> None:
    yard.ready()
    yard.keep(2.0, lambda: yard.goto(0.0, 0.0, 1, TURN_ONLY, yaw_rate=0.5))
    assert abs(yard.rover.sense.yaw) < 0.02
    assert yard.gcs.last("SERVO_OUTPUT_RAW")["servo1_raw"] > 1600


def test_attitude_is_a_heading_and_a_share_of_the_speed(yard: Yard) -> None:
    yard.ready()
    half = math.pi / 4.0
    q = [math.cos(half), 0.0, 0.0, math.sin(half)]
    yard.keep(9.0, lambda: yard.gcs.send("SET_ATTITUDE_TARGET", type_mask=0b111, q=q, thrust=0.4))
    assert yard.rover.sense.yaw == pytest.approx(math.pi / 2.0, abs=0.05)
    assert yard.speed == pytest.approx(0.4 * yard.rover.params["WP_SPEED"], abs=0.2)
    yard.keep(6.0, lambda: yard.gcs.send("SET_ATTITUDE_TARGET", type_mask=128, q=q, thrust=0.2, body_yaw_rate=0.4))
    assert yard.rover.sense.r == pytest.approx(0.4, abs=0.06)


def test_reposition(yard: Yard) -> None:
    """COMMAND_INT only, GUIDED or with the flag; a speed needs a place before it."""
    yard.ready(4)
    lat, lon = -353632610 + 2000, 1491652300
    assert yard.gcs.command(192, -1, 1) == 8
    assert yard.gcs.command_int(192, x=lat, y=lon) == 2
    assert yard.gcs.command_int(192, param1=-1.0, param2=1.0, x=lat, y=lon) == 0
    assert yard.rover.mode.name == "GUIDED"
    assert yard.gcs.command_int(192, param1=2.0, x=lat, y=lon) == 0
    yard.gcs.until(lambda: yard.speed > 1.5)
    yard.gcs.world.step(4.0)
    assert yard.speed < 2.5
    assert yard.gcs.command_int(192, param1=-1.0, x=0, y=0) == 2


def test_change_of_speed(yard: Yard) -> None:
    """Verdicts as measured."""
    yard.ready()
    assert yard.gcs.command(178, 1, 2) == 4  # it has no place yet
    yard.goto(60.0, 0.0)
    assert yard.gcs.command(178, 1, 2) == 0
    yard.gcs.world.step(8.0)
    assert yard.speed == pytest.approx(2.0, abs=0.2)
    assert [yard.gcs.command(178, *p) for p in ((1, 0), (2, 1), (3, 1), (1, 5))] == [4, 2, 2, 0]


def test_accelerations_are_not_taken(yard: Yard) -> None:
    yard.ready()
    yard.goto(20.0, 0.0, mask=0xC3F)
    text = "".join(m["text"] for m in yard.gcs.all("STATUSTEXT"))
    assert text == "Ignoring SET_POSITION_TARGET_LOCAL_NED; set ACC_IGNORE in mask"
    yard.gcs.world.step(1.0)
    assert yard.stands()


def test_bad_places_are_ignored(yard: Yard) -> None:
    yard.ready()
    for bad in ({"x": math.nan}, {"y": math.inf}, {"frame": 4}):
        fields = {"x": 20.0, "y": 0.0, "frame": 1, **bad}
        yard.goto(fields["x"], fields["y"], frame=int(fields["frame"]))
        yard.gcs.world.step(0.5)
        assert yard.stands(), bad


def test_outside_guided_nothing_is_taken(yard: Yard) -> None:
    yard.ready(4)
    yard.goto(20.0, 0.0)
    yard.goto(0.0, 0.0, mask=VELOCITY, vx=3.0)
    yard.gcs.world.step(1.0)
    assert yard.stands()


def test_commands_as_the_real_one_answers_them(yard: Yard) -> None:
    yard.ready()
    results = {21: 3, 22: 3, 17: 3, 115: 3, 193: 3, 213: 3, 300: 4, 9999: 3}
    assert {number: yard.gcs.command(number) for number in results} == results


def test_it_drives_alike_however_often_the_world_ticks(make_yard: MakeYard) -> None:
    tracks = []
    for tick_hz in (100, 400):
        yard = make_yard(tick_hz=tick_hz)
        yard.ready()
        yard.goto(8.0, 3.0)
        track = []
        for _ in range(8):
            yard.gcs.world.step(1.0)
            track.append(yard.place)
        tracks.append(track)
    assert math.dist(tracks[0][-1], (8.0, 3.0)) < 2.5
    assert max(math.dist(a, b) for a, b in zip(*tracks, strict=True)) < 0.1
