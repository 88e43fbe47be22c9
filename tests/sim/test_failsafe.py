"""Failsafes of the simulated ArduCopter: ground station, battery, position, and the fence. The radio's: test_rc.

Words and times are ArduCopter SITL's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from tests.sim.plans import at, upload
from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

GUIDED, AUTO, LOITER, RTL, LAND, ALT_HOLD, BRAKE, STABILIZE = 4, 3, 5, 6, 9, 2, 17, 0
ACCEPTED, DENIED, FAILED = 0, 2, 4
FENCE = 1

AnotherGcs = Callable[..., "Gcs"]
IMPATIENT = {"FS_GCS_TIMEOUT": 2.0}


def mode(gcs: Gcs) -> int:
    return gcs.vehicle.copter.mode.number


def setp(gcs: Gcs, name: str, value: float) -> None:
    gcs.send("PARAM_SET", param_id=name, param_value=value, param_type=9)


def aloft(make_gcs: MakeGcs, height: float = 4.0, **params: float) -> Gcs:
    gcs = make_gcs([VehicleSpec(params=params)])
    gcs.put_up(height)
    return gcs


class TestGroundStation:
    def silent(self, make_gcs: MakeGcs, **params: float) -> Gcs:
        """In the air, and nothing heard of the ground station for longer than FS_GCS_TIMEOUT."""
        gcs = aloft(make_gcs, **IMPATIENT, **params)
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(2.6)
        return gcs

    @pytest.mark.parametrize(
        ("action", "expected"), [(0, GUIDED), (1, RTL), (2, RTL), (3, RTL), (4, LAND), (5, LAND), (7, BRAKE), (9, RTL)]
    )
    def test_does_what_fs_gcs_enable_says(self, make_gcs: MakeGcs, action: int, expected: int) -> None:
        gcs = self.silent(make_gcs, FS_GCS_ENABLE=action)
        assert mode(gcs) == expected
        assert ("GCS Failsafe" in gcs.texts()) is (action != 0)

    def test_landing_gives_the_pilot_four_seconds(self, make_gcs: MakeGcs) -> None:
        gcs = self.silent(make_gcs, FS_GCS_ENABLE=5)
        gcs.world.step(2.5)
        assert abs(gcs.ned[2] + 4.0) < 0.3
        gcs.world.step(4.0)
        assert gcs.ned[2] > -3.5

    def test_a_companion_with_the_vehicles_own_system_id_does_not_count(
        self, make_gcs: MakeGcs, another_gcs: AnotherGcs
    ) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=5)
        companion = another_gcs(gcs.world, gcs.vehicle, sysid=1, compid=191)
        gcs.send("HEARTBEAT", type=6)
        for _ in range(7):
            companion.send("HEARTBEAT", type=18)
            gcs.world.step(0.4)
        assert mode(gcs) == LAND

    def test_any_component_of_the_ground_stations_system_counts(
        self, make_gcs: MakeGcs, another_gcs: AnotherGcs
    ) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=5, MAV_GCS_SYSID=7)
        station = another_gcs(gcs.world, gcs.vehicle, sysid=7, compid=42)
        for _ in range(7):
            station.send("HEARTBEAT", type=6)
            gcs.world.step(0.4)
        assert mode(gcs) == GUIDED
        gcs.world.step(2.6)
        assert mode(gcs) == LAND

    def test_sticks_count_as_a_heartbeat(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=5)
        gcs.send("HEARTBEAT", type=6)
        for _ in range(7):
            gcs.send("MANUAL_CONTROL", target=1, z=500)
            gcs.world.step(0.4)
        assert mode(gcs) == GUIDED

    def test_disarmed_it_is_said_and_keeps_it_from_arming(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1})])
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(3.0)
        assert "GCS Failsafe" in gcs.texts()
        assert gcs.last("HEARTBEAT")["system_status"] == 5
        assert gcs.command(176, 1, GUIDED) == ACCEPTED
        assert gcs.command(400, 1) == FAILED
        assert gcs.texts()[-1] == "Arm: GCS failsafe on"
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(0.4)
        assert gcs.command(400, 1) == ACCEPTED

    def test_armed_on_the_ground_it_disarms(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1})])
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(1.0)
        assert gcs.command(400, 1) == ACCEPTED
        gcs.world.step(2.0)
        assert not gcs.vehicle.copter.armed
        assert "GCS Failsafe - Disarming" in gcs.texts()

    def test_a_pilot_may_go_on(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=1)  # FS_OPTIONS is 16
        gcs.vehicle.pilot_mode("LOITER")
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(2.6)
        assert mode(gcs) == LOITER
        assert "GCS Failsafe - Continuing Pilot Control" in gcs.texts()

    @pytest.mark.parametrize(("options", "expected"), [(16, RTL), (2, AUTO)])
    def test_a_mission_may_go_on(self, make_gcs: MakeGcs, options: int, expected: int) -> None:
        gcs = make_gcs([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1, "FS_OPTIONS": options})])
        gcs.until(lambda: gcs.vehicle.copter.position_ok)
        assert upload(gcs, [at(17, 0, 0, 4)]) == ACCEPTED
        gcs.put_up(4.0)
        assert gcs.command(176, 1, AUTO) == ACCEPTED
        gcs.send("HEARTBEAT", type=6)
        gcs.world.step(2.6)
        assert mode(gcs) == expected

    @pytest.mark.parametrize(("options", "expected"), [(0, RTL), (8, LAND)])
    def test_a_landing_may_go_on(self, make_gcs: MakeGcs, options: int, expected: int) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=1, FS_OPTIONS=options)
        gcs.send("HEARTBEAT", type=6)
        assert gcs.command(21) == ACCEPTED
        gcs.world.step(2.6)
        assert mode(gcs) == expected

    def test_it_takes_overrides_away(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, **IMPATIENT, FS_GCS_ENABLE=5, RC_OVERRIDE_TIME=-1)
        others = {f"chan{i}_raw": 65535 for i in range(2, 19)}
        gcs.send("RC_CHANNELS_OVERRIDE", chan1_raw=1600, **others)
        gcs.world.step(2.6)
        assert gcs.last("RC_CHANNELS")["chan1_raw"] == 1500


class TestBattery:
    @staticmethod
    def left(gcs: Gcs) -> float:
        """mAh: a limit that is reached at once."""
        copter = gcs.vehicle.copter
        return copter.params["BATT_CAPACITY"] - copter.consumed_mah

    def test_low_voltage_for_ten_seconds(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, BATT_FS_LOW_ACT=2)
        setp(gcs, "SIM_BATT_VOLTAGE", 10.2)
        assert gcs.last("SYS_STATUS")["voltage_battery"] == 10200
        gcs.world.step(9.8)
        assert mode(gcs) == GUIDED
        gcs.world.step(0.5)  # BATT_LOW_TIMER
        assert mode(gcs) == RTL
        warning, failsafe = gcs.texts()[-2:]
        assert warning.startswith("Battery 1 is low 10.20V used ")
        assert failsafe == "Battery Failsafe"
        assert gcs.last("HEARTBEAT")["system_status"] == 5

    def test_a_dip_is_nothing(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, BATT_FS_LOW_ACT=2)
        for _ in range(2):
            setp(gcs, "SIM_BATT_VOLTAGE", 10.2)
            gcs.world.step(6.0)
            setp(gcs, "SIM_BATT_VOLTAGE", 12.6)
            gcs.world.step(0.2)
        assert mode(gcs) == GUIDED

    def test_capacity_at_once_and_critical_after_low(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, BATT_FS_LOW_ACT=2, BATT_FS_CRT_ACT=1)
        setp(gcs, "BATT_LOW_MAH", self.left(gcs))
        gcs.world.step(0.3)
        assert mode(gcs) == RTL
        setp(gcs, "BATT_CRT_MAH", self.left(gcs))
        gcs.world.step(0.3)
        assert mode(gcs) == LAND
        assert any(text.startswith("Battery 1 is critical ") for text in gcs.texts())

    def test_what_it_does_is_a_parameter_and_nothing_by_default(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs)
        setp(gcs, "BATT_LOW_MAH", self.left(gcs))
        gcs.world.step(0.3)
        assert mode(gcs) == GUIDED
        assert "Battery Failsafe" in gcs.texts()

    def test_terminates(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, BATT_FS_LOW_ACT=5)
        setp(gcs, "BATT_LOW_MAH", self.left(gcs))
        gcs.world.step(0.3)
        assert not gcs.vehicle.copter.armed

    @pytest.mark.parametrize(
        ("name", "value", "words"),
        [
            ("SIM_BATT_VOLTAGE", 10.0, "low voltage failsafe"),
            ("BATT_LOW_MAH", 4000.0, "low capacity failsafe"),
            ("BATT_ARM_VOLT", 13.0, "below minimum arming voltage"),
            ("BATT_ARM_MAH", 4000.0, "below minimum arming capacity"),
            ("BATT_CRT_VOLT", 10.9, "voltage failsafe critical >= low"),
        ],
    )
    def test_keeps_it_from_arming(self, gcs: Gcs, name: str, value: float, words: str) -> None:
        gcs.world.step(1.0)
        setp(gcs, name, value)
        assert gcs.command(400, 1) == FAILED
        assert gcs.texts()[-1] == f"Arm: Battery 1 {words}"
        assert gcs.command(400, 1, 21196) == ACCEPTED  # forced

    def test_after_one_it_does_not_arm_until_a_reboot(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, BATT_FS_LOW_ACT=1)
        setp(gcs, "SIM_BATT_VOLTAGE", 10.2)
        gcs.until(lambda: not gcs.vehicle.copter.armed)
        setp(gcs, "SIM_BATT_VOLTAGE", 12.6)
        gcs.world.step(1.0)
        assert gcs.command(176, 1, GUIDED) == ACCEPTED
        assert gcs.command(400, 1) == FAILED
        assert gcs.texts()[-1] == "Arm: Battery failsafe"
        assert gcs.command(246, 1) == ACCEPTED
        gcs.world.step(2.0)
        assert gcs.command(400, 1) == ACCEPTED


class TestPosition:
    def test_without_gps_it_lands_in_the_end(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs)
        gcs.world.fault("quad1", "gps-loss")
        gcs.world.step(6.8)
        assert gcs.last("GPS_RAW_INT")["fix_type"] == 1
        assert gcs.last("EKF_STATUS_REPORT")["flags"] == 0x33F
        assert mode(gcs) == GUIDED
        gcs.world.step(1.6)
        assert mode(gcs) == LAND
        assert gcs.texts()[-2:] == ["EKF variance", "EKF Failsafe: changed to LAND Mode"]
        assert gcs.last("EKF_STATUS_REPORT")["flags"] == 0x25
        assert gcs.command(176, 1, LOITER) == FAILED
        gcs.world.step(7.0)
        assert gcs.last("EKF_STATUS_REPORT")["flags"] == 0xA7
        gcs.world.clear()
        gcs.world.step(1.5)
        assert "EKF Failsafe Cleared" in gcs.texts()
        assert gcs.command(176, 1, LOITER) == ACCEPTED

    @pytest.mark.parametrize(("action", "expected"), [(0, GUIDED), (2, ALT_HOLD)])
    def test_what_it_does_is_a_parameter(self, make_gcs: MakeGcs, action: int, expected: int) -> None:
        gcs = aloft(make_gcs, FS_EKF_ACTION=action)
        gcs.world.fault("quad1", "gps-loss")
        gcs.world.step(8.5)
        assert mode(gcs) == expected

    def test_a_pilot_who_needs_none_flies_on(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs)
        gcs.vehicle.copter.pilot.sticks(throttle=0.5)
        assert gcs.command(176, 1, ALT_HOLD) == ACCEPTED
        gcs.world.fault("quad1", "gps-loss")
        gcs.world.step(8.5)
        assert mode(gcs) == ALT_HOLD
        assert "EKF Failsafe" in gcs.texts()


class TestFence:
    SQUARE_M = 20.0

    def square(self, gcs: Gcs, kind: int = 5001) -> None:
        m = self.SQUARE_M
        corners = ((-m, -m), (-m, m), (m, m), (m, -m))
        gcs.world.step(1.0)
        assert upload(gcs, [at(kind, n, e, 0.0, 4.0) for n, e in corners], FENCE) == ACCEPTED

    def out(self, gcs: Gcs, north: float, sim_s: float = 12.0) -> None:
        """Fly out by the sticks' means: nothing holds velocities back."""
        gcs.until(lambda: self._push(gcs, north), sim_s)

    def _push(self, gcs: Gcs, north: float) -> bool:
        if mode(gcs) == GUIDED:
            gcs.fly(4.0, 0.0)
        return gcs.ned[0] > north or mode(gcs) != GUIDED

    def test_a_breach_of_the_circle_returns_it(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=15)
        assert gcs.last("FENCE_STATUS")["breach_status"] == 0
        self.out(gcs, 30.0)
        assert mode(gcs) == RTL
        assert gcs.ned[0] == pytest.approx(15.0, abs=1.0)
        assert gcs.texts()[-2:] == ["Circle fence breached", "Manual recovery started"]
        status = gcs.last("FENCE_STATUS")
        assert (status["breach_status"], status["breach_count"], status["breach_type"]) == (1, 1, 3)
        gcs.until(lambda: "Fence breach cleared" in gcs.texts(), 40.0)

    def test_the_ceiling(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_ALT_MAX=10, FENCE_ACTION=2)
        while mode(gcs) == GUIDED:
            gcs.fly(0.0, 0.0, -2.0)
            gcs.world.step(0.5)
            assert gcs.ned[2] > -14.0
        assert mode(gcs) == LAND
        assert "Max Alt fence breached" in gcs.texts()
        assert gcs.last("FENCE_STATUS")["breach_type"] == 2

    @pytest.mark.parametrize(("action", "expected"), [(1, RTL), (2, LAND), (3, RTL), (4, BRAKE), (5, LAND)])
    def test_does_what_fence_action_says(self, make_gcs: MakeGcs, action: int, expected: int) -> None:
        gcs = make_gcs([VehicleSpec(params={"FENCE_ACTION": action})])
        self.square(gcs)
        gcs.put_up(3.0)
        setp(gcs, "FENCE_ENABLE", 1.0)
        gcs.goto(18.0, 0.0, -3.0)
        gcs.until(lambda: gcs.near(18.0, 0.0, -3.0))
        self.out(gcs, 26.0)
        assert mode(gcs) == expected
        assert "Polygon fence breached" in gcs.texts()

    def test_may_only_report(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=8, FENCE_ACTION=0)
        self.out(gcs, 12.0)
        assert mode(gcs) == GUIDED
        assert gcs.texts()[-1] == "Circle fence breached"

    def test_places_to_stay_out_of(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={"FENCE_ENABLE": 1})])
        gcs.world.step(1.0)
        assert upload(gcs, [at(5004, 15, 0, 0, 5.0)], FENCE) == ACCEPTED
        gcs.put_up(3.0)
        self.out(gcs, 20.0)
        assert mode(gcs) == RTL
        assert gcs.ned[0] == pytest.approx(10.0, abs=1.0)

    def test_guided_is_not_sent_outside(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=15)
        gcs.goto(30.0, 0.0, -4.0)
        gcs.goto(0.0, 0.0, -400.0)
        gcs.world.step(3.0)
        assert gcs.near(0.0, 0.0, -4.0)
        where = {"x": at(16, 30, 0)["x"], "y": at(16, 30, 0)["y"]}
        assert gcs.command_int(192, z=5.0, frame=6, **where) == FAILED

    def test_while_it_recovers_the_pilot_may_be_kept_out(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=15, FENCE_OPTIONS=1)
        self.out(gcs, 30.0)
        assert gcs.command(176, 1, LOITER) == FAILED
        assert gcs.texts()[-1] == "Mode change to LOITER failed: in fence recovery"

    def test_whoever_takes_it_back_has_ten_seconds(self, make_gcs: MakeGcs) -> None:
        """The fence has a second line 20 m farther out; within that time it does not act on that either."""
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=8)
        self.out(gcs, 15.0)
        assert gcs.command(176, 1, GUIDED) == ACCEPTED
        for _ in range(8):
            gcs.fly(6.0, 0.0)
            gcs.world.step(1.0)
        assert gcs.ned[0] > 32.0
        assert mode(gcs) == GUIDED

    def test_beyond_the_second_line_it_acts_again(self, make_gcs: MakeGcs) -> None:
        gcs = aloft(make_gcs, FENCE_ENABLE=1, FENCE_RADIUS=8)
        self.out(gcs, 15.0)
        assert gcs.command(176, 1, GUIDED) == ACCEPTED
        gcs.world.step(10.5)
        for _ in range(8):
            if mode(gcs) == GUIDED:
                gcs.fly(6.0, 0.0)
            gcs.world.step(1.0)
        assert mode(gcs) == RTL
        assert gcs.last("FENCE_STATUS")["breach_count"] == 2

    def test_a_breach_keeps_it_from_arming(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        assert upload(gcs, [at(5003, 100, 0, 0, 10.0)], FENCE) == ACCEPTED
        setp(gcs, "FENCE_ENABLE", 1.0)
        gcs.world.step(0.2)
        assert gcs.command(400, 1) == FAILED
        assert gcs.texts()[-1] == "Arm: Vehicle breaching Polygon fence"

    @pytest.mark.parametrize(
        ("params", "words"),
        [
            ({"FENCE_TYPE": 4}, "Fences enabled, but none selected"),
            ({"FENCE_RADIUS": 1}, "Circle FENCE_MARGIN is greater than FENCE_RADIUS"),
        ],
    )
    def test_a_fence_that_makes_no_sense_keeps_it_from_arming(
        self, make_gcs: MakeGcs, params: dict[str, float], words: str
    ) -> None:
        gcs = make_gcs([VehicleSpec(params={"FENCE_ENABLE": 1, **params})])
        gcs.world.step(1.0)
        gcs.clear("STATUSTEXT")
        assert gcs.command(400, 1) == FAILED
        assert "".join(gcs.texts()) == f"Arm: {words}"
        assert [(m["id"] > 0, m["chunk_seq"]) for m in gcs.all("STATUSTEXT")][1:] in ([], [(True, 1)])


class TestRally:
    def test_it_returns_to_the_nearest_point(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={"RTL_ALT": 300, "RTL_LOIT_TIME": 0})])
        gcs.world.step(1.0)
        assert upload(gcs, [at(5100, 12, 0, 0), at(5100, 200, 0, 0)], 2) == ACCEPTED
        gcs.put_up(3.0)
        gcs.goto(8.0, 0.0, -3.0)
        gcs.until(lambda: gcs.near(8.0, 0.0, -3.0))
        assert gcs.command(20) == ACCEPTED
        gcs.until(lambda: not gcs.vehicle.copter.armed)
        assert gcs.near(12.0, 0.0, 0.0, 0.3)
