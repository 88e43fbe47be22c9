"""Servos, relays, gimbal and camera of the simulated ArduCopter."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tests.sim.plans import at, do, fly, reached, takeoff
from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Desk, MakeDesk

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
SERVO, RELAY, SHOOT, DISTANCE, START, STOP, MOUNT, GIMBAL = 183, 181, 203, 206, 2000, 2001, 205, 1000


@pytest.fixture
def ready(desk: Desk) -> Desk:
    desk.world.step(1.0)
    return desk


@pytest.fixture
def equipped(make_desk: MakeDesk) -> Desk:
    """With a camera and a gimbal."""
    desk = make_desk([VehicleSpec(params={"CAM1_TYPE": 1, "MNT1_TYPE": 1})])
    desk.world.step(1.0)
    return desk


def servo(desk: Desk, number: int) -> int:
    return int(desk.last("SERVO_OUTPUT_RAW")[f"servo{number}_raw"])


class TestServos:
    def test_free_outputs_can_be_set(self, ready: Desk) -> None:
        assert servo(ready, 9) == 0
        assert ready.command(SERVO, 9, 1600) == ACCEPTED
        assert servo(ready, 9) == 1600

    @pytest.mark.parametrize("number", [1, 4])
    def test_motors_cannot(self, ready: Desk, number: int) -> None:
        assert ready.command(SERVO, number, 1600) == FAILED
        assert ready.texts()[-1] == f"ServoRelayEvent: Channel {number} is already in use"
        assert servo(ready, number) == 1000

    @pytest.mark.parametrize("number", [0, 17, 40, -3])
    def test_nor_what_there_is_not(self, ready: Desk, number: int) -> None:
        assert ready.command(SERVO, number, 1600) == FAILED

    def test_the_function_decides(self, make_desk: MakeDesk) -> None:
        desk = make_desk([VehicleSpec(params={"SERVO9_FUNCTION": 7, "SERVO10_FUNCTION": 28})])
        assert desk.command(SERVO, 9, 1600) == FAILED
        assert desk.command(SERVO, 10, 1600) == ACCEPTED


class TestRelays:
    def test_are_switched_and_toggled(self, ready: Desk) -> None:
        assert ready.last("RELAY_STATUS")["present"] == 1
        for state, on in ((1, 1), (0, 0), (2, 1), (2, 0)):
            assert ready.command(RELAY, 0, state) == ACCEPTED
            assert ready.last("RELAY_STATUS")["on"] == on

    @pytest.mark.parametrize("number", [1, 6, -1])
    def test_only_those_that_are_set_up(self, ready: Desk, number: int) -> None:
        assert ready.command(RELAY, number, 1) == FAILED


class TestGimbal:
    def status(self, desk: Desk) -> tuple[float, float]:
        """Pitch and yaw, degrees."""
        w, x, y, z = desk.last("GIMBAL_DEVICE_ATTITUDE_STATUS")["q"]
        pitch = math.asin(max(min(2 * (w * y - z * x), 1.0), -1.0))
        return math.degrees(pitch), math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def test_there_is_none_by_default(self, ready: Desk) -> None:
        assert ready.command(GIMBAL, -30.0, 20.0, math.nan, math.nan) == FAILED
        assert ready.command(MOUNT, -30.0, 0.0, 20.0, 0, 0, 0, 2) == FAILED

    def test_points_where_it_is_told(self, equipped: Desk) -> None:
        assert equipped.command(GIMBAL, -30.0, 20.0, math.nan, math.nan) == ACCEPTED
        assert self.status(equipped) == pytest.approx((-30.0, 20.0), abs=0.01)
        assert equipped.command(MOUNT, -45.0, 0.0, -10.0, 0, 0, 0, 2) == ACCEPTED
        assert self.status(equipped) == pytest.approx((-45.0, -10.0), abs=0.01)
        assert equipped.command(GIMBAL, 0, 0, 0, 0, 2) == ACCEPTED  # neutral
        assert self.status(equipped) == pytest.approx((0.0, 0.0), abs=0.01)

    def test_turns_at_a_rate(self, equipped: Desk) -> None:
        assert equipped.command(GIMBAL, math.nan, math.nan, -10.0, 5.0) == ACCEPTED
        equipped.world.step(3.0)
        assert self.status(equipped) == pytest.approx((-30.0, 15.0), abs=1.5)
        equipped.world.step(20.0)
        assert self.status(equipped)[0] == pytest.approx(-90.0, abs=0.1)

    @pytest.mark.parametrize("p", [(math.nan, 5.0, math.nan, 1.0), (5.0, math.nan, 1.0, math.nan)])
    def test_needs_whole_angles_or_rates(self, equipped: Desk, p: tuple[float, ...]) -> None:
        assert equipped.command(GIMBAL, *p) == FAILED

    def test_keeps_a_region_of_interest(self, equipped: Desk) -> None:
        equipped.take_off(10.0)
        x, y = at(16, 10, 0)["x"], at(16, 10, 0)["y"]
        assert equipped.command_int(195, x=x, y=y, z=0.0, frame=6) == ACCEPTED
        equipped.world.step(0.5)
        assert self.status(equipped) == pytest.approx((-45.0, 0.0), abs=1.5)
        assert equipped.command(197) == ACCEPTED

    def test_without_one_the_nose_does(self, ready: Desk) -> None:
        ready.take_off(3.0)
        x, y = at(16, 0, 20)["x"], at(16, 0, 20)["y"]
        assert ready.command_int(195, x=x, y=y, z=0.0, frame=6) == ACCEPTED
        ready.world.step(4.0)
        assert ready.vehicle.copter.sense.yaw == pytest.approx(math.pi / 2, abs=0.1)


class TestCamera:
    def test_there_is_none_by_default(self, ready: Desk) -> None:
        assert ready.command(SHOOT, 0, 0, 0, 0, 1) == ACCEPTED  # whatever comes of it
        assert ready.command(START, 0, 0, 1) == FAILED
        assert ready.all("CAMERA_FEEDBACK") == []

    def test_each_picture_is_told(self, equipped: Desk) -> None:
        assert equipped.command(SHOOT, 0, 0, 0, 0, 1) == ACCEPTED
        assert equipped.command(START, 0, 0, 1) == ACCEPTED
        first, second = equipped.all("CAMERA_FEEDBACK")
        assert (first["img_idx"], second["img_idx"]) == (1, 2)
        assert first["lat"] == at(16, 0, 0)["x"]

    def test_a_series(self, equipped: Desk) -> None:
        assert equipped.command(START, 0, 0.5, 3) == ACCEPTED
        equipped.world.step(5.0)
        assert len(equipped.all("CAMERA_FEEDBACK")) == 3
        assert equipped.command(START, 0, 0.5, 0) == ACCEPTED
        equipped.world.step(2.2)
        assert equipped.command(STOP) == ACCEPTED
        taken = len(equipped.all("CAMERA_FEEDBACK"))
        assert taken >= 6
        equipped.world.step(2.0)
        assert len(equipped.all("CAMERA_FEEDBACK")) == taken

    def test_by_distance_on_a_mission(self, equipped: Desk) -> None:
        fly(equipped, [takeoff(4.0), do(206, 5.0), at(16, 21, 0, 4), do(206, 0.0), at(16, 40, 0, 4)])
        equipped.until(lambda: 5 in reached(equipped))
        places = [(m["lat"] - at(16, 0, 0)["x"]) * 1e-7 * 111318.845 for m in equipped.all("CAMERA_FEEDBACK")]
        assert places == pytest.approx([5.0, 10.0, 15.0, 20.0], abs=1.5)
