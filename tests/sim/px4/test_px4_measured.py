"""What was measured on PX4 1.16.1 and is easily taken for otherwise: intentions, sticks, arming, rates."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from tests.sim.px4.conftest import Companion
from tests.sim.px4.test_px4_mission import LAND, TAKEOFF, WAYPOINT, item, upload
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.sim.px4.conftest import MakeCompanion

NO_MISSION, NO_GROUND_STATION = 0x0105C2D9, 0x0167C97B
COMPANION = 18
QUATERNION = 31
OFFBOARD, HOLD = 6 << 16, 4 << 16 | 3 << 24


@pytest.mark.parametrize(("message", "hz", "verdict"), [(0, 5, 4), (42, 4, 4), (42, 1, 4), (436, 20, 0)])
def test_rates_of_some_messages_cannot_be_told(companion: Companion, message: int, hz: int, verdict: int) -> None:
    companion.ready()
    assert companion.command(511, message, 1e6 / hz) == [verdict]
    companion.clear()
    companion.world.step(2.0)
    assert abs(len(companion.all("HEARTBEAT")) - 2) <= 1
    assert abs(len(companion.all("CURRENT_MODE")) - (40 if message == 436 else 1)) <= 1


@pytest.mark.parametrize(("asked", "link", "given"), [(250, "onboard", 181), (100, "onboard", 100), (250, "pty", 250)])
def test_its_udp_links_take_so_many_a_second(asked: int, link: str, given: int) -> None:
    """In software in the loop; nothing says so: the rate is acknowledged, and told as it was asked for."""
    with closing(World([VehicleSpec(autopilot="px4", endpoints=())], epoch_s=0.0, tick_hz=500)) as world:
        reader = Companion(world, world.vehicles[0], link)
        world.step(2.0)
        assert reader.command(511, QUATERNION, 1e6 / asked) == [0]
        assert reader.command(510, QUATERNION) == [0]
        assert reader.all("MESSAGE_INTERVAL")[-1]["interval_us"] == round(1e6 / asked)
        reader.clear()
        world.step(4.0)
        assert len(reader.all("ATTITUDE_QUATERNION")) == pytest.approx(4 * given, abs=3)


def test_it_does_not_reboot_in_software_in_the_loop(companion: Companion) -> None:
    companion.ready()
    before = companion.vehicle.px4.uptime
    assert companion.command(246, 1) == [2]
    companion.world.step(1.0)
    assert companion.vehicle.px4.uptime > before


def test_in_the_air_offboard_is_entered_with_the_first_setpoint(companion: Companion) -> None:
    companion.put_up()
    companion.position(0.0, 0.0, -3.0)
    assert companion.mode(6) == [0, 0]
    companion.world.step(0.05)
    assert companion.flying == "OFFBOARD"


def test_a_lost_stream_leaves_offboard_intended_and_it_comes_back_with_the_next_setpoint(
    make_companion: MakeCompanion,
) -> None:
    companion = make_companion(params={"COM_OBL_RC_ACT": 5.0})
    companion.offboard(lambda: companion.position(0.0, 0.0, -5.0), 5.0)
    companion.stream(2.0, lambda: companion.position(0.0, 0.0, -5.0))
    companion.command(511, 436, 50000)
    companion.world.step(10.0)  # 30 s were measured; what comes after COM_FAIL_ACT_T, 5 s, lasts
    told = companion.all("CURRENT_MODE")[-1]
    assert (told["custom_mode"], told["intended_custom_mode"]) == (HOLD, OFFBOARD)
    companion.stream(0.2, lambda: companion.position(0.0, 0.0, -5.0))
    assert companion.flying == "OFFBOARD"


def test_armed_in_a_mission_that_was_flown_it_takes_off(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"MPC_LAND_SPEED": 2.0, "MPC_LAND_CRWL": 1.0})
    companion.ready()
    upload(companion, [item(companion, TAKEOFF, up=4.0), item(companion, WAYPOINT, 5.0), item(companion, LAND, up=0.0)])
    assert companion.mode(4, 4) == [0, 0]
    for _ in range(2):
        assert companion.arm() == [0]
        companion.until(lambda: not companion.vehicle.px4.landed, 20.0)
        companion.until(lambda: not companion.vehicle.px4.armed)
        assert companion.flying == "MISSION"


def test_without_a_mission_it_is_not_armed_in_mission(companion: Companion) -> None:
    companion.ready()
    upload(companion, [])
    assert companion.mode(4, 4) == [0, 0]
    companion.world.step(3.0)
    assert companion.arm() == [1]
    assert NO_MISSION in companion.events()


def test_it_waits_for_a_ground_station_where_that_is_asked_for(make_companion: MakeCompanion) -> None:
    companion = make_companion(params={"NAV_DLL_ACT": 2.0})
    for _ in range(12):
        companion.beat(COMPANION)
        companion.world.step(0.5)
    assert not companion.vehicle.px4.checks_ok and companion.arm() == [1]
    companion.beat()
    companion.world.step(0.5)
    assert companion.arm() == [0]


def sticks(companion: Companion, pitch: float) -> None:
    companion.send("MANUAL_CONTROL", target=companion.vehicle.sysid, x=round(pitch * 1000), y=0, z=500, r=0)


def test_sticks_held_in_hold_move_nothing_and_their_end_is_a_lost_pilot(companion: Companion) -> None:
    companion.put_up()
    before = companion.ned
    companion.stream(3.0, lambda: sticks(companion, 0.5))
    assert companion.flying == "HOLD" and companion.near(*before, 0.3)
    companion.world.step(4.0)
    assert (companion.flying, companion.vehicle.px4.system_status) == ("HOLD", 5)
    companion.world.step(3.0)
    assert companion.flying == "RTL"


def test_a_mode_ordered_again_keeps_the_end_of_the_sticks_from_sending_it_home(companion: Companion) -> None:
    companion.put_up()
    companion.stream(0.5, lambda: sticks(companion, 0.0))
    assert companion.mode(3) == [0, 0]
    companion.stream(2.0, lambda: sticks(companion, 0.5))
    companion.world.step(0.5)
    assert companion.mode(4, 3) == [0, 0]
    companion.until(lambda: companion.vehicle.px4.system_status == 5, 5.0)
    assert companion.mode(4, 3) == [0, 0]
    companion.world.step(8.0)  # COM_FAIL_ACT_T is 5 s
    assert (companion.flying, companion.vehicle.px4.system_status) == ("HOLD", 4)


def test_a_stick_that_moves_takes_over(companion: Companion) -> None:
    companion.put_up()
    companion.stream(1.0, lambda: sticks(companion, 0.0))
    companion.stream(0.2, lambda: sticks(companion, 0.5))
    assert companion.flying == "POSCTL"
