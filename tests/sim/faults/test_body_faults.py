"""Motors, battery, radio, links, and autopilots that hang or start again: from a ground station."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.sim.conftest import Gcs, MakeGcs
from zmav.errors import BadInput
from zmav.sim import VehicleSpec

GUIDED, LAND, RTL, STABILIZE = 4, 9, 6, 0


class TestMotor:
    def test_a_quadrotor_without_one_comes_down(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "motor", number=2)
        lean = 0.0
        for _ in range(15):
            aloft.world.step(0.1)
            sense = aloft.vehicle.brain.sense
            lean = max(lean, abs(sense.roll), abs(sense.pitch))
        assert lean > 1.0
        aloft.world.step(12.0)
        texts = aloft.texts()
        assert any(text.startswith("SIM Hit ground at ") for text in texts)
        assert any(text.startswith("Crash: Disarming: AngErr=") for text in texts)
        assert aloft.last("HEARTBEAT")["base_mode"] & 128 == 0

    def test_a_weak_one_is_made_up_for(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "motor", number=1, efficiency=0.85)
        aloft.world.step(3.0)
        assert aloft.near(0.0, 0.0, -10.0, within=1.0)
        outputs = aloft.last("SERVO_OUTPUT_RAW")
        assert outputs["servo1_raw"] > outputs["servo2_raw"] + 20
        aloft.world.clear()
        aloft.world.step(3.0)
        outputs = aloft.last("SERVO_OUTPUT_RAW")
        assert abs(outputs["servo1_raw"] - outputs["servo2_raw"]) < 20

    def test_there_is_no_fifth(self, aloft: Gcs) -> None:
        with pytest.raises(BadInput, match="no motor 5; expected 1 to 4") as refused:
            aloft.world.fault("quad1", "motor", number=5)
        assert refused.value.detail["field"] == "number"
        assert aloft.world.faults() == []


class TestBattery:
    def test_a_collapse_trips_the_failsafe(self, make_gcs: MakeGcs) -> None:
        params = {"BATT_FS_LOW_ACT": 2, "BATT_LOW_VOLT": 11.0, "BATT_LOW_TIMER": 2}
        gcs = make_gcs([VehicleSpec(params=params)])
        gcs.take_off(10.0)
        before = gcs.last("SYS_STATUS")["voltage_battery"]
        gcs.world.fault("quad1", "battery", left_percent=2.0)
        gcs.world.step(3.0)
        assert gcs.last("SYS_STATUS")["voltage_battery"] < 11_000 < before
        assert any(text.startswith("Battery 1 is low") for text in gcs.texts())
        assert gcs.last("HEARTBEAT")["custom_mode"] == RTL

    def test_it_is_mended_by_another_pack(self, aloft: Gcs) -> None:
        before = aloft.last("SYS_STATUS")["voltage_battery"]
        aloft.world.fault("quad1", "battery", left_percent=10.0)
        aloft.world.step(1.0)
        assert aloft.last("SYS_STATUS")["voltage_battery"] < before - 500
        aloft.world.clear()
        aloft.world.step(1.0)
        assert aloft.last("SYS_STATUS")["voltage_battery"] == pytest.approx(before, abs=60)


class TestRadio:
    def test_the_failsafe_follows_and_ends(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.take_off(10.0)
        gcs.world.fault("quad1", "rc-loss", for_s=3.0)
        gcs.world.step(2.0)
        assert "Radio Failsafe" in gcs.texts()
        assert gcs.last("HEARTBEAT")["custom_mode"] == RTL
        gcs.world.step(2.0)
        assert "Radio Failsafe Cleared" in gcs.texts()


class TestFrozen:
    def test_it_says_and_hears_nothing_and_holds_its_outputs(self, aloft: Gcs) -> None:
        outputs = aloft.vehicle.node.seat.outputs()
        uptime = aloft.last("SYSTEM_TIME")["time_boot_ms"]
        aloft.world.fault("quad1", "frozen")
        aloft.clear()
        aloft.send("COMMAND_LONG", command=176, param1=1, param2=LAND)
        aloft.goto(50.0, 0.0, -10.0)
        aloft.world.step(3.0)
        assert aloft.frames == []
        assert aloft.vehicle.node.seat.outputs() == outputs
        assert aloft.world.clear("quad1", "frozen") == 1
        aloft.world.step(1.0)
        assert aloft.all("HEARTBEAT")
        assert aloft.last("HEARTBEAT")["custom_mode"] == GUIDED
        assert aloft.last("SYSTEM_TIME")["time_boot_ms"] >= uptime + 3900  # its clock has run on
        assert aloft.vehicle.copter.armed

    def test_a_reboot_ends_it(self, aloft: Gcs) -> None:
        aloft.world.fault("quad1", "frozen")
        aloft.world.step(3.0)
        aloft.world.fault("quad1", "reboot")
        assert aloft.world.faults() == []
        aloft.world.step(1.0)
        assert aloft.last("SYSTEM_TIME")["time_boot_ms"] < 1100
        assert not aloft.vehicle.copter.armed


class TestReboot:
    def test_in_flight_it_falls_and_starts_again(self, aloft: Gcs) -> None:
        aloft.send("COMMAND_LONG", command=511, param1=30.0, param2=1e5)
        aloft.world.step(1.0)
        last = aloft.frames[-1].seq
        assert last > 5
        aloft.clear()
        assert [f.kind for f in aloft.world.fault("quad1", "reboot")] == ["reboot"]
        assert aloft.world.faults() == []
        aloft.world.step(0.1)
        assert [frame.seq for frame in aloft.frames[:3]] == [0, 1, 2]
        assert aloft.last("HEARTBEAT")["base_mode"] & 128 == 0
        assert aloft.last("HEARTBEAT")["custom_mode"] != GUIDED
        assert aloft.vehicle.node.seat.outputs() == [0.0] * 4
        aloft.clear()
        aloft.world.step(2.5)
        assert aloft.all("ATTITUDE") == []  # nobody has asked for it since
        assert any(text.startswith("SIM Hit ground at 1") for text in aloft.texts())
        assert "EKF3 IMU0 is using GPS" in aloft.texts()

    def test_a_px4_likewise(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(autopilot="px4")], ready_s=0.5)
        gcs.world.step(2.0)
        count = len(gcs.frames)
        assert count > 100
        gcs.clear()
        gcs.world.fault(gcs.vehicle.name, "reboot")
        gcs.world.step(0.1)
        assert gcs.frames[0].seq == 0
        assert gcs.vehicle.px4.uptime == pytest.approx(0.1, abs=0.02)


class TestLinks:
    def streaming(self, make_gcs: MakeGcs, **options: Any) -> Gcs:
        gcs = make_gcs(**options)
        gcs.until(lambda: gcs.vehicle.copter.position_ok)
        gcs.send("COMMAND_LONG", command=511, param1=30.0, param2=2e4)
        gcs.world.step(1.0)
        gcs.clear()
        gcs.splitter.counters.lost = gcs.splitter.counters.bad_crc = 0
        return gcs

    def test_loss(self, make_gcs: MakeGcs) -> None:
        gcs = self.streaming(make_gcs)
        gcs.world.fault("quad1", "link-loss", percent=30.0, direction="down")
        gcs.world.step(10.0)
        assert len(gcs.all("ATTITUDE")) == pytest.approx(350, abs=45)
        assert gcs.splitter.counters.lost == pytest.approx(150, abs=50)

    def test_cut_both_ways_and_back(self, make_gcs: MakeGcs) -> None:
        gcs = self.streaming(make_gcs)
        gcs.world.fault("quad1", "link-cut")
        gcs.send("COMMAND_LONG", command=176, param1=1, param2=GUIDED)
        gcs.world.step(2.0)
        assert gcs.frames == []
        assert gcs.vehicle.copter.mode.number == STABILIZE
        gcs.world.clear()
        assert gcs.command(176, 1, GUIDED) == 0

    @pytest.mark.parametrize(("direction", "heard", "obeyed"), [("up", True, False), ("down", False, True)])
    def test_one_direction(self, make_gcs: MakeGcs, direction: str, heard: bool, obeyed: bool) -> None:
        gcs = self.streaming(make_gcs)
        gcs.world.fault("quad1", "link-cut", direction=direction)
        gcs.send("COMMAND_LONG", command=176, param1=1, param2=GUIDED)
        gcs.world.step(1.0)
        assert bool(gcs.all("ATTITUDE")) is heard
        assert (gcs.vehicle.copter.mode.number == GUIDED) is obeyed

    def test_a_link_that_opens_later_suffers_too(self, make_gcs: MakeGcs, another_gcs: type[Gcs]) -> None:
        gcs = self.streaming(make_gcs)
        gcs.world.fault("quad1", "link-cut")
        late = another_gcs(gcs.world, gcs.vehicle)
        gcs.world.step(2.0)
        assert late.frames == []
        gcs.world.clear()
        gcs.world.step(2.0)
        assert late.all("HEARTBEAT")

    def test_a_lost_ground_station_trips_its_failsafe(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={"FS_GCS_ENABLE": 1})])
        gcs.take_off(5.0)
        gcs.send("HEARTBEAT", type=6, autopilot=8)
        gcs.world.fault("quad1", "link-cut", for_s=8.0)
        for _ in range(9):
            gcs.send("HEARTBEAT", type=6, autopilot=8)
            gcs.world.step(1.0)
        assert gcs.vehicle.copter.mode.number == RTL
        gcs.send("HEARTBEAT", type=6, autopilot=8)
        gcs.world.step(1.0)
        assert "GCS Failsafe Cleared" in gcs.texts()


def test_frozen_copter_falls_or_climbs_with_its_last_outputs(aloft: Gcs) -> None:
    """Full throttle at the wrong moment stays full throttle."""
    aloft.fly(0.0, 0.0, -2.0)
    aloft.world.step(0.5)
    outputs = aloft.vehicle.node.seat.outputs()
    aloft.world.fault("quad1", "frozen", for_s=2.0)
    aloft.world.step(1.0)
    assert aloft.vehicle.node.seat.outputs() == outputs
    assert math.isfinite(aloft.vehicle.brain.sense.down)
    aloft.world.step(1.5)
    assert aloft.vehicle.node.seat.outputs() != outputs
