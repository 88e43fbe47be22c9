"""ArduPlane's rules: waking up, arming, modes, taking off, targets in GUIDED, landing; with the real one's figures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tests.sim.plane.conftest import ARM, AUTO, AUTOLAND, CIRCLE, FBWA, GUIDED, LOITER, MANUAL, RTL, TAKEOFF
from tests.sim.plans import at, degrees, upload
from zmav.errors import BadInput
from zmav.sim import REALISTIC_READY_S

if TYPE_CHECKING:
    from tests.sim.plane.conftest import Field, MakeField

ACCEPTED, DENIED, UNSUPPORTED, FAILED, INT_ONLY = 0, 2, 3, 4, 8
PREARM = 0x10000000
FORCE = 21196


# ---- waking up and arming


def test_it_wakes_up_on_the_measured_timeline(make_field: MakeField) -> None:
    field = make_field(ready_s=REALISTIC_READY_S)
    seen: dict[str, float] = {}
    while field.gcs.world.time_s < 24.0:
        field.wait(0.5)
        if field.gcs.world.time_s < 2.0:
            continue
        for name, true in {
            "manual": field.gcs.last("HEARTBEAT")["custom_mode"] == MANUAL,
            "gps": field.gcs.last("GPS_RAW_INT")["fix_type"] == 6,
            "aligned": field.gcs.last("EKF_STATUS_REPORT")["flags"] == 0xA7,
            "position": field.gcs.last("EKF_STATUS_REPORT")["flags"] == 0x33F,
            "prearm": bool(field.gcs.last("SYS_STATUS")["onboard_control_sensors_health"] & PREARM),
        }.items():
            if true:
                seen.setdefault(name, field.gcs.world.time_s)
    expected = {"manual": 2.0, "gps": 9.4, "aligned": 12.4, "position": 20.4, "prearm": 22.9}
    assert seen == pytest.approx(expected, abs=0.6)


def test_it_is_a_plane_and_boots_initialising(make_field: MakeField) -> None:
    field = make_field(ready_s=REALISTIC_READY_S)
    field.wait(1.0)
    beat = field.gcs.last("HEARTBEAT")
    assert (beat["type"], beat["autopilot"]) == (1, 3)
    assert (beat["base_mode"], beat["custom_mode"], beat["system_status"]) == (17, 16, 2)
    field.wait(1.0)
    beat = field.gcs.last("HEARTBEAT")
    assert (beat["base_mode"], beat["custom_mode"], beat["system_status"]) == (81, MANUAL, 3)
    field.gcs.send("PARAM_REQUEST_LIST")
    field.wait(0.5)
    assert "ArduPlane V4.7.0-dev (zmav-sim)" in field.gcs.texts()


def test_early_arming_is_refused_in_its_own_words(make_field: MakeField) -> None:
    field = make_field(ready_s=REALISTIC_READY_S)
    for until, words in {
        2.5: {
            "Arm: Accels inconsistent",
            "Arm: AHRS: waiting for home",
            "Arm: Airspeed: 1 pre-flight calibration in progres",
        },
        5.0: {"Arm: Accels inconsistent", "Arm: AHRS: waiting for home"},
        11.0: {"Arm: Accels inconsistent"},
        15.0: {"Arm: Gyros inconsistent"},
    }.items():
        field.wait(until - field.gcs.world.time_s)
        field.gcs.clear()
        assert field.gcs.command(ARM, 1) == FAILED
        assert words <= set(field.gcs.texts())
        assert len(words) == sum(text.startswith("Arm: ") for text in field.gcs.texts())
    assert field.gcs.command(ARM, 1, FORCE) == ACCEPTED


def test_arming_and_its_texts(field: Field) -> None:
    field.ready()
    assert field.gcs.command(ARM, 1) == ACCEPTED
    assert field.gcs.texts()[-1] == "Throttle armed"
    assert field.gcs.last("HEARTBEAT")["base_mode"] & 128
    assert field.gcs.command(ARM, 0) == ACCEPTED
    assert field.gcs.texts()[-1] == "Throttle disarmed"
    assert field.mode(RTL) == ACCEPTED
    field.gcs.clear()
    assert field.gcs.command(ARM, 1) == FAILED
    assert field.gcs.texts() == ["Arm: RTL mode not armable"]


def test_in_the_air_it_does_not_disarm_unless_forced(flying: Field) -> None:
    assert flying.gcs.command(ARM, 0) == FAILED
    assert flying.gcs.command(ARM, 0, FORCE) == ACCEPTED
    flying.wait(0.2)
    assert flying.plane.sense.throttle == 0.0


# ---- modes


def test_modes_and_what_it_says_of_those_it_has_not(flying: Field) -> None:
    known = {MANUAL: 209, CIRCLE: 217, FBWA: 209, RTL: 217, LOITER: 217, TAKEOFF: 217, GUIDED: 217}
    for number, flags in known.items():
        assert flying.mode(number) == ACCEPTED
        beat = flying.gcs.all("HEARTBEAT")[-1]
        assert (beat["custom_mode"], beat["base_mode"]) == (number, flags)
    for number, text in {9: "No such mode 9", 17: "Q_ENABLE 0", 25: "Q_ENABLE 0"}.items():
        flying.gcs.clear()
        assert flying.mode(number) == FAILED
        assert flying.gcs.texts() == [text]
    assert flying.plane.mode.number == GUIDED
    flying.gcs.clear()
    assert flying.mode(AUTO) == ACCEPTED
    assert flying.plane.mode.number == RTL
    assert "Mission complete, changing mode to RTL" in flying.gcs.texts()


def test_commands_that_are_modes(flying: Field) -> None:
    assert flying.gcs.command(20) == ACCEPTED
    assert flying.plane.mode.number == RTL
    assert flying.gcs.command(17) == ACCEPTED
    assert flying.plane.mode.number == LOITER
    assert flying.gcs.command(21) == UNSUPPORTED
    assert flying.gcs.command(22, 0, 0, 0, 0, 0, 0, 50) == FAILED


def test_the_mode_switch_is_on_channel_eight(flying: Field) -> None:
    flying.gcs.vehicle.pilot_mode("FBWA")
    flying.wait(0.2)
    assert flying.plane.mode.number == FBWA
    assert flying.gcs.last("RC_CHANNELS")["chan8_raw"] == 1555
    with pytest.raises(BadInput, match="FBWA"):
        flying.gcs.vehicle.pilot_mode("ACRO")
    with pytest.raises(BadInput, match="an ArduPlane"):
        _ = flying.gcs.vehicle.copter


def test_by_hand_surfaces_follow_the_sticks(flying: Field) -> None:
    flying.plane.pilot.sticks(roll=0.5, pitch=-0.4, yaw=0.3, throttle=0.7)
    assert flying.mode(MANUAL) == ACCEPTED
    flying.wait(0.2)
    servos = flying.gcs.last("SERVO_OUTPUT_RAW")
    assert [servos[f"servo{i}_raw"] for i in range(1, 5)] == [1700, 1660, 1700, 1620]


def test_fly_by_wire_a_banks_and_pitches_as_the_sticks_ask(flying: Field) -> None:
    flying.plane.pilot.sticks(throttle=0.5)
    assert flying.mode(FBWA) == ACCEPTED
    flying.plane.pilot.sticks(roll=0.5, pitch=-0.4)
    flying.wait(3.0)
    s = flying.plane.sense
    assert math.degrees(s.roll) == pytest.approx(32.5, abs=2.0)
    assert math.degrees(s.pitch) == pytest.approx(10.0, abs=2.5)
    flying.plane.pilot.sticks(roll=0.0, pitch=0.0)
    flying.wait(3.0)
    assert abs(math.degrees(flying.plane.sense.roll)) < 2.0


def test_circle_banks_by_a_third_and_keeps_its_height(flying: Field) -> None:
    assert flying.mode(CIRCLE) == ACCEPTED
    before = flying.plane.height
    flying.wait(8.0)
    assert math.degrees(flying.plane.sense.roll) == pytest.approx(65.0 / 3.0, abs=1.0)
    assert flying.plane.height == pytest.approx(before, abs=3.0)


# ---- taking off


def test_takeoff_as_measured(make_field: MakeField) -> None:
    field = make_field()
    field.ready()
    assert field.mode(TAKEOFF) == ACCEPTED
    field.wait(2.0)
    assert field.plane.sense.throttle == 0.0
    assert field.gcs.command(ARM, 1) == ACCEPTED
    took = field.gcs.until(lambda: field.plane.height > 45.0)
    assert 6.0 < took < 9.0  # recorded: 45 m within 8 s
    assert field.gcs.last("EXTENDED_SYS_STATE")["landed_state"] in (2, 3)
    field.wait(9.0)
    texts = field.gcs.texts()
    expected = [
        "Throttle armed",
        "Armed AUTO, xaccel = 0.0 m/s/s, waiting 0.2 sec",
        "Triggered AUTO. GPS speed = 0.0",
        "Takeoff to 50m for 200.0m heading 0.0 deg",
    ]
    assert [text for text in texts if text in expected] == expected
    assert any(text.startswith("Takeoff level-off starting at 1") for text in texts)
    assert "Autoland direction= 0" in texts or "Autoland direction= 359" in texts
    # It circles where it was sent, at that height.
    assert field.plane.height == pytest.approx(50.0, abs=4.0)
    assert field.away(north=200.0) < 130.0
    assert field.gcs.last("HEARTBEAT")["system_status"] == 4


def test_guided_on_the_ground_does_not_take_off(field: Field) -> None:
    field.ready()
    assert field.mode(GUIDED) == ACCEPTED
    assert field.gcs.command(ARM, 1) == ACCEPTED
    assert field.reposition(300, 0, 60) == ACCEPTED
    field.wait(5.0)
    assert field.away() == 0.0
    assert field.plane.sense.throttle == 0.0


# ---- GUIDED


def test_a_reposition_is_circled_as_wide_as_measured(flying: Field) -> None:
    assert flying.reposition(200, 150, 70) == FAILED  # not in GUIDED
    assert flying.reposition(200, 150, 70, param2=1.0) == ACCEPTED
    assert flying.plane.mode.number == GUIDED
    flying.gcs.until(lambda: flying.plane.way.circling)
    flying.wait(0.2)
    assert [m["seq"] for m in flying.gcs.all("MISSION_ITEM_REACHED")] == [0]
    flying.wait(15.0)
    radii = flying.track(8.0, lambda: flying.away(200.0, 150.0))
    assert max(radii) < 106.0
    assert min(radii) > 90.0  # recorded: 96 to 97 m
    assert flying.plane.height == pytest.approx(70.0, abs=1.0)
    assert flying.plane.eas == pytest.approx(22.0, abs=0.3)
    told = flying.gcs.last("NAV_CONTROLLER_OUTPUT")
    assert told["nav_roll"] == pytest.approx(38.0, abs=3.0)
    assert told["xtrack_error"] == pytest.approx(11.0, abs=6.0)
    target = flying.gcs.last("POSITION_TARGET_GLOBAL_INT")
    assert (target["lat_int"], target["lon_int"]) == degrees(200, 150)


def test_a_reposition_may_name_its_radius_and_side(flying: Field) -> None:
    assert flying.reposition(100, 0, 60, param2=1.0, param3=150.0, param4=1.0) == ACCEPTED
    flying.gcs.until(lambda: flying.plane.way.turned > 1.5)
    s = flying.plane.sense
    assert (s.north - 100.0) * s.ve - s.east * s.vn < 0.0  # counter-clockwise
    assert flying.away(100.0) == pytest.approx(150.0 * flying.plane.eas2tas**2, abs=25.0)


def test_repositions_that_make_no_sense(flying: Field) -> None:
    assert flying.mode(GUIDED) == ACCEPTED
    assert flying.gcs.command(192, -1, 1, 0, 0, 10, 10, 50) == INT_ONLY
    assert flying.gcs.command_int(192, x=0, y=0, z=50.0) == DENIED
    assert flying.gcs.command_int(192, x=950_000_000, y=0, z=50.0) == DENIED
    assert flying.gcs.command_int(192, x=1, y=1, z=math.nan) == DENIED
    assert flying.gcs.command_int(192, x=1, y=1, z=50.0, frame=77) == DENIED


def test_attitude_targets_are_flown_for_three_seconds(flying: Field) -> None:
    assert flying.mode(GUIDED) == ACCEPTED
    half = math.radians(20.0) / 2.0

    def send() -> None:
        flying.gcs.send("SET_ATTITUDE_TARGET", type_mask=7, q=[math.cos(half), math.sin(half), 0.0, 0.0], thrust=0.7)

    flying.keep(4.0, send)
    assert math.degrees(flying.plane.sense.roll) == pytest.approx(20.0, abs=2.0)
    assert flying.plane.sense.throttle == pytest.approx(0.7, abs=0.01)
    flying.wait(4.0)
    assert math.degrees(flying.plane.sense.roll) > 30.0  # back on its circle
    assert flying.plane.sense.throttle < 0.69
    flying.gcs.send("SET_ATTITUDE_TARGET", type_mask=7, q=[math.nan, 0.0, 0.0, 0.0], thrust=0.7)
    flying.wait(0.5)
    assert flying.plane.sense.throttle < 0.69


def test_change_speed(flying: Field) -> None:
    assert flying.gcs.command(178, 0, 25) == FAILED
    assert flying.mode(GUIDED) == ACCEPTED
    assert flying.gcs.command(178, 0, 25) == ACCEPTED
    assert flying.gcs.texts()[-1] == "Set airspeed 25 m/s"
    flying.wait(8.0)
    assert flying.plane.eas == pytest.approx(25.0, abs=1.0)
    assert flying.gcs.command(178, 0, 99) == FAILED
    assert flying.gcs.command(178, 0, -2) == ACCEPTED
    assert flying.plane.airspeed_wanted == 22.0


# ---- coming back


def test_rtl_circles_home_at_its_altitude(field: Field) -> None:
    field.put_up(RTL, height=96.0)
    field.wait(15.0)
    away = field.track(8.0, field.away)
    assert 85.0 < min(away) <= max(away) < 112.0
    assert field.plane.height == pytest.approx(100.0, abs=2.0)


def test_rtl_goes_to_the_nearest_rally_point(flying: Field) -> None:
    assert upload(flying.gcs, [at(5100, 200, 100, 70, frame=3)], kind=2) == ACCEPTED
    assert flying.mode(RTL) == ACCEPTED
    flying.wait(22.0)
    assert flying.away(200.0, 100.0) < 120.0
    assert flying.plane.height == pytest.approx(70.0, abs=3.0)


def test_autoland_lands_where_it_took_off_and_disarms(field: Field) -> None:
    field.ready()
    assert field.mode(AUTOLAND) == FAILED
    assert "Must already be flying!" in field.gcs.texts()
    for name, value in {"AUTOLAND_WP_DIST": 250, "AUTOLAND_WP_ALT": 35, "LAND_DISARMDELAY": 2}.items():
        field.set(name, value)
    field.put_up(height=40.0)
    assert field.mode(AUTOLAND) == FAILED
    assert "Takeoff initial direction not set" in field.gcs.texts()
    field.plane.takeoff_direction = 0.0
    assert field.mode(AUTOLAND) == ACCEPTED
    field.gcs.until(lambda: field.plane.landing.flaring, 90.0)
    assert field.gcs.last("EXTENDED_SYS_STATE")["landed_state"] == 4
    sinking = field.plane.sense.vd
    assert 1.5 < sinking < 4.0
    field.gcs.until(lambda: not field.plane.armed, 60.0)
    assert field.away() < 60.0
    texts = field.gcs.texts()
    for start in (
        "Loiter to alt complete",
        "Landing approach start at ",
        "Landing glide slope",
        "Flare ",
        "SIM Hit ground at 0.",
    ):
        assert any(text.startswith(start) for text in texts), start
    assert "Auto disarmed" in texts
    assert texts[-1].startswith("Distance from LAND point=")
    assert abs(field.plane.sense.roll) < 0.05
    assert field.gcs.last("HEARTBEAT")["system_status"] == 3
