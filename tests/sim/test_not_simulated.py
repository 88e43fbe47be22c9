"""What a real autopilot can do and this one leaves out is refused, and it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.sim.plans import do, upload
from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import MakeGcs

UNSUPPORTED, FAILED = 3, 4
MODES = (
    ("arducopter", 1, "ACRO"),
    ("arducopter", 7, "CIRCLE"),
    ("arducopter", 16, "POSHOLD"),
    ("arducopter", 21, "SMARTRTL"),
    ("ardurover", 1, "ACRO"),
    ("ardurover", 12, "SMART_RTL"),
    ("arduplane", 2, "STABILIZE"),
    ("arduplane", 8, "AUTOTUNE"),
)


@pytest.mark.parametrize(("autopilot", "number", "name"), MODES)
def test_a_mode(make_gcs: MakeGcs, autopilot: str, number: int, name: str) -> None:
    gcs = make_gcs([VehicleSpec(autopilot=autopilot)])
    gcs.world.step(1.0)
    before = gcs.vehicle.brain.mode
    assert gcs.command(176, 1, number) == UNSUPPORTED
    assert gcs.texts()[-1] == f"{name} is not simulated"
    assert gcs.vehicle.brain.mode is before
    assert gcs.command(176, 1, 99) == FAILED
    assert gcs.texts()[-1] == "No such mode 99"


@pytest.mark.parametrize(
    ("autopilot", "number"),
    [("arducopter", 209), ("ardurover", 194), ("arduplane", 43000), ("arducopter", 2000), ("arducopter", 193)],
)
def test_a_command(make_gcs: MakeGcs, autopilot: str, number: int) -> None:
    gcs = make_gcs([VehicleSpec(autopilot=autopilot)])
    assert gcs.command(number, 1, 0, 10, 1) == UNSUPPORTED
    assert gcs.texts()[-1] == f"MAV_CMD {number} is not simulated"


def test_a_mission_item(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    assert upload(gcs, [do(222, 3.0)]) == UNSUPPORTED
    assert gcs.texts()[-1] == "Mission: MAV_CMD 222 is not simulated"
