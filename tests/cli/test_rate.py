"""``zmav rate`` and ``zmav echo --rate``: what flows, and a message that flows because somebody wants it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav.errors import BadInput, NoSuchVehicle

if TYPE_CHECKING:
    from tests.cli.conftest import StartProcess, Vehicle

PATIENCE_S = 30.0


def table(vehicle: Vehicle) -> dict[str, Any]:
    (found,) = vehicle.zmav("rate", "quad1", "--json").lines
    return found


def row(vehicle: Vehicle, name: str) -> dict[str, Any]:
    return next((m for m in table(vehicle)["messages"] if m["name"] == name), {})


def until(vehicle: Vehicle, name: str, least_hz: float = 0.0, **same: Any) -> dict[str, Any]:
    """The row of a message, once it is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not same.items() <= (found := row(vehicle, name)).items() or found["hz"] < least_hz:
        assert time.monotonic() < deadline, f"{name} is {found}"
    return found


@pytest.mark.usefixtures("hurried")
def test_the_table_shows_what_comes_and_for_whom(vehicle: Vehicle) -> None:
    found = until(vehicle, "ATTITUDE", readers=["floor"], wanted_hz=10.0, least_hz=10.1)
    assert (found["sysid"], found["compid"], found["shed"]) == (1, 1, False)
    assert found["bytes_rate"] > 12 * found["hz"]
    whole = table(vehicle)
    assert whole["capacity"] is None
    told = vehicle.zmav("rate", "quad1")
    assert told.out.split()[:9] == ["message", "from", "Hz", "B/s", "count", "age", "asked", "wanted", "for"]
    line = next(line for line in told.out.splitlines() if line.startswith("ATTITUDE "))
    assert line.split()[1] == "1/1"
    assert line.split()[7:] == ["10.0", "floor"]
    assert " bytes/s" in told.err


def test_echo_has_its_message_sent(vehicle: Vehicle) -> None:
    told = vehicle.zmav("echo", "quad*/VIBRATION", "--rate", "10", "-n", "2", "--json")
    assert [line["message"]["name"] for line in told.lines] == ["VIBRATION"] * 2
    assert vehicle.zmav("echo", "quad1/VIBRATION", "-n", "1").out.startswith("zmav/demo/quad1/mav/rx/1/1/VIBRATION")
    until(vehicle, "VIBRATION", wanted_hz=None, asked_hz=None)


def test_an_interrupt_lets_it_go(vehicle: Vehicle, start: StartProcess) -> None:
    holding = start("echo", "quad1/WIND", "--rate", "5", "-e", vehicle.endpoint)
    until(vehicle, "WIND", wanted_hz=5.0, asked_hz=5.0)
    assert holding.stop(2) == 130
    until(vehicle, "WIND", wanted_hz=None, asked_hz=None)


def test_what_cannot_be_is_said(vehicle: Vehicle) -> None:
    fails = vehicle.zmav.fails
    assert isinstance(fails("echo", "quad1/ATTITUDE", "--rate", "0").error, BadInput)
    assert isinstance(fails("echo", "quad1/ATTITUDE", "--rate", "501").error, BadInput)
    assert isinstance(fails("echo", "quad1", "--rate", "5").error, BadInput)
    assert isinstance(fails("rate", "nobody").error, NoSuchVehicle)
    vehicle.zmav.misused("echo", "quad1/ATTITUDE", "--rate", "often")


@pytest.mark.parametrize("words", ["quad1/ATTITUDE --rate 50", "zmav rate quad1"])
def test_the_help_has_an_example(vehicle: Vehicle, words: str) -> None:
    assert words in " ".join(vehicle.zmav("rate", "--help").out.split())
