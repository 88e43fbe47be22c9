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
    from tests.sim.conftest import Desk, MakeDesk

GUIDED, AUTO, LOITER, RTL, LAND, ALT_HOLD, BRAKE, STABILIZE = 4, 3, 5, 6, 9, 2, 17, 0
ACCEPTED, DENIED, FAILED = 0, 2, 4
FENCE = 1

AnotherDesk = Callable[..., "Desk"]
IMPATIENT = {"FS_GCS_TIMEOUT": 2.0}


def mode(desk: Desk) -> int:
    return desk.vehicle.copter.mode.number


def setp(desk: Desk, name: str, value: float) -> None:
    desk.send("PARAM_SET", param_id=name, param_value=value, param_type=9)


def aloft(make_desk: MakeDesk, height: float = 4.0, **params: float) -> Desk:
    desk = make_desk([VehicleSpec(params=params)])
    desk.put_up(height)
    return desk


class TestGroundStation:
    def silent(self, make_desk: MakeDesk, **params: float) -> Desk:
        """In the air, and nothing heard of the ground station for longer than FS_GCS_TIMEOUT."""
        desk = aloft(make_desk, **IMPATIENT, **params)
        desk.send("HEARTBEAT", type=6)
        desk.world.step(2.6)
        return desk

    @pytest.mark.parametrize(
        ("action", "expected"), [(0, GUIDED), (1, RTL), (2, RTL), (3, RTL), (4, LAND), (5, LAND), (7, BRAKE), (9, RTL)]
    )
    def test_does_what_fs_gcs_enable_says(self, make_desk: MakeDesk, action: int, expected: int) -> None:
        desk = self.silent(make_desk, FS_GCS_ENABLE=action)
        assert mode(desk) == expected
        assert ("GCS Failsafe" in desk.texts()) is (action != 0)

    def test_landing_gives_the_pilot_four_seconds(self, make_desk: MakeDesk) -> None:
        desk = self.silent(make_desk, FS_GCS_ENABLE=5)
        desk.world.step(2.5)
        assert abs(desk.ned[2] + 4.0) < 0.3
        desk.world.step(4.0)
        assert desk.ned[2] > -3.5

    def test_a_companion_with_the_vehicles_own_system_id_does_not_count(
        self, make_desk: MakeDesk, another_desk: AnotherDesk
    ) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=5)
        companion = another_desk(desk.world, desk.vehicle, sysid=1, compid=191)
        desk.send("HEARTBEAT", type=6)
        for _ in range(7):
            companion.send("HEARTBEAT", type=18)
            desk.world.step(0.4)
        assert mode(desk) == LAND

    def test_any_component_of_the_ground_stations_system_counts(
        self, make_desk: MakeDesk, another_desk: AnotherDesk
    ) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=5, MAV_GCS_SYSID=7)
        station = another_desk(desk.world, desk.vehicle, sysid=7, compid=42)
        for _ in range(7):
            station.send("HEARTBEAT", type=6)
            desk.world.step(0.4)
        assert mode(desk) == GUIDED
        desk.world.step(2.6)
        assert mode(desk) == LAND

    def test_sticks_count_as_a_heartbeat(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=5)
        desk.send("HEARTBEAT", type=6)
        for _ in range(7):
            desk.send("MANUAL_CONTROL", target=1, z=500)
            desk.world.step(0.4)
        assert mode(desk) == GUIDED

    def test_disarmed_it_is_said_and_keeps_it_from_arming(self, make_desk: MakeDesk) -> None:
        desk = make_desk([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1})])
        desk.send("HEARTBEAT", type=6)
        desk.world.step(3.0)
        assert "GCS Failsafe" in desk.texts()
        assert desk.last("HEARTBEAT")["system_status"] == 5
        assert desk.command(176, 1, GUIDED) == ACCEPTED
        assert desk.command(400, 1) == FAILED
        assert desk.texts()[-1] == "Arm: GCS failsafe on"
        desk.send("HEARTBEAT", type=6)
        desk.world.step(0.4)
        assert desk.command(400, 1) == ACCEPTED

    def test_armed_on_the_ground_it_disarms(self, make_desk: MakeDesk) -> None:
        desk = make_desk([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1})])
        desk.send("HEARTBEAT", type=6)
        desk.world.step(1.0)
        assert desk.command(400, 1) == ACCEPTED
        desk.world.step(2.0)
        assert not desk.vehicle.copter.armed
        assert "GCS Failsafe - Disarming" in desk.texts()

    def test_a_pilot_may_go_on(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=1)  # FS_OPTIONS is 16
        desk.vehicle.pilot_mode("LOITER")
        desk.send("HEARTBEAT", type=6)
        desk.world.step(2.6)
        assert mode(desk) == LOITER
        assert "GCS Failsafe - Continuing Pilot Control" in desk.texts()

    @pytest.mark.parametrize(("options", "expected"), [(16, RTL), (2, AUTO)])
    def test_a_mission_may_go_on(self, make_desk: MakeDesk, options: int, expected: int) -> None:
        desk = make_desk([VehicleSpec(params={**IMPATIENT, "FS_GCS_ENABLE": 1, "FS_OPTIONS": options})])
        desk.until(lambda: desk.vehicle.copter.position_ok)
        assert upload(desk, [at(17, 0, 0, 4)]) == ACCEPTED
        desk.put_up(4.0)
        assert desk.command(176, 1, AUTO) == ACCEPTED
        desk.send("HEARTBEAT", type=6)
        desk.world.step(2.6)
        assert mode(desk) == expected

    @pytest.mark.parametrize(("options", "expected"), [(0, RTL), (8, LAND)])
    def test_a_landing_may_go_on(self, make_desk: MakeDesk, options: int, expected: int) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=1, FS_OPTIONS=options)
        desk.send("HEARTBEAT", type=6)
        assert desk.command(21) == ACCEPTED
        desk.world.step(2.6)
        assert mode(desk) == expected

    def test_it_takes_overrides_away(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, **IMPATIENT, FS_GCS_ENABLE=5, RC_OVERRIDE_TIME=-1)
        others = {f"chan{i}_raw": 65535 for i in range(2, 19)}
        desk.send("RC_CHANNELS_OVERRIDE", chan1_raw=1600, **others)
        desk.world.step(2.6)
        assert desk.last("RC_CHANNELS")["chan1_raw"] == 1500


