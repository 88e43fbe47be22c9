"""The camera that a simulated ArduPilot triggers by distance, told as AP_Camera tells it."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import pytest

from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

ACCEPTED = 0
TRIGGER = 206
SERVO = {"CAM1_TYPE": 1.0}


def pictures(gcs: Gcs) -> list[dict[str, float]]:
    return gcs.all("CAMERA_FEEDBACK")


@pytest.mark.parametrize("autopilot", ["arducopter", "arduplane", "ardurover"])
def test_one_at_once_and_none_where_it_stands(make_gcs: MakeGcs, autopilot: str) -> None:
    gcs = make_gcs([VehicleSpec(autopilot=autopilot, params=SERVO)])
    gcs.world.step(5.0)
    assert gcs.command(TRIGGER, 5.0, 0.0, 1.0) == ACCEPTED
    gcs.world.step(5.0)
    (one,) = pictures(gcs)
    assert (one["img_idx"], one["completed_captures"], one["cam_idx"]) == (1, 1, 0)
    home = gcs.vehicle.brain.place(gcs.vehicle.brain.home_world)
    assert one["lat"] / 1e7 == pytest.approx(home.lat_deg, abs=1e-5)
    assert one["alt_msl"] == pytest.approx(home.alt_amsl_m, abs=1.0)


def test_without_a_camera_the_command_is_accepted_and_nothing_comes_of_it(gcs: Gcs) -> None:
    """As ArduPilot does: its AP_Camera has no backend then, and says so to nobody."""
    gcs.world.step(5.0)
    assert gcs.command(TRIGGER, 5.0, 0.0, 1.0) == ACCEPTED
    gcs.world.step(1.0)
    assert pictures(gcs) == []


def test_pictures_as_far_apart_as_asked_until_there_shall_be_no_more(make_gcs: MakeGcs) -> None:
    gcs = make_gcs([VehicleSpec(params=SERVO)])
    gcs.world.step(5.0)
    gcs.put_up(10.0)
    gcs.command(TRIGGER, 4.0)
    gcs.goto(40.0, 0.0, -10.0)
    gcs.world.step(20.0)
    taken = pictures(gcs)
    assert len(taken) == 9  # at 4, 8... 36 m; the last is where it comes to rest, or just before
    steps = [(b["lat"] - a["lat"]) / 1e7 * math.radians(6371000.0) for a, b in itertools.pairwise(taken)]
    assert steps == pytest.approx([4.0] * len(steps), abs=0.2)
    assert {round(each["alt_rel"]) for each in taken} == {10}
    assert gcs.command(TRIGGER, 0.0) == ACCEPTED
    gcs.goto(0.0, 0.0, -10.0)
    gcs.world.step(20.0)
    assert len(pictures(gcs)) == len(taken)
