"""Commands by name: parameters by label or number, enum entries, and every fault named at once."""

from __future__ import annotations

import math

import pytest

from zmav.errors import BadInput
from zmav.mavlink import command_type, load_dialect


def fill(name: str, given: dict[str, float | str | None]) -> tuple[float, ...]:
    dialect = load_dialect()
    return command_type(dialect, name).fill(given, dialect)


@pytest.mark.parametrize("name", ["MAV_CMD_DO_CHANGE_SPEED", "do_change_speed", "Mav_Cmd_Do_Change_Speed"])
def test_names(name: str) -> None:
    kind = command_type(load_dialect(), name)
    assert (kind.name, kind.id, kind.has_location) == ("MAV_CMD_DO_CHANGE_SPEED", 178, False)
    assert [(p.label, p.units, p.enum) for p in kind.params[:2]] == [
        ("Speed Type", "", "SPEED_TYPE"),
        ("Speed", "m/s", ""),
    ]
    assert [p.reserved for p in kind.params] == [False] * 3 + [True] * 4


def test_every_command_of_the_dialect_is_known_with_its_number() -> None:
    dialect = load_dialect()
    for name, number in dialect.enums["MAV_CMD"].items():
        kind = command_type(dialect, name)
        assert (kind.id, [p.index for p in kind.params]) == (number, list(range(1, 8)))


@pytest.mark.parametrize(
    ("given", "params"),
    [
        ({}, (0, 0, 0, 0, 0, 0, 0)),
        ({"Speed": 5}, (0, 5, 0, 0, 0, 0, 0)),
        ({"speed type": "SPEED_TYPE_GROUNDSPEED", "param2": -1}, (1, -1, 0, 0, 0, 0, 0)),
        ({"SpeedType": "groundspeed", "PARAM3": 50}, (1, 0, 50, 0, 0, 0, 0)),
    ],
)
def test_parameters(given: dict[str, float | str | None], params: tuple[float, ...]) -> None:
    assert fill("DO_CHANGE_SPEED", given) == params


def test_flags_and_nothing() -> None:
    place = fill("DO_REPOSITION", {"Bitmask": "MAV_DO_REPOSITION_FLAGS_CHANGE_MODE | RELATIVE_YAW", "Yaw": None})
    assert place[1] == 3
    assert math.isnan(place[3])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"Spede": 5}, ["no parameter 'Spede'", "param2 'Speed' [m/s]"]),
        ({"param4": 1}, ["param4 is reserved"]),
        ({"param8": 1}, ["no parameter 'param8'"]),
        ({"Speed": -3}, ["Speed: -3 is below -2"]),
        ({"Speed": math.inf}, ["not finite"]),
        ({"SpeedType": "GROUNDSPED"}, ["did you mean", "SPEED_TYPE_GROUNDSPEED"]),
        ({"Speed": "fast"}, ["'FAST' is no entry of any enum"]),
        ({"Spede": 5, "param4": 1, "Throttle": -9}, ["'Spede'", "param4", "-9 is below -2"]),
    ],
)
def test_every_fault_is_named(given: dict[str, float | str | None], words: list[str]) -> None:
    with pytest.raises(BadInput) as caught:
        fill("DO_CHANGE_SPEED", given)
    assert [word for word in words if word not in caught.value.message] == []
    assert caught.value.detail["field"] == "params"


def test_a_name_nearly_right_is_suggested() -> None:
    with pytest.raises(BadInput, match="did you mean MAV_CMD_DO_CHANGE_SPEED"):
        command_type(load_dialect(), "DO_CHANG_SPEED")