class TestBattery:
    @staticmethod
    def left(desk: Desk) -> float:
        """mAh: a limit that is reached at once."""
        copter = desk.vehicle.copter
        return copter.params["BATT_CAPACITY"] - copter.consumed_mah

    def test_low_voltage_for_ten_seconds(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, BATT_FS_LOW_ACT=2)
        setp(desk, "SIM_BATT_VOLTAGE", 10.2)
        assert desk.last("SYS_STATUS")["voltage_battery"] == 10200
        desk.world.step(9.8)
        assert mode(desk) == GUIDED
        desk.world.step(0.5)  # BATT_LOW_TIMER
        assert mode(desk) == RTL
        warning, failsafe = desk.texts()[-2:]
        assert warning.startswith("Battery 1 is low 10.20V used ")
        assert failsafe == "Battery Failsafe"
        assert desk.last("HEARTBEAT")["system_status"] == 5

    def test_a_dip_is_nothing(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, BATT_FS_LOW_ACT=2)
        for _ in range(2):
            setp(desk, "SIM_BATT_VOLTAGE", 10.2)
            desk.world.step(6.0)
            setp(desk, "SIM_BATT_VOLTAGE", 12.6)
            desk.world.step(0.2)
        assert mode(desk) == GUIDED

    def test_capacity_at_once_and_critical_after_low(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, BATT_FS_LOW_ACT=2, BATT_FS_CRT_ACT=1)
        setp(desk, "BATT_LOW_MAH", self.left(desk))
        desk.world.step(0.3)
        assert mode(desk) == RTL
        setp(desk, "BATT_CRT_MAH", self.left(desk))
        desk.world.step(0.3)
        assert mode(desk) == LAND
        assert any(text.startswith("Battery 1 is critical ") for text in desk.texts())

    def test_what_it_does_is_a_parameter_and_nothing_by_default(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk)
        setp(desk, "BATT_LOW_MAH", self.left(desk))
        desk.world.step(0.3)
        assert mode(desk) == GUIDED
        assert "Battery Failsafe" in desk.texts()

    def test_terminates(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, BATT_FS_LOW_ACT=5)
        setp(desk, "BATT_LOW_MAH", self.left(desk))
        desk.world.step(0.3)
        assert not desk.vehicle.copter.armed

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
    def test_keeps_it_from_arming(self, desk: Desk, name: str, value: float, words: str) -> None:
        desk.world.step(1.0)
        setp(desk, name, value)
        assert desk.command(400, 1) == FAILED
        assert desk.texts()[-1] == f"Arm: Battery 1 {words}"
        assert desk.command(400, 1, 21196) == ACCEPTED  # forced

    def test_after_one_it_does_not_arm_until_a_reboot(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, BATT_FS_LOW_ACT=1)
        setp(desk, "SIM_BATT_VOLTAGE", 10.2)
        desk.until(lambda: not desk.vehicle.copter.armed)
        setp(desk, "SIM_BATT_VOLTAGE", 12.6)
        desk.world.step(1.0)
        assert desk.command(176, 1, GUIDED) == ACCEPTED
        assert desk.command(400, 1) == FAILED
        assert desk.texts()[-1] == "Arm: Battery failsafe"
        assert desk.command(246, 1) == ACCEPTED
        desk.world.step(2.0)
        assert desk.command(400, 1) == ACCEPTED


