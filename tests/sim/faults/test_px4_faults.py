"""Faults as a companion of a PX4 sees them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from tests.sim.px4.conftest import Companion
from zmav.sim import VehicleSpec, World

GLITCH, POSITIONS, VELOCITY = 0x400, 0x8 | 0x10 | 0x100 | 0x200, 0x2


@pytest.fixture
def aloft() -> Iterator[Companion]:
    """A PX4 that hovers in HOLD, 2.5 m up."""
    spec = VehicleSpec(autopilot="px4", name="p", params={"COM_FLTMODE1": 2.0, "COM_FLTMODE6": 4.0})
    world = World([spec], ready_s=1.0, epoch_s=0.0)
    companion = Companion(world, world.vehicles[0])
    companion.beat()
    companion.take_off()
    companion.clear()
    yield companion
    world.close()


def wait(companion: Companion, seconds: float) -> None:
    for _ in range(round(seconds * 2)):
        companion.beat()
        companion.world.step(0.5)


def status(companion: Companion) -> dict[str, float]:
    found: dict[str, float] = companion.all("ESTIMATOR_STATUS")[-1]
    return found


def test_without_gps_the_position_is_given_up_after_five_seconds(aloft: Companion) -> None:
    aloft.world.fault("p", "gps-loss")
    wait(aloft, 4.5)
    assert int(status(aloft)["flags"]) & POSITIONS == POSITIONS
    assert aloft.all("GPS_RAW_INT")[-1]["fix_type"] == 1
    before = aloft.all("HEARTBEAT")[-1]["custom_mode"]
    wait(aloft, 3.0)
    flags = int(status(aloft)["flags"])
    assert flags & (POSITIONS | VELOCITY) == 0
    assert aloft.vehicle.px4.failsafe.active
    assert aloft.all("HEARTBEAT")[-1]["custom_mode"] != before
    assert aloft.all("HEARTBEAT")[-1]["system_status"] == 5


def test_a_glitch_is_rejected_and_followed_after_seven(aloft: Companion) -> None:
    start = aloft.vehicle.px4.local[0]
    aloft.world.fault("p", "gps-glitch", north=30.0)
    wait(aloft, 3.0)
    assert status(aloft)["pos_horiz_ratio"] > 5.0
    assert int(status(aloft)["flags"]) & GLITCH
    assert aloft.vehicle.px4.local[0] == pytest.approx(start, abs=0.3)
    wait(aloft, 6.0)
    assert aloft.vehicle.px4.local[0] == pytest.approx(start + 30.0, abs=0.5)
    assert abs(aloft.vehicle.px4.sense.true_north - start) < 0.6  # it has not darted off
    assert status(aloft)["pos_horiz_ratio"] < 0.2
    assert int(status(aloft)["flags"]) & GLITCH == 0


def test_a_compass_error_turns_it(aloft: Companion) -> None:
    yaw = aloft.vehicle.px4.sense.yaw
    aloft.world.fault("p", "compass", degrees=20.0)
    wait(aloft, 10.0)
    w, x, y, z = aloft.vehicle.node.seat.fleet.dynamics.q[:, 0].tolist()
    true_yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    assert aloft.vehicle.px4.sense.yaw == pytest.approx(yaw, abs=0.05)
    assert true_yaw == pytest.approx(yaw - math.radians(20.0), abs=0.08)


def test_sensors_show_in_highres_imu(aloft: Companion) -> None:
    aloft.world.step(0.1)
    calm = aloft.all("HIGHRES_IMU")[-1]
    aloft.world.fault("p", "baro", metres=20.0)
    aloft.world.fault("p", "imu", vibration=30.0)
    aloft.clear()
    aloft.world.step(1.0)
    seen = aloft.all("HIGHRES_IMU")
    assert seen[0]["pressure_alt"] - calm["pressure_alt"] == pytest.approx(20.0, abs=1.5)
    spread = [m["zacc"] for m in seen]
    assert max(spread) - min(spread) > 40.0


def test_a_pilot_who_is_not_heard_turns_his_switch_in_vain(aloft: Companion) -> None:
    world, px4 = aloft.world, aloft.vehicle.px4
    world.take("p", None, {5: 1800})
    wait(aloft, 1.0)
    assert px4.sticks.alive
    world.fault("p", "rc-loss")
    wait(aloft, 2.0)
    world.take("p", "POSCTL", {})
    wait(aloft, 1.0)
    assert not px4.sticks.alive and aloft.flying == "HOLD"
    world.clear("p")
    wait(aloft, 1.0)
    assert px4.sticks.alive and aloft.flying == "POSCTL"


def test_a_radio_that_is_switched_on_while_it_is_not_heard_is_heard_afterwards(aloft: Companion) -> None:
    aloft.world.fault("p", "rc-loss")
    aloft.world.take("p", None, {5: 1600})
    wait(aloft, 1.0)
    assert not aloft.vehicle.px4.sticks.alive
    aloft.world.clear("p")
    wait(aloft, 1.0)
    assert aloft.vehicle.px4.sticks.alive


def test_a_radio_is_as_it_was_after_a_reboot(aloft: Companion) -> None:
    world, px4 = aloft.world, aloft.vehicle.px4
    world.take("p", None, {5: 1800})
    world.fault("p", "rc-loss")
    world.fault("p", "reboot")
    wait(aloft, 2.0)
    world.take("p", None, {5: 1165})
    wait(aloft, 1.0)
    assert not px4.sticks.alive
    world.clear("p", "rc-loss")
    wait(aloft, 1.0)
    assert px4.sticks.alive


def test_it_hangs_and_is_reset(aloft: Companion) -> None:
    aloft.world.fault("p", "frozen")
    aloft.clear()
    aloft.world.step(1.9)
    assert aloft.heard == []
    aloft.world.fault("p", "reboot")
    aloft.world.step(0.5)
    assert aloft.heard[0][1].seq == 0
    assert not aloft.vehicle.px4.armed


def test_noise_does_not_keep_it_from_flying() -> None:
    world = World([VehicleSpec(autopilot="px4", name="p")], ready_s=1.0, epoch_s=0.0, noise="typical")
    companion = Companion(world, world.vehicles[0])
    companion.take_off()
    wait(companion, 5.0)
    fixes = companion.all("GPS_RAW_INT")
    assert len({m["lat"] for m in fixes[-40:]}) > 5
    sense = companion.vehicle.px4.sense
    assert -sense.true_down == pytest.approx(2.5, abs=1.5)
    assert math.hypot(sense.true_north, sense.true_east) < 4.0
    world.close()
