"""ArduCopter's rules: waking up, arming, modes, taking off, landing, failsafes and the pilot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.errors import BadInput
from zmav.sim import REALISTIC_READY_S, VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 2, 3, 4, 5, 6, 9, 17
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
PREARM = 0x10000000
ARM, TAKEOFF, SET_MODE = 400, 22, 176
FORCE = 21196


def test_it_wakes_up_on_the_measured_timeline(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(ready_s=REALISTIC_READY_S)
    seen: dict[str, float] = {}

    def note(name: str, true: bool) -> None:
        if true:
            seen.setdefault(name, gcs.world.time_s)

    while gcs.world.time_s < 43.0:
        gcs.world.step(0.5)
        flags = gcs.last("EKF_STATUS_REPORT")["flags"]
        note("attitude", flags == 0xA7)
        note("position", flags == 0x33F)
        note("prearm", bool(gcs.last("SYS_STATUS")["onboard_control_sensors_health"] & PREARM))
        note("gps", gcs.last("GPS_RAW_INT")["fix_type"] == 6)
        note("standby", gcs.last("HEARTBEAT")["system_status"] == 3)
    expected = {"standby": 2.2, "attitude": 5.6, "gps": 9.6, "prearm": 23.0, "position": 41.4}
    assert seen == pytest.approx(expected, abs=0.6)
    assert [t for t in gcs.texts() if "origin set" in t] == ["EKF3 IMU0 origin set", "EKF3 IMU1 origin set"]
    assert len(gcs.all("GPS_GLOBAL_ORIGIN")) == len(gcs.all("HOME_POSITION")) == 1


def test_arming_is_refused_with_reasons_until_there_is_a_position(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(ready_s=REALISTIC_READY_S)
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    reasons = {}
    for at in (1.5, 3.0, 10.0, 22.0, 40.0):
        gcs.world.step(max(at - gcs.world.time_s, 0.01))
        gcs.clear("STATUSTEXT")
        assert gcs.command(ARM, 1) == FAILED
        reasons[at] = gcs.texts()[-1]
    assert reasons == {
        1.5: "Arm: System not initialised",
        3.0: "Arm: AHRS: EKF3 not healthy",
        10.0: "Arm: AHRS: waiting for home",
        22.0: "Arm: Need Position Estimate",
        40.0: "Arm: Need Position Estimate",
    }
    assert gcs.command(ARM, 1, FORCE) == FAILED  # the position is mandatory
    gcs.until(lambda: gcs.world.time_s >= 41.5)
    assert gcs.command(ARM, 1) == ACCEPTED
    assert "Arming motors" in gcs.texts()
    assert gcs.last("HEARTBEAT")["base_mode"] == 217


def test_the_prearm_bit_rises_before_guided_can_be_armed(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(ready_s=REALISTIC_READY_S)
    gcs.world.step(30.0)
    assert gcs.last("SYS_STATUS")["onboard_control_sensors_health"] & PREARM
    assert not gcs.last("EKF_STATUS_REPORT")["flags"] & 16
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert gcs.command(ARM, 1) == FAILED


@pytest.mark.parametrize(("mode", "name"), [(LAND, "LAND"), (RTL, "RTL"), (BRAKE, "BRAKE")])
def test_some_modes_cannot_be_armed_in(gcs: Gcs, mode: int, name: str) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, mode) == ACCEPTED
    assert gcs.command(ARM, 1) == FAILED
    assert gcs.texts()[-1] == f"Arm: {name} mode not armable"


@pytest.mark.parametrize("mode", [STABILIZE, ALT_HOLD, LOITER, GUIDED])
def test_the_others_can(gcs: Gcs, mode: int) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, mode) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED  # again: nothing to do
    assert gcs.command(ARM, 0) == ACCEPTED
    assert gcs.texts()[-2:] == ["Arming motors", "Disarming motors"]


def test_arming_with_the_throttle_up_is_for_guided_only(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    gcs.vehicle.copter.pilot.sticks(throttle=0.7)
    for mode in (STABILIZE, LOITER):
        assert gcs.command(SET_MODE, 1, mode) == ACCEPTED
        assert gcs.command(ARM, 1) == FAILED
        assert gcs.texts()[-1] == "Arm: Throttle too high"
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED


def test_modes_change_by_command_and_by_message_and_the_heartbeat_says_so_at_once(gcs: Gcs) -> None:
    gcs.world.step(1.05)
    gcs.clear()
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert [(m["custom_mode"], m["base_mode"]) for m in gcs.all("HEARTBEAT")] == [(GUIDED, 89)]
    gcs.send("SET_MODE", base_mode=1, custom_mode=ALT_HOLD)
    assert [(m["custom_mode"], m["base_mode"]) for m in gcs.all("HEARTBEAT")][1:] == [(ALT_HOLD, 81)]
    gcs.send("SET_MODE", base_mode=0, custom_mode=LOITER)  # without the custom flag it means nothing
    assert gcs.vehicle.copter.mode.number == ALT_HOLD


def test_a_mode_that_does_not_exist_is_refused(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, 99) == FAILED
    assert gcs.texts()[-1] == "No such mode 99"
    assert gcs.command(SET_MODE, 0, GUIDED) == DENIED
    assert gcs.vehicle.copter.mode.number == STABILIZE


def test_an_armed_vehicle_without_a_mission_refuses_auto(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED
    assert gcs.command(SET_MODE, 1, AUTO) == FAILED
    assert gcs.texts()[-1] == "Mode change to AUTO failed: init failed"
    assert gcs.vehicle.copter.mode.number == GUIDED


def test_an_armed_vehicle_without_a_position_refuses_modes_that_need_one(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(ready_s=REALISTIC_READY_S)
    gcs.world.step(30.0)
    assert gcs.command(ARM, 1) == ACCEPTED  # STABILIZE needs none
    assert gcs.command(SET_MODE, 1, LOITER) == FAILED
    assert gcs.texts()[-1] == "Mode change to LOITER failed: requires position"
    assert gcs.command(SET_MODE, 1, LAND) == ACCEPTED


@pytest.mark.parametrize(
    ("mode", "armed", "height"),
    [(GUIDED, False, 10.0), (LOITER, True, 10.0), (GUIDED, True, 0.0), (GUIDED, True, -5.0)],
)
def test_takeoff_is_for_an_armed_vehicle_in_guided_and_upward(gcs: Gcs, mode: int, armed: bool, height: float) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, mode) == ACCEPTED
    assert not armed or gcs.command(ARM, 1) == ACCEPTED
    assert gcs.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height) == FAILED
    gcs.world.step(4.0)
    assert gcs.ned == (0.0, 0.0, 0.0)


def test_takeoff_rises_to_the_height_over_home_and_stays(gcs: Gcs) -> None:
    gcs.take_off(10.0)
    assert gcs.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 20.0) == FAILED  # it flies already
    gcs.world.step(3.0)
    assert gcs.near(0.0, 0.0, -10.0, 0.1)
    assert gcs.last("HEARTBEAT")["system_status"] == 4
    assert gcs.last("GLOBAL_POSITION_INT")["relative_alt"] == pytest.approx(10_000, abs=100)


def test_it_does_not_disarm_in_the_air_unless_forced(gcs: Gcs) -> None:
    gcs.put_up(3.0)
    assert gcs.command(ARM, 0) == FAILED
    assert gcs.vehicle.copter.armed
    assert gcs.command(ARM, 0, FORCE) == ACCEPTED
    gcs.until(lambda: bool(gcs.vehicle.copter.sense.contact), 3.0)
    assert gcs.ned[2] == pytest.approx(0.0, abs=0.1)


def test_landing_takes_the_measured_time_and_disarms(gcs: Gcs) -> None:
    gcs.take_off(10.0)
    assert gcs.command(21) == ACCEPTED
    assert gcs.vehicle.copter.mode.number == LAND
    took = gcs.until(lambda: not gcs.vehicle.copter.armed)
    assert 20.0 <= took <= 25.0
    assert gcs.texts()[-1] == "Disarming motors"
    assert any(text.startswith("SIM Hit ground at 0.5") for text in gcs.texts())
    assert gcs.near(0.0, 0.0, 0.0, 0.05)
    heartbeat = gcs.last("HEARTBEAT")
    assert (heartbeat["base_mode"], heartbeat["custom_mode"], heartbeat["system_status"]) == (89, LAND, 3)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_it_lands_and_disarms_in_gusts(make_gcs: MakeGcs, seed: int) -> None:
    """What has touched the ground does not lean against the wind, which would keep it from taking itself for landed."""
    gcs = make_gcs(wind=(0.0, 5.0, 0.0), gusts="light", noise="typical", seed=seed)
    gcs.take_off(3.0)
    assert gcs.command(21) == ACCEPTED
    assert gcs.until(lambda: not gcs.vehicle.copter.armed) < 20.0


def test_an_armed_vehicle_on_the_ground_disarms_itself(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED
    took = gcs.until(lambda: not gcs.vehicle.copter.armed)
    assert took == pytest.approx(10.0, abs=0.5)  # DISARM_DELAY


def test_return_to_launch_climbs_comes_back_lands_and_disarms(make_gcs: MakeGcs) -> None:
    gcs = make_gcs([VehicleSpec(params={"RTL_ALT": 600, "RTL_LOIT_TIME": 1000})])
    gcs.put_up(3.0)
    gcs.goto(8.0, 3.0, -3.0)
    gcs.until(lambda: gcs.near(8.0, 3.0, -3.0))
    assert gcs.command(20) == ACCEPTED
    highest = 0.0

    def home() -> bool:
        nonlocal highest
        highest = min(highest, gcs.ned[2])
        return not gcs.vehicle.copter.armed

    gcs.until(home)
    assert highest == pytest.approx(-6.0, abs=0.4)
    assert gcs.near(0.0, 0.0, 0.0, 0.3)


def test_brake_and_loiter_stop(gcs: Gcs) -> None:
    gcs.put_up(5.0)
    gcs.fly(5.0, 0.0)
    gcs.world.step(2.5)
    assert gcs.vehicle.copter.sense.vn > 3.0
    assert gcs.command(SET_MODE, 1, BRAKE) == ACCEPTED
    gcs.world.step(5.0)
    there = gcs.ned
    gcs.vehicle.copter.pilot.sticks(throttle=0.5)
    assert gcs.command(17) == ACCEPTED
    assert gcs.vehicle.copter.mode.number == LOITER
    gcs.world.step(3.0)
    assert gcs.near(*there, within=0.2)


def test_the_pilots_switch_takes_over_and_the_sticks_fly(gcs: Gcs) -> None:
    gcs.put_up(5.0)
    gcs.vehicle.pilot_mode("LOITER")
    gcs.world.step(0.1)
    assert gcs.vehicle.copter.mode.number == LOITER
    gcs.goto(50.0, 0.0, -5.0)  # not listened to
    gcs.vehicle.copter.pilot.sticks(pitch=0.4, roll=0.0)
    gcs.world.step(4.0)
    assert gcs.vehicle.copter.sense.vn == pytest.approx(0.4 * 12.5, abs=0.5)  # LOIT_SPEED
    gcs.vehicle.copter.pilot.sticks(pitch=0.0, throttle=0.75)
    gcs.world.step(3.0)
    assert gcs.vehicle.copter.sense.vd == pytest.approx(-1.25, abs=0.2)  # half of PILOT_SPEED_UP
    assert gcs.last("RC_CHANNELS")["chan3_raw"] == 1750


def test_loiter_with_the_throttle_stick_down_descends_as_the_real_one_does(gcs: Gcs) -> None:
    gcs.put_up(5.0)
    assert gcs.command(SET_MODE, 1, LOITER) == ACCEPTED
    gcs.world.step(2.0)
    assert gcs.vehicle.copter.sense.vd > 0.5


def test_a_mode_that_is_not_on_the_switch_is_named(gcs: Gcs) -> None:
    with pytest.raises(BadInput, match="LAND, RTL, AUTO, LOITER, STABILIZE"):
        gcs.vehicle.pilot_mode("BRAKE")


def test_stabilize_is_flown_by_stick_alone(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(ARM, 1) == ACCEPTED
    pilot = gcs.vehicle.copter.pilot
    pilot.sticks(throttle=0.6)
    gcs.world.step(2.0)
    assert gcs.ned[2] < -0.5
    pilot.sticks(throttle=0.5, roll=0.5)
    gcs.world.step(1.0)
    assert math.degrees(gcs.vehicle.copter.sense.roll) == pytest.approx(15.0, abs=2.0)


def test_alt_hold_lifts_off_by_stick_and_holds_its_height(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(SET_MODE, 1, ALT_HOLD) == ACCEPTED
    assert gcs.command(ARM, 1) == ACCEPTED
    pilot = gcs.vehicle.copter.pilot
    gcs.world.step(1.0)
    assert gcs.ned[2] == 0.0
    pilot.sticks(throttle=0.8)
    gcs.world.step(4.0)
    pilot.sticks(throttle=0.5)
    gcs.world.step(4.0)
    height = gcs.ned[2]
    assert height < -2.0
    gcs.world.step(3.0)
    assert gcs.ned[2] == pytest.approx(height, abs=0.2)


class TestGcsFailsafe:
    def airborne(self, make_gcs: MakeGcs, **params: float) -> Gcs:
        gcs = make_gcs([VehicleSpec(params=params)])
        gcs.put_up(3.0)
        gcs.send("HEARTBEAT", type=6)
        return gcs

    def test_is_off_by_default(self, make_gcs: MakeGcs) -> None:
        gcs = self.airborne(make_gcs)
        gcs.world.step(7.0)
        assert gcs.vehicle.copter.mode.number == GUIDED

    def test_lands_when_told_to_and_says_so(self, make_gcs: MakeGcs) -> None:
        gcs = self.airborne(make_gcs, FS_GCS_ENABLE=5)
        gcs.world.step(4.8)
        assert gcs.vehicle.copter.mode.number == GUIDED
        gcs.world.step(0.4)  # FS_GCS_TIMEOUT is 5 s
        assert gcs.vehicle.copter.mode.number == LAND
        assert "GCS Failsafe" in gcs.texts()
        assert gcs.last("HEARTBEAT")["system_status"] == 5
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(0.4)  # it looks three times a second
        assert "GCS Failsafe Cleared" in gcs.texts()
        assert gcs.last("HEARTBEAT")["system_status"] == 4


def test_a_reboot_starts_over(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(246, 1) == ACCEPTED
    gcs.clear("STATUSTEXT")
    gcs.world.step(0.3)
    assert not gcs.vehicle.copter.position_ok
    assert gcs.last("SYSTEM_TIME")["time_boot_ms"] < 200
    gcs.world.step(1.0)
    assert "ArduPilot Ready" in gcs.texts()
    assert gcs.vehicle.copter.position_ok


def test_an_armed_vehicle_does_not_reboot(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(ARM, 1) == ACCEPTED
    assert gcs.command(246, 1) == FAILED


def test_termination_stops_the_motors_in_flight(gcs: Gcs) -> None:
    gcs.put_up(3.0)
    assert gcs.command(185, 0) == FAILED
    assert gcs.command(185, 1) == ACCEPTED
    assert not gcs.vehicle.copter.armed