class TestPosition:
    def test_without_gps_it_lands_in_the_end(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk)
        desk.world.fault("quad1", "gps-loss")
        desk.world.step(6.8)
        assert desk.last("GPS_RAW_INT")["fix_type"] == 1
        assert desk.last("EKF_STATUS_REPORT")["flags"] == 0x33F
        assert mode(desk) == GUIDED
        desk.world.step(1.6)
        assert mode(desk) == LAND
        assert desk.texts()[-2:] == ["EKF variance", "EKF Failsafe: changed to LAND Mode"]
        assert desk.last("EKF_STATUS_REPORT")["flags"] == 0x25
        assert desk.command(176, 1, LOITER) == FAILED
        desk.world.step(7.0)
        assert desk.last("EKF_STATUS_REPORT")["flags"] == 0xA7
        desk.world.clear()
        desk.world.step(1.5)
        assert "EKF Failsafe Cleared" in desk.texts()
        assert desk.command(176, 1, LOITER) == ACCEPTED

    @pytest.mark.parametrize(("action", "expected"), [(0, GUIDED), (2, ALT_HOLD)])
    def test_what_it_does_is_a_parameter(self, make_desk: MakeDesk, action: int, expected: int) -> None:
        desk = aloft(make_desk, FS_EKF_ACTION=action)
        desk.world.fault("quad1", "gps-loss")
        desk.world.step(8.5)
        assert mode(desk) == expected

    def test_a_pilot_who_needs_none_flies_on(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk)
        desk.vehicle.copter.pilot.sticks(throttle=0.5)
        assert desk.command(176, 1, ALT_HOLD) == ACCEPTED
        desk.world.fault("quad1", "gps-loss")
        desk.world.step(8.5)
        assert mode(desk) == ALT_HOLD
        assert "EKF Failsafe" in desk.texts()


