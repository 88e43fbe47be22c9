"""``zmav gimbal``: the words and the documents of what a gimbal does, and what cannot be asked together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.cli.conftest import zmav_here

if TYPE_CHECKING:
    from tests.cli.conftest import Vehicle
    from zmav.sim.protocol.gimbal import SimGimbal


@pytest.fixture
def gimbal(vehicle: Vehicle) -> Iterator[SimGimbal]:
    """One is fitted to the copter, for a test."""
    params, gimbal = vehicle.sim.brain.params, vehicle.sim.node.gimbal
    params.set("MNT1_TYPE", 1)
    gimbal.restart()
    yield gimbal
    params.set("MNT1_TYPE", 0)
    gimbal.restart()


def test_a_gimbal_from_the_shell(vehicle: Vehicle, gimbal: SimGimbal) -> None:
    do = vehicle.zmav
    (line,) = do("gimbal", "quad1", "--json").lines
    assert line["result"]["controller"] == "nobody"
    assert do("gimbal", "quad*", "--pitch", "-45", "--yaw", "30").out.startswith("quad1: gimbal_turn done")
    assert gimbal.angles == pytest.approx((math.radians(-45.0), math.radians(30.0)), abs=1e-3)
    (line,) = do("gimbal", "quad1", "--at", "-35.3630", "149.1655", "--alt", "0", "--json").lines
    assert line["result"]["at"] == "a place"
    assert "at a place" in do("gimbal", "quad1").out
    assert do("gimbal", "quad1", "--neutral").code == 0
    assert gimbal.angles == (0.0, 0.0)
    assert "controller nobody" in do("gimbal", "quad1", "--release").out
    gimbal.control = (255, 190)
    told = do.fails("gimbal", "quad1", "--pitch", "0")
    assert (told.code, "controlled by 255/190" in told.out) == (1, True)
    assert do("gimbal", "quad1", "--pitch", "0", "--take").code == 0
    do("gimbal", "quad1", "--release")


def test_none_is_an_error(vehicle: Vehicle) -> None:
    told = vehicle.zmav.fails("gimbal", "quad1", "--json")
    (line,) = told.lines
    assert (told.code, line["error"]) == (1, "refused")
    assert "no gimbal answers" in line["message"]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("--to 1,2,3 --neutral", "give one of --to"),
        ("--pitch 1 --release", "give one of --to"),
        ("--alt 3", "--alt goes with --at"),
        ("--yaw 3", "--yaw and --lock go with --pitch"),
        ("--take", "--take goes with what moves it"),
        ("--release --take", "--take goes with what moves it"),
        ("--pitch 400", "not in the range"),
        ("--pitch nan", "finite"),
        ("--at nan 0", "finite"),
    ],
)
def test_what_does_not_go_together(words: str, error: str) -> None:
    told = zmav_here("gimbal", "quad1", *words.split())
    assert told.code == 2
    assert error in told.err
