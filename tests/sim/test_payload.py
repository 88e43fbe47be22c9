"""Servos of the simulated ArduCopter, and gimbals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

ACCEPTED, DENIED, FAILED = 0, 2, 4
SERVO = 183


@pytest.fixture
def ready(gcs: Gcs) -> Gcs:
    gcs.world.step(1.0)
    return gcs


def servo(gcs: Gcs, number: int) -> int:
    return int(gcs.last("SERVO_OUTPUT_RAW")[f"servo{number}_raw"])


class TestServos:
    def test_free_outputs_can_be_set(self, ready: Gcs) -> None:
        assert servo(ready, 9) == 0
        assert ready.command(SERVO, 9, 1600) == ACCEPTED
        assert servo(ready, 9) == 1600

    @pytest.mark.parametrize("number", [1, 4])
    def test_motors_cannot(self, ready: Gcs, number: int) -> None:
        assert ready.command(SERVO, number, 1600) == FAILED
        assert ready.texts()[-1] == f"ServoRelayEvent: Channel {number} is already in use"
        assert servo(ready, number) == 1000

    @pytest.mark.parametrize("number", [0, 17, 40, -3])
    def test_nor_what_there_is_not(self, ready: Gcs, number: int) -> None:
        assert ready.command(SERVO, number, 1600) == FAILED

    def test_the_function_decides(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(params={"SERVO9_FUNCTION": 7, "SERVO10_FUNCTION": 28})])
        assert gcs.command(SERVO, 9, 1600) == FAILED
        assert gcs.command(SERVO, 10, 1600) == ACCEPTED


class TestGimbals:
    @pytest.fixture
    def fitted(self, make_gcs: MakeGcs) -> Gcs:
        gcs = make_gcs([VehicleSpec(params={"MNT1_TYPE": 1})])
        gcs.world.step(1.0)
        return gcs

    def test_an_attitude_that_is_none_turns_nothing(self, fitted: Gcs) -> None:
        for q in ([math.nan] * 4, [math.inf] * 4, [math.nan, 0.0, 0.0, 1.0]):
            fitted.send("GIMBAL_MANAGER_SET_ATTITUDE", q=q)
        assert fitted.vehicle.node.gimbal.angles == (0.0, 0.0)

    def test_flags_that_are_no_number_are_answered(self, fitted: Gcs) -> None:
        assert fitted.command(1000, -10.0, 0.0, 0.0, 0.0, math.nan) == DENIED
