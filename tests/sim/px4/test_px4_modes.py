"""Arming, modes and AUTO flights of the simulated PX4."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.errors import BadInput

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion, MakeCompanion

ARM_DENIED, ARMED, DISARMED, TAKEOFF, LANDED = 0x0102089D, 0x0190CAF3, 0x01F46777, 0x01414569, 0x019638AC
E7 = 1e7


class TestArming:
    def test_not_before_it_is_ready(self, companion: Companion) -> None:
        assert companion.arm() == [1]
        assert companion.events() == [ARM_DENIED]
        companion.ready()
        assert companion.arm() == [0]

    def test_the_prearm_bit_and_the_status_tell_when_it_is(self, companion: Companion) -> None:
        companion.world.step(1.5)
        health = [m["onboard_control_sensors_health"] & 0x10000000 for m in companion.all("SYS_STATUS")]
        assert health[0] == 0 and health[-1] != 0
        assert [m["system_status"] for m in companion.all("HEARTBEAT")] == [0, 3]

    def test_disarming_is_refused_in_the_air_and_can_be_forced(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.command(400, 0) == [1]
        assert companion.command(400, 0, 21196) == [0]
        assert not companion.vehicle.px4.armed

    def test_without_a_takeoff_it_disarms_by_itself(self, companion: Companion) -> None:
        companion.ready()
        assert companion.arm() == [0]
        assert companion.until(lambda: not companion.vehicle.px4.armed) == pytest.approx(10.0, abs=0.2)
        assert companion.all("EVENT")[-1]["arguments"][0] == 7

    @pytest.mark.parametrize(("main", "sub"), [(4, 5), (4, 6), (3, 0), (1, 0)])
    def test_some_modes_prevent_it(self, companion: Companion, main: int, sub: int) -> None:
        companion.ready()
        assert companion.mode(main, sub) == [0, 0]
        assert companion.arm() == [1]


class TestModes:
    def test_both_acknowledge_a_mode(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.mode(4, 6) == [0, 0]

    def test_the_second_tells_of_a_refusal(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.mode(6) == [0, 1]
        assert companion.mode(77) == [0, 1]
        assert companion.flying == "HOLD"

    def test_an_unknown_command_is_unsupported(self, companion: Companion) -> None:
        assert companion.command(31000) == [3]

    def test_the_heartbeat_shows_the_mode_at_its_next_turn(self, companion: Companion) -> None:
        companion.ready()
        companion.mode(7)
        companion.world.step(1.1)
        last = companion.all("HEARTBEAT")[-1]
        assert (last["custom_mode"], last["base_mode"]) == (7 << 16, 81)


class TestAuto:
    @staticmethod
    def ends_below(companion: Companion, height: float) -> bool:
        """Where the real one ends a takeoff and stays: NAV_MC_ALT_RAD (0.8 m) too low, less what it rises on."""
        return companion.near(0.0, 0.0, 0.5 - height, 0.35)

    def test_a_takeoff_by_mode_rises_to_the_parameter_and_holds(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"MIS_TAKEOFF_ALT": 4.0})
        companion.take_off()
        companion.world.step(3.0)
        assert self.ends_below(companion, 4.0)
        flight = [event for event in companion.events() if event in (ARMED, 0x013B2FC7, TAKEOFF, LANDED)]
        assert flight == [ARMED, 0x013B2FC7, TAKEOFF]

    def test_a_takeoff_by_command_takes_an_altitude_above_the_sea(self, companion: Companion) -> None:
        companion.ready()
        companion.arm()
        amsl = companion.vehicle.px4.position.alt_amsl_m + 7.0
        assert companion.command(22, 0, 0, 0, math.nan, math.nan, math.nan, amsl) == [0]
        companion.until(lambda: companion.flying == "HOLD")
        companion.world.step(3.0)
        assert self.ends_below(companion, 7.0)

    def test_it_flies_to_a_place_and_holds_there(self, companion: Companion) -> None:
        companion.put_up()
        place = companion.vehicle.px4.place((12.0, -5.0, -6.0))
        x, y = round(place.lat_deg * E7), round(place.lon_deg * E7)
        assert companion.command_int(192, x=x, y=y, z=place.alt_amsl_m, param1=-1, param2=1, param4=math.nan) == [0]
        companion.until(lambda: companion.near(12.0, -5.0, -6.0, 0.4))
        assert companion.flying == "HOLD"

    def test_the_frame_of_a_command_is_not_looked_at(self, companion: Companion) -> None:
        """As in PX4: an altitude above home is taken for one above the sea."""
        companion.put_up()
        place = companion.vehicle.px4.place((12.0, -5.0, -6.0))
        x, y = round(place.lat_deg * E7), round(place.lon_deg * E7)
        assert companion.command_int(192, frame=3, x=x, y=y, z=6.0, param1=-1, param2=1, param4=math.nan) == [0]
        companion.world.step(1.0)
        assert companion.vehicle.px4.sense.vd > 0.5

    def test_without_the_flag_to_change_the_mode_a_reposition_is_unsupported(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.command_int(192, x=0, y=0, z=600.0, param1=-1, param2=0) == [3]

    def test_a_speed_is_kept_to(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.command(178, 1, 2.0) == [0]
        place = companion.vehicle.px4.place((60.0, 0.0, -3.0))
        nan = math.nan
        assert companion.command(192, 2.0, 1, 0, nan, place.lat_deg, place.lon_deg, place.alt_amsl_m) == [0]
        companion.world.step(8.0)
        assert companion.vehicle.px4.sense.vn == pytest.approx(1.85, abs=0.2)

    def test_landing_disarms_by_itself_and_goes_back_to_the_mode_before(self, companion: Companion) -> None:
        companion.take_off()
        assert companion.command(21) == [0]
        companion.until(lambda: not companion.vehicle.px4.armed)
        assert companion.events()[-2:] == [LANDED, DISARMED]
        assert companion.flying == "HOLD"
        assert abs(companion.ned[2]) < 0.02
        assert [m["landed_state"] for m in companion.all("EXTENDED_SYS_STATE")][-1] == 1

    def test_returning_climbs_comes_home_and_lands(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.position(12.0, 0.0, -6.0), 6.0)
        companion.until(lambda: companion.near(12.0, 0.0, -6.0), say=lambda: companion.position(12.0, 0.0, -6.0))
        assert companion.command(20) == [0]
        heights = []

        def landed() -> bool:
            heights.append(-companion.ned[2])
            return not companion.vehicle.px4.armed

        companion.until(landed, 120.0)
        # The cone of 45 degrees over home asks for as much height as there is distance.
        assert max(heights) == pytest.approx(12.0, abs=1.0)
        assert companion.near(0.0, 0.0, 0.0, 1.5)

    def test_a_mission_mode_without_a_mission_is_refused(self, companion: Companion) -> None:
        companion.put_up()
        assert companion.mode(4, 4) == [0, 1]


class TestPilot:
    def test_a_turn_of_the_switch_changes_the_mode(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"COM_FLTMODE1": 2.0, "COM_FLTMODE6": 4.0})
        companion.offboard(lambda: companion.position(0.0, 0.0, -5.0), 5.0)
        companion.vehicle.pilot_mode("POSCTL")
        companion.stream(0.2, lambda: companion.position(0.0, 0.0, -5.0))
        assert companion.flying == "POSCTL"
        companion.stream(3.0, lambda: companion.position(30.0, 0.0, -5.0))
        assert companion.flying == "POSCTL" and abs(companion.ned[0]) < 1.0

    def test_what_is_not_on_the_switch_is_named(self, companion: Companion) -> None:
        with pytest.raises(BadInput, match="no mode"):
            companion.vehicle.pilot_mode("POSCTL")

    def test_a_joystick_flies_it(self, companion: Companion) -> None:
        def stick(z: int = 500, **more: int) -> None:
            companion.send("MANUAL_CONTROL", target=1, **{"x": 0, "y": 0, "z": z, "r": 0, "buttons": 0, **more})

        companion.ready()
        stick()
        assert companion.mode(3) == [0, 0]
        assert companion.arm() == [0]
        companion.stream(5.0, lambda: stick(900))
        assert companion.ned[2] < -3.0
        companion.stream(3.0, lambda: stick(x=500))
        assert companion.vehicle.px4.sense.vn > 3.0

    @pytest.mark.parametrize(("action", "mode"), [(1, "HOLD"), (2, "RTL"), (3, "LAND")])
    def test_a_joystick_that_is_lost_brings_the_failsafe(
        self, make_companion: MakeCompanion, action: int, mode: str
    ) -> None:
        companion = make_companion(params={"NAV_RCL_ACT": float(action), "COM_FAIL_ACT_T": 1.0})

        def stick() -> None:
            companion.send("MANUAL_CONTROL", target=1, x=0, y=0, z=500, r=0, buttons=0)

        companion.ready()
        stick()
        assert companion.arm() == [0] and companion.mode(4, 2) == [0, 0]
        companion.until(lambda: companion.flying == "HOLD", say=stick)
        assert companion.vehicle.px4.system_status == 4
        companion.world.step(1.0)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 5
        companion.world.step(1.0)
        assert companion.flying == mode
        stick()
        companion.world.step(0.1)
        assert companion.flying == mode  # it goes on, until somebody asks for another mode
        stick()
        assert companion.mode(4, 3) == [0, 0]
        companion.world.step(0.1)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4


class TestGroundStation:
    def test_texts_go_only_where_one_was_heard(self, companion: Companion) -> None:
        companion.ready()
        companion.beat(18)
        companion.arm()
        assert companion.texts() == []
        companion.beat()
        companion.command(400, 0)
        assert companion.texts() == ["Disarmed by external command\t"]

    def test_its_loss_acts_where_told_to(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"NAV_DLL_ACT": 3.0, "COM_FAIL_ACT_T": 2.0})
        companion.world.step(1.0)
        assert companion.arm() == [1]  # none was ever heard
        companion.beat()
        companion.put_up()
        companion.beat()
        companion.world.step(9.9)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4
        companion.world.step(0.3)
        assert companion.vehicle.px4.system_status == 5
        companion.world.step(2.0)
        assert companion.flying == "LAND"


@pytest.mark.parametrize(("numbers", "name"), [((3, 1), "Orbit"), ((5, 0), "Acro"), ((4, 8), "Follow")])
def test_a_mode_that_is_not_simulated(companion: Companion, numbers: tuple[int, int], name: str) -> None:
    companion.beat()
    assert companion.mode(*numbers) == [0, 3]
    assert f"{name} is not simulated\t" in companion.texts()


def test_a_command_that_is_not_simulated(companion: Companion) -> None:
    companion.beat()
    assert companion.command(34, 5.0, 1.0) == [3]
    assert "MAV_CMD 34 is not simulated\t" in companion.texts()
