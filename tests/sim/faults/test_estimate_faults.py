"""Sensors that fail or lie, as a ground station sees it: what ArduPilot's and PX4's filters make of them, and the
failsafes that follow. Times and words are those of a real ArduCopter with the same failures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from tests.sim.conftest import Gcs, MakeGcs
from zmav.sim import VehicleSpec

GUIDED, LOITER, LAND, RTL = 4, 5, 9, 6
GOOD, NOT_AIDED, CONST_POS, GLITCH = 0x33F, 0x25, 0xA7, 0x8000


def ekf(gcs: Gcs) -> dict[str, Any]:
    return gcs.last("EKF_STATUS_REPORT")


def off(gcs: Gcs) -> tuple[float, float, float]:
    """How far the estimate is from the truth, m."""
    s = gcs.vehicle.brain.sense
    return s.north - s.true_north, s.east - s.true_east, s.down - s.true_down


def watch(gcs: Gcs, seconds: float, look: Callable[[], Any]) -> list[Any]:
    """What ``look`` gives every tenth of a second."""
    seen = []
    for _ in range(round(seconds * 10)):
        gcs.world.step(0.1)
        seen.append(look())
    return seen


class TestGpsLoss:
    def test_a_short_one_is_flown_through(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "gps-loss", for_s=5.0)
        aloft.world.step(4.0)
        raw = aloft.last("GPS_RAW_INT")
        assert (raw["fix_type"], raw["satellites_visible"]) == (1, 3)
        assert ekf(aloft)["flags"] == GOOD
        aloft.world.step(8.0)
        assert aloft.last("GPS_RAW_INT")["fix_type"] == 6
        assert aloft.last("HEARTBEAT")["custom_mode"] == GUIDED
        assert aloft.texts() == []
        assert max(map(abs, off(aloft))) < 0.05

    def test_a_long_one_ends_in_a_landing(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "gps-loss")
        aloft.world.step(6.9)
        assert ekf(aloft)["flags"] == GOOD
        aloft.world.step(0.4)
        assert ekf(aloft)["flags"] == NOT_AIDED
        aloft.world.step(1.2)
        assert aloft.texts() == ["EKF variance", "EKF Failsafe: changed to LAND Mode"]
        assert aloft.last("HEARTBEAT")["system_status"] == 5
        assert abs(off(aloft)[0]) + abs(off(aloft)[1]) > 0.2  # dead reckoning drifts
        aloft.clear()
        aloft.world.step(7.0)
        assert aloft.texts() == ["EKF3 IMU0 stopped aiding", "EKF3 IMU1 stopped aiding"]
        assert ekf(aloft)["flags"] == CONST_POS
        aloft.clear()
        assert aloft.command(176, 1, LOITER) != 0

        assert aloft.world.clear("quad1") == 1
        aloft.world.step(2.0)
        assert [t for t in aloft.texts() if "EKF" in t] == [
            "EKF3 IMU0 is using GPS",
            "EKF3 IMU1 is using GPS",
            "EKF Failsafe Cleared",
        ]
        assert ekf(aloft)["flags"] == GOOD
        assert aloft.command(176, 1, LOITER) == 0
        assert max(map(abs, off(aloft))) < 0.05


class TestGpsGlitch:
    def test_one_within_the_gate_is_followed(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "gps-glitch", north=3.0)
        largest = max(watch(aloft, 1.0, lambda: ekf(aloft)["pos_horiz_variance"]))
        assert 0.4 < largest < 1.0
        aloft.world.step(8.0)
        assert off(aloft)[0] == pytest.approx(3.0, abs=0.05)
        assert aloft.vehicle.brain.sense.true_north == pytest.approx(-3.0, abs=0.15)  # it has flown there
        assert aloft.texts() == []

    def test_one_beyond_is_rejected_and_forgotten_when_it_ends(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "gps-glitch", north=55.0, for_s=8.0)
        aloft.world.step(0.5)
        assert ekf(aloft)["pos_horiz_variance"] == pytest.approx(14.7, abs=0.4)
        aloft.world.step(1.0)
        assert ekf(aloft)["flags"] == GOOD | GLITCH
        words = ["EKF3 lane switch 1", "EKF primary changed:1", "GPS Glitch or Compass error"]
        assert aloft.texts() == words
        raw, believed = aloft.last("GPS_RAW_INT"), aloft.last("GLOBAL_POSITION_INT")
        assert (raw["lat"] - believed["lat"]) * 1e-7 * 111_318.8 == pytest.approx(55.0, abs=0.5)
        aloft.world.step(7.0)
        assert aloft.vehicle.brain.sense.true_north == pytest.approx(0.0, abs=0.1)
        assert ekf(aloft)["flags"] == GOOD | GLITCH  # it is not trusted again at once
        aloft.world.step(10.0)
        assert ekf(aloft)["flags"] == GOOD
        assert aloft.texts() == [*words, "Glitch cleared"]

    def test_one_that_lasts_makes_the_position_jump(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "gps-glitch", east=-40.0)
        aloft.world.step(9.5)
        assert off(aloft)[1] == pytest.approx(0.0, abs=0.05)
        places = watch(aloft, 2.0, lambda: (aloft.ned[1], aloft.vehicle.brain.sense.true_east))
        believed = [place for place, _ in places]
        assert min(believed) == pytest.approx(-40.0, abs=0.3)
        assert all(abs(true) < 0.3 for _, true in places)  # the controllers follow the jump; nobody darts off
        aloft.world.step(12.0)
        assert "Glitch cleared" in aloft.texts()
        assert ekf(aloft)["pos_horiz_variance"] < 0.05
        assert aloft.last("HEARTBEAT")["custom_mode"] == GUIDED


class TestCompass:
    def test_a_small_error_pulls_the_heading(self, aloft: Gcs) -> None:
        before = aloft.last("RAW_IMU")
        aloft.world.fault("quad1", "compass", degrees=20.0)
        after = aloft.last("RAW_IMU")
        assert (after["xmag"], after["ymag"]) != (before["xmag"], before["ymag"])
        largest = max(watch(aloft, 1.0, lambda: ekf(aloft)["compass_variance"]))
        assert 0.25 < largest < 0.8
        aloft.world.step(14.0)
        true_yaw = _true_yaw(aloft)
        assert abs(aloft.vehicle.brain.sense.yaw) < 0.03  # it believes to point north
        assert true_yaw == pytest.approx(-0.349, abs=0.04)
        aloft.world.clear("quad1")
        aloft.world.step(18.0)
        assert _true_yaw(aloft) == pytest.approx(0.0, abs=0.03)
        assert ekf(aloft)["flags"] == GOOD

    def test_a_large_one_is_rejected_and_said_in_the_end(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "compass", degrees=120.0)
        aloft.world.step(9.0)
        assert ekf(aloft)["compass_variance"] > 1.0
        assert aloft.texts() == []
        aloft.world.step(2.0)
        assert aloft.texts()[0] == "EKF3 IMU0 switching to compass 1"
        assert _true_yaw(aloft) == pytest.approx(0.0, abs=0.02)
        assert aloft.last("HEARTBEAT")["custom_mode"] == GUIDED  # one doubt alone is no failsafe

    def test_flying_with_a_wrong_heading_goes_in_curves(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "compass", degrees=45.0)
        aloft.world.step(15.0)
        aloft.goto(30.0, 0.0, -10.0)
        seen = watch(aloft, 8.0, lambda: (aloft.ned[1], ekf(aloft)["velocity_variance"]))
        assert max(abs(aside) for aside, _ in seen) > 1.0
        assert max(ratio for _, ratio in seen) > 0.1

    def test_without_a_compass_it_does_not_arm(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.until(lambda: gcs.vehicle.copter.position_ok)
        gcs.world.fault("quad1", "compass", lost=True)
        gcs.world.step(1.0)
        assert gcs.command(400, 1) != 0
        assert gcs.texts()[-1] == "Arm: Compass not healthy"
        assert gcs.last("RAW_IMU")["xmag"] == gcs.last("RAW_IMU")["zmag"] == 0
        gcs.world.clear()
        gcs.world.step(1.0)
        assert gcs.command(400, 1) == 0

    def test_nor_with_one_that_lies_until_it_is_believed(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.until(lambda: gcs.vehicle.copter.position_ok)
        gcs.world.fault("quad1", "compass", degrees=40.0)
        gcs.world.step(0.5)
        assert gcs.command(400, 1) != 0
        assert gcs.texts()[-1].startswith("Arm: Check mag field (xy diff:1")
        gcs.world.step(12.0)
        assert gcs.command(400, 1) == 0

    def test_nor_in_guided_while_the_gps_glitches(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.until(lambda: gcs.vehicle.copter.position_ok)
        assert gcs.command(176, 1, GUIDED) == 0
        gcs.world.fault("quad1", "gps-glitch", north=100.0)
        gcs.world.step(3.0)
        assert gcs.command(400, 1) != 0
        assert gcs.texts()[-1] == "Arm: GPS glitching"


def _true_yaw(gcs: Gcs) -> float:
    w, x, y, z = gcs.vehicle.node.seat.fleet.dynamics.q[:, gcs.vehicle.node.seat.index].tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class TestOthers:
    def test_a_barometer_takes_the_vehicle_with_it(self, aloft: Gcs) -> None:
        pressure = aloft.last("SCALED_PRESSURE")["press_abs"]
        aloft.world.fault("quad1", "baro", metres=5.0)
        assert aloft.last("SCALED_PRESSURE")["press_abs"] == pytest.approx(pressure - 0.56, abs=0.05)
        assert max(watch(aloft, 1.0, lambda: ekf(aloft)["pos_vert_variance"])) > 0.2
        aloft.world.step(10.0)
        assert aloft.vehicle.brain.sense.true_down == pytest.approx(-5.0, abs=0.2)
        assert aloft.ned[2] == pytest.approx(-10.0, abs=0.2)

    def test_without_a_barometer_the_height_is_not_vouched_for(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "baro", lost=True)
        aloft.world.step(9.5)
        assert ekf(aloft)["flags"] == GOOD
        aloft.world.step(1.0)
        assert ekf(aloft)["flags"] == GOOD & ~0x20

    def test_vibration_and_clipping_show(self, aloft: Gcs) -> None:
        calm = aloft.last("VIBRATION")
        aloft.world.fault("quad1", "imu", vibration=40.0, clipping=50.0)
        aloft.world.step(2.0)
        shaken = aloft.last("VIBRATION")
        assert shaken["vibration_z"] - calm["vibration_z"] == pytest.approx(40.0)
        assert shaken["clipping_0"] == pytest.approx(100, abs=2)
        assert calm["clipping_0"] == 0
        spread = watch(aloft, 2.0, lambda: aloft.last("RAW_IMU")["zacc"])
        assert max(spread) - min(spread) > 3000

    def test_a_rangefinder_that_sees_nothing(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={"RNGFND1_TYPE": 100})])
        gcs.take_off(5.0)
        gcs.world.step(4.0)
        height = -gcs.vehicle.brain.sense.true_down
        assert gcs.last("DISTANCE_SENSOR")["current_distance"] == pytest.approx(100 * (height + 0.12), abs=2)
        gcs.world.fault("quad1", "rangefinder", metres=2.0)
        assert gcs.last("RANGEFINDER")["distance"] == pytest.approx(height + 2.12, abs=0.02)
        gcs.world.fault("quad1", "rangefinder")
        assert gcs.last("RANGEFINDER")["distance"] == 0.0


def test_a_neighbour_notices_nothing(make_gcs: MakeGcs, another_gcs: type[Gcs]) -> None:
    gcs = make_gcs(2)
    second = another_gcs(gcs.world, gcs.world.vehicles[1])
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    gcs.world.fault("quad1", "gps-glitch", north=500.0)
    gcs.world.fault("quad1", "compass", degrees=30.0)
    gcs.world.step(12.0)
    assert off(second) == (0.0, 0.0, 0.0)
    assert second.last("EKF_STATUS_REPORT")["flags"] == GOOD
    assert abs(off(gcs)[0] - 500.0) < 1.0


def test_two_runs_of_one_seed_are_the_same(make_gcs: MakeGcs) -> None:
    def run() -> list[bytes]:
        gcs = make_gcs(noise="typical", seed=4)
        gcs.take_off(2.5)
        gcs.world.fault("quad1", "gps-loss", for_s=4.0)
        gcs.world.fault("quad1", "link-loss", percent=30.0)
        gcs.clear()
        gcs.send("COMMAND_LONG", command=511, param1=30.0, param2=1e5)
        gcs.world.step(6.0)
        return [frame.data for frame in gcs.frames]

    first = run()
    assert len(first) > 20
    assert first == run()
