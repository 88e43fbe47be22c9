"""What a failing battery, GPS, radio or ground station does to the simulated PX4, and how a pilot gets out of it."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from zmav.mavlink.event import event_id
from zmav.sim.sensors.troubles import FINE, Trouble

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion, MakeCompanion


def gps(companion: Companion, *, lost: bool) -> None:
    seat = companion.vehicle.node.seat
    seat.fleet.sensors.troubles.put(seat.index, "test", Trouble(gps_lost=True) if lost else FINE)


def drain(companion: Companion, left: float) -> None:
    power = companion.vehicle.px4.power
    power.battery.drain(power.index, left)


class TestBattery:
    def test_it_drains_while_armed_as_recorded_and_fills_again(self, make_companion: MakeCompanion) -> None:
        """The recording's 60 s are its default."""
        companion = make_companion(params={"SIM_BAT_DRAIN": 16.0, "SIM_BAT_MIN_PCT": 40.0})
        companion.ready()
        assert companion.arm() == [0]
        companion.world.step(4.1)
        status = companion.vehicle.node.fields("BATTERY_STATUS")
        assert status is not None
        assert 15700 < status["voltages"][0] < 15800 and status["voltages"][1] == 65535
        assert (status["current_battery"], status["current_consumed"], status["charge_state"]) == (-100, 0, 1)
        companion.world.step(5.7)
        status = companion.vehicle.node.fields("BATTERY_STATUS")
        assert status is not None
        assert (status["voltages"][0], status["battery_remaining"]) == (15120, 40)
        assert companion.command(400, 0) == [0]
        companion.world.step(11.0)
        assert companion.all("SYS_STATUS")[-1]["battery_remaining"] == 100

    @pytest.mark.parametrize(
        ("action", "critical", "emergency"), [(0, "HOLD", "HOLD"), (2, "LAND", "LAND"), (3, "RTL", "LAND")]
    )
    def test_what_a_low_one_does_is_a_parameter(
        self, make_companion: MakeCompanion, action: int, critical: str, emergency: str
    ) -> None:
        companion = make_companion(params={"COM_FAIL_ACT_T": 0.0, "COM_LOW_BAT_ACT": float(action)})
        companion.beat()
        companion.put_up()
        drain(companion, 0.145)
        companion.world.step(0.2)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4
        assert "Failsafe activated\t" in companion.texts()
        drain(companion, 0.068)
        companion.world.step(0.2)
        assert companion.flying == critical
        drain(companion, 0.048)
        companion.world.step(0.2)
        assert companion.flying == emergency
        status = companion.vehicle.node.fields("BATTERY_STATUS")
        assert status is not None and status["charge_state"] == 4
        companion.world.step(2.0)
        told = companion.texts()
        assert [t for t in ("Low battery\t", "Critical battery\t", "Emergency battery level\t") if t in told]

    def test_a_weak_one_stands_against_arming(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"COM_ARM_BAT_MIN": 0.5})
        companion.ready()
        drain(companion, 0.3)
        companion.world.step(0.2)
        assert companion.arm() == [1]
        companion.vehicle.px4.params.set("COM_ARM_BAT_MIN", 0.2)
        assert companion.arm() == [0]

    def test_a_warning_that_was_there_at_arming_does_not_act(self, make_companion: MakeCompanion) -> None:
        params = {"COM_LOW_BAT_ACT": 3.0, "COM_FAIL_ACT_T": 0.0, "BAT_LOW_THR": 0.9, "BAT_CRIT_THR": 0.8}
        companion = make_companion(params=params)
        companion.ready()
        drain(companion, 0.75)  # critical
        companion.world.step(0.2)
        companion.put_up()
        companion.world.step(3.0)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4

    def test_of_its_own_body_it_is_measured(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(airframe="hexa")
        companion.put_up()
        companion.world.step(3.0)
        status = companion.all("BATTERY_STATUS")[-1]
        assert status["current_battery"] > 500 and status["current_consumed"] > 0
        assert 14000 < status["voltages"][0] < 16800


class TestPosition:
    def test_without_gps_hold_becomes_a_descent(self, companion: Companion) -> None:
        companion.beat()
        companion.put_up()
        companion.stream(2.0, companion.beat)
        gps(companion, lost=True)
        companion.world.step(4.5)
        assert companion.flying == "HOLD"
        companion.until(lambda: companion.flying == "DESCEND", 3.0)
        beat = companion.vehicle.node.fields("HEARTBEAT")
        assert beat is not None and (beat["custom_mode"], beat["system_status"]) == (4 << 16 | 6 << 24, 5)
        assert "GNSS data fusion stopped\t" in companion.texts()
        companion.clear()
        companion.until(lambda: not companion.vehicle.px4.armed, 30.0)
        assert not companion.all("GLOBAL_POSITION_INT") and not companion.all("LOCAL_POSITION_NED")
        flags = companion.all("ESTIMATOR_STATUS")[-1]["flags"]
        assert flags & (2 | 8 | 16) == 0 and flags & (1 | 4 | 32) == 37

    def test_when_it_is_back_the_mode_asked_for_flies_again(self, companion: Companion) -> None:
        companion.beat()
        companion.offboard(lambda: companion.position(0.0, 0.0, -30.0), 25.0)
        companion.until(lambda: companion.ned[2] < -25.0, say=lambda: companion.position(0.0, 0.0, -30.0))
        companion.mode(4, 3)
        gps(companion, lost=True)
        companion.until(lambda: companion.flying == "DESCEND", 8.0)
        gps(companion, lost=False)
        companion.until(lambda: companion.flying == "HOLD", 5.0)
        assert "GNSS data fusion started\t" in companion.texts()

    def test_a_mode_that_needs_a_position_cannot_be_had_without(self, companion: Companion) -> None:
        companion.put_up()
        gps(companion, lost=True)
        companion.world.step(5.5)
        assert companion.mode(4, 5) == [0, 1]
        assert companion.mode(4, 6) == [0, 0]  # a landing is never refused

    def test_posctl_falls_back_to_altctl_for_a_pilot(self, companion: Companion) -> None:
        def stick() -> None:
            companion.send("MANUAL_CONTROL", target=1, x=0, y=0, z=500, r=0, buttons=0)

        companion.put_up()
        companion.stream(0.5, stick)
        assert companion.mode(3) == [0, 0]
        gps(companion, lost=True)
        companion.stream(5.5, stick)
        assert companion.flying == "ALTCTL"
        current = companion.vehicle.node.fields("CURRENT_MODE")
        assert current is not None and current["intended_custom_mode"] == 3 << 16

    def test_arming_without_a_fix_is_a_parameter(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"COM_ARM_WO_GPS": 0.0})
        companion.ready()
        gps(companion, lost=True)
        companion.world.step(0.2)
        assert companion.arm() == [1]
        companion.vehicle.px4.params.set("COM_ARM_WO_GPS", 1.0)
        assert companion.arm() == [0]