class TestFence:
    SQUARE_M = 20.0

    def square(self, desk: Desk, kind: int = 5001) -> None:
        m = self.SQUARE_M
        corners = ((-m, -m), (-m, m), (m, m), (m, -m))
        desk.world.step(1.0)
        assert upload(desk, [at(kind, n, e, 0.0, 4.0) for n, e in corners], FENCE) == ACCEPTED

    def out(self, desk: Desk, north: float, sim_s: float = 12.0) -> None:
        """Fly out by the sticks' means: nothing holds velocities back."""
        desk.until(lambda: self._push(desk, north), sim_s)

    def _push(self, desk: Desk, north: float) -> bool:
        if mode(desk) == GUIDED:
            desk.fly(4.0, 0.0)
        return desk.ned[0] > north or mode(desk) != GUIDED

    def test_a_breach_of_the_circle_returns_it(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=15)
        assert desk.last("FENCE_STATUS")["breach_status"] == 0
        self.out(desk, 30.0)
        assert mode(desk) == RTL
        assert desk.ned[0] == pytest.approx(15.0, abs=1.0)
        assert desk.texts()[-2:] == ["Circle fence breached", "Manual recovery started"]
        status = desk.last("FENCE_STATUS")
        assert (status["breach_status"], status["breach_count"], status["breach_type"]) == (1, 1, 3)
        desk.until(lambda: "Fence breach cleared" in desk.texts(), 40.0)

    def test_the_ceiling(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_ALT_MAX=10, FENCE_ACTION=2)
        while mode(desk) == GUIDED:
            desk.fly(0.0, 0.0, -2.0)
            desk.world.step(0.5)
            assert desk.ned[2] > -14.0
        assert mode(desk) == LAND
        assert "Max Alt fence breached" in desk.texts()
        assert desk.last("FENCE_STATUS")["breach_type"] == 2

    @pytest.mark.parametrize(("action", "expected"), [(1, RTL), (2, LAND), (3, RTL), (4, BRAKE), (5, LAND)])
    def test_does_what_fence_action_says(self, make_desk: MakeDesk, action: int, expected: int) -> None:
        desk = make_desk([VehicleSpec(params={"FENCE_ACTION": action})])
        self.square(desk)
        desk.put_up(3.0)
        setp(desk, "FENCE_ENABLE", 1.0)
        desk.goto(18.0, 0.0, -3.0)
        desk.until(lambda: desk.near(18.0, 0.0, -3.0))
        self.out(desk, 26.0)
        assert mode(desk) == expected
        assert "Polygon fence breached" in desk.texts()

    def test_may_only_report(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=8, FENCE_ACTION=0)
        self.out(desk, 12.0)
        assert mode(desk) == GUIDED
        assert desk.texts()[-1] == "Circle fence breached"

    def test_places_to_stay_out_of(self, make_desk: MakeDesk) -> None:
        desk = make_desk([VehicleSpec(params={"FENCE_ENABLE": 1})])
        desk.world.step(1.0)
        assert upload(desk, [at(5004, 15, 0, 0, 5.0)], FENCE) == ACCEPTED
        desk.put_up(3.0)
        self.out(desk, 20.0)
        assert mode(desk) == RTL
        assert desk.ned[0] == pytest.approx(10.0, abs=1.0)

    def test_guided_is_not_sent_outside(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=15)
        desk.goto(30.0, 0.0, -4.0)
        desk.goto(0.0, 0.0, -400.0)
        desk.world.step(3.0)
        assert desk.near(0.0, 0.0, -4.0)
        where = {"x": at(16, 30, 0)["x"], "y": at(16, 30, 0)["y"]}
        assert desk.command_int(192, z=5.0, frame=6, **where) == FAILED

    def test_while_it_recovers_the_pilot_may_be_kept_out(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=15, FENCE_OPTIONS=1)
        self.out(desk, 30.0)
        assert desk.command(176, 1, LOITER) == FAILED
        assert desk.texts()[-1] == "Mode change to LOITER failed: in fence recovery"

    def test_whoever_takes_it_back_has_ten_seconds(self, make_desk: MakeDesk) -> None:
        """The fence has a second line 20 m farther out; within that time it does not act on that either."""
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=8)
        self.out(desk, 15.0)
        assert desk.command(176, 1, GUIDED) == ACCEPTED
        for _ in range(8):
            desk.fly(6.0, 0.0)
            desk.world.step(1.0)
        assert desk.ned[0] > 32.0
        assert mode(desk) == GUIDED

    def test_beyond_the_second_line_it_acts_again(self, make_desk: MakeDesk) -> None:
        desk = aloft(make_desk, FENCE_ENABLE=1, FENCE_RADIUS=8)
        self.out(desk, 15.0)
        assert desk.command(176, 1, GUIDED) == ACCEPTED
        desk.world.step(10.5)
        for _ in range(8):
            if mode(desk) == GUIDED:
                desk.fly(6.0, 0.0)
            desk.world.step(1.0)
        assert mode(desk) == RTL
        assert desk.last("FENCE_STATUS")["breach_count"] == 2

    def test_a_breach_keeps_it_from_arming(self, desk: Desk) -> None:
        desk.world.step(1.0)
        assert upload(desk, [at(5003, 100, 0, 0, 10.0)], FENCE) == ACCEPTED
        setp(desk, "FENCE_ENABLE", 1.0)
        desk.world.step(0.2)
        assert desk.command(400, 1) == FAILED
        assert desk.texts()[-1] == "Arm: Vehicle breaching Polygon fence"

    @pytest.mark.parametrize(
        ("params", "words"),
        [
            ({"FENCE_TYPE": 4}, "Fences enabled, but none selected"),
            ({"FENCE_RADIUS": 1}, "Circle FENCE_MARGIN is greater than FENCE_RADIUS"),
        ],
    )
    def test_a_fence_that_makes_no_sense_keeps_it_from_arming(
        self, make_desk: MakeDesk, params: dict[str, float], words: str
    ) -> None:
        desk = make_desk([VehicleSpec(params={"FENCE_ENABLE": 1, **params})])
        desk.world.step(1.0)
        desk.clear("STATUSTEXT")
        assert desk.command(400, 1) == FAILED
        assert "".join(desk.texts()) == f"Arm: {words}"
        assert [(m["id"] > 0, m["chunk_seq"]) for m in desk.all("STATUSTEXT")][1:] in ([], [(True, 1)])


class TestRally:
    def test_it_returns_to_the_nearest_point(self, make_desk: MakeDesk) -> None:
        desk = make_desk([VehicleSpec(params={"RTL_ALT": 300, "RTL_LOIT_TIME": 0})])
        desk.world.step(1.0)
        assert upload(desk, [at(5100, 12, 0, 0), at(5100, 200, 0, 0)], 2) == ACCEPTED
        desk.put_up(3.0)
        desk.goto(8.0, 0.0, -3.0)
        desk.until(lambda: desk.near(8.0, 0.0, -3.0))
        assert desk.command(20) == ACCEPTED
        desk.until(lambda: not desk.vehicle.copter.armed)
        assert desk.near(12.0, 0.0, 0.0, 0.3)
