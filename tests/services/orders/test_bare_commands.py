"""A MAV_CMD by its name does nothing that its verb would refuse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.services.conftest import ARM, GUIDED, SET_MODE
from zmav.errors import BadInput, Refused

if TYPE_CHECKING:
    from tests.services.conftest import StartBench


@pytest.mark.parametrize(
    ("kind", "mode", "enters"),
    [(2, 3, "GUIDED"), (10, 10, "HOLD"), (10, 15, "HOLD")],
    ids=["copter in AUTO", "rover in AUTO", "rover in GUIDED"],
)
async def test_what_would_set_off_is_not_armed_by_a_bare_command(
    bench: StartBench, kind: int, mode: int, enters: str
) -> None:
    """A rover in GUIDED drives on to the target it had there before."""
    b = await bench(mav_type=kind)
    await b.connected()
    b.peer.mode = mode
    await b.state(lambda s: s["mode"] == {3: "AUTO", 10: "AUTO", 15: "GUIDED"}[mode], "that mode")
    with pytest.raises(Refused, match=f"'arm' enters {enters} first"):
        await b.ground.do("command", command="COMPONENT_ARM_DISARM", params={"param1": 1.0})
    assert (b.peer.commands(ARM), b.peer.armed) == ([], False)
    await b.ground.do("arm", ready_timeout=0)
    assert b.peer.armed
    assert b.peer.mode == {"GUIDED": GUIDED, "HOLD": 4}[enters]
    assert b.peer.commands(SET_MODE)[0].at < b.peer.commands(ARM)[0].at


WHOLE = "a whole number"


@pytest.mark.parametrize(
    ("function", "why"),
    [
        pytest.param(16.0, "arm, disarm and set_mode are orders", id="AUTO"),
        pytest.param(153.0, "arm, disarm and set_mode are orders", id="arm or disarm"),
        pytest.param(153.5, WHOLE, id="cut to arm or disarm"),
        pytest.param(65536.0 + 153.0, WHOLE, id="with more bits than it has"),
        pytest.param(-0.5, WHOLE, id="below all of them"),
        pytest.param(None, WHOLE, id="NaN"),
    ],
)
async def test_a_switch_of_the_pilot_s_that_has_a_verb_is_not_turned_by_a_bare_command(
    bench: StartBench, function: float | None, why: str
) -> None:
    """By it ArduPilot disarms in the air, too, and flies a mission whose places nobody has judged."""
    b = await (await bench()).flying()
    with pytest.raises(BadInput, match=why):
        await b.ground.do("command", command="DO_AUX_FUNCTION", params={"param1": function, "param2": 0.0})
    assert b.peer.commands(AUX_FUNCTION) == []
    await b.ground.do("command", command="DO_AUX_FUNCTION", params={"param1": 19.0, "param2": 2.0})  # a gripper
    assert b.peer.commands(AUX_FUNCTION)


AUX_FUNCTION, STANDARD_MODE, MISSION = 218, 262, 6.0
GENERIC, ARDUPILOT, PX4 = 0, 3, 12
"""MAV_AUTOPILOT"""


async def test_a_mode_that_nobody_knows_is_not_entered_by_a_bare_command(bench: StartBench) -> None:
    b = await (await bench()).flying()
    with pytest.raises(BadInput, match=r"no mode is known that .* enters: set_mode enters one by its name"):
        await b.ground.do("command", command="DO_SET_MODE", params={"param1": 1.0, "param2": 77.0})
    assert b.peer.commands(SET_MODE) == []


async def test_where_no_mode_is_known_one_is_entered_with_force_alone(bench: StartBench) -> None:
    """It may be the one that flies a mission, whose places nobody has judged."""
    b = await (await bench(autopilot=GENERIC)).connected()
    params = {"param1": 1.0, "param2": 3.0}
    with pytest.raises(BadInput, match=r"no mode is known that .* enters on this generic copter.*--force"):
        await b.ground.do("command", command="DO_SET_MODE", params=params)
    assert b.peer.commands(SET_MODE) == []
    await b.ground.do("command", command="DO_SET_MODE", params=params, force=True)
    assert b.peer.commands(SET_MODE)


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4, GENERIC])
async def test_a_standard_mode_is_not_entered_by_a_bare_command(bench: StartBench, autopilot: int) -> None:
    """One of them flies the mission, whose places nobody would have judged."""
    b = await (await bench(autopilot=autopilot)).connected()
    with pytest.raises(BadInput, match="standard modes are not judged: set_mode enters one by its name"):
        await b.ground.do("command", command="DO_SET_STANDARD_MODE", params={"param1": MISSION})
    assert b.peer.commands(STANDARD_MODE) == []