class TestTakeover:
    def test_a_failsafe_waits_in_hold_and_says_so(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"NAV_DLL_ACT": 2.0, "COM_FAIL_ACT_T": 3.0})
        companion.beat()
        companion.put_up()
        companion.beat()
        companion.world.step(10.3)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 5
        assert "Failsafe activated, entering Hold for 3 seconds\t" in companion.texts()
        (event,) = [e for e in companion.all("EVENT") if e["id"] == event_id("commander_failsafe_enter_hold")]
        # HOLD asked for, RTL to come, in 3 s, for the ground station's sake.
        assert struct.unpack("<IBHB", bytes(event["arguments"][:8])) == (4 << 16 | 3 << 24, 6, 3, 2)
        companion.world.step(3.0)
        assert companion.flying == "RTL"
        assert "Connection to ground control station lost\t" in companion.texts()

    def test_who_changes_the_mode_has_the_vehicle(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"NAV_DLL_ACT": 2.0, "COM_FAIL_ACT_T": 0.0})
        companion.beat()
        companion.put_up()
        companion.beat()
        companion.world.step(10.5)
        assert companion.flying == "RTL"
        assert companion.mode(4, 3) == [0, 0]
        companion.world.step(2.0)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4

    def test_modes_can_be_excepted(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"NAV_DLL_ACT": 2.0, "COM_FAIL_ACT_T": 0.0, "COM_DLL_EXCEPT": 2.0})
        companion.beat()
        companion.put_up()
        companion.world.step(12.0)
        assert companion.flying == "HOLD"

    def test_the_worst_wins(self, make_companion: MakeCompanion) -> None:
        """A lost station asks for HOLD, an empty battery for LAND."""
        companion = make_companion(params={"COM_FAIL_ACT_T": 0.0, "NAV_DLL_ACT": 1.0, "COM_LOW_BAT_ACT": 2.0})
        companion.beat()
        companion.put_up()
        companion.until(lambda: companion.vehicle.px4.failsafe.active)
        assert companion.flying == "HOLD"
        drain(companion, 0.065)
        companion.world.step(0.2)
        assert companion.flying == "LAND"


class TestRadio:
    @pytest.mark.parametrize("action", [1, 2, 3])
    def test_its_loss_acts(self, make_companion: MakeCompanion, action: int) -> None:
        params = {"NAV_RCL_ACT": float(action), "COM_FLTMODE1": 2.0, "COM_FAIL_ACT_T": 0.0}
        companion = make_companion(params=params)
        companion.beat()
        companion.put_up()
        companion.vehicle.pilot_mode("POSCTL")
        companion.world.step(0.5)
        assert companion.flying == "POSCTL"
        companion.vehicle.px4.pilot.lose()
        companion.world.step(0.4)
        assert companion.flying == "POSCTL"
        companion.world.step(0.4)
        assert companion.flying == {1: "HOLD", 2: "RTL", 3: "LAND"}[action]
        assert "Manual control lost\t" in companion.texts()


def test_flight_termination_by_command_is_for_good(companion: Companion) -> None:
    companion.put_up()
    assert companion.command(185, 1) == [0]
    companion.world.step(0.1)
    assert companion.flying == "TERMINATION" and max(companion.vehicle.node.seat.outputs()) == 0.0
    assert companion.mode(4, 3)[-1] == 1


def test_the_report_of_the_checks_names_what_fails(companion: Companion) -> None:
    companion.ready()
    companion.world.step(4.0)
    companion.clear()
    gps(companion, lost=True)
    companion.world.step(8.0)
    events = {e["id"]: bytes(e["arguments"]) for e in companion.all("EVENT")}
    _, error, _, can_arm, _ = struct.unpack_from("<BIIII", events[event_id("commander_arming_check_summary")])
    assert error & 1 << 17 and error & 1 << 24  # the local and the global estimate
    assert not can_arm & (1 << 4 | 1 << 17) and can_arm & 1 << 12  # neither HOLD nor TAKEOFF, but DESCEND
    modes, component = struct.unpack_from("<IB", events[event_id("check_modes_local_pos")])
    assert component == 17 and modes & 1 << 4 and not modes & 1 << 10
