"""Nothing is armed that has not shown that it flies a simulation."""

from __future__ import annotations

import pytest

from agents.hil.proof import ardupilot_simulates, px4_simulates
from zmav.errors import Refused
from zmav.mavlink.paramvalue import Value

SIMULATING: dict[str, Value] = {
    **{f"SIM_X{i}": 0.0 for i in range(20)},
    "SIM_OH_MASK": 0,
    "INS_ACC_ID": 2753028,
    "INS_ACC2_ID": 2753036,
    "INS_ACC3_ID": 0,
    "INS_GYR_ID": 2752772,
    "INS_GYR2_ID": 2752780,
    "INS_GYR3_ID": 0,
}
HIL = "MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | MAV_MODE_FLAG_HIL_ENABLED"


def test_an_ardupilot_that_simulates_on_board() -> None:
    proof = ardupilot_simulates(SIMULATING)
    assert len(proof) == 2 and "bus type SITL" in proof[1]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({name: None for name in SIMULATING if name.startswith("SIM_")}, "0 SIM_ parameters"),
        ({"SIM_OH_MASK": None}, "not built for simulation"),
        ({"SIM_OH_MASK": 15}, "it drives real outputs"),
        ({"INS_ACC_ID": None}, "no accelerometer"),
        ({"INS_GYR_ID": 0}, "no gyroscope"),
        ({"INS_ACC_ID": 2753026}, "not simulated: INS_ACC_ID 2753026"),  # the same on SPI
        ({"INS_GYR3_ID": 2752769}, "not simulated: INS_GYR3_ID"),  # one real gyroscope among simulated ones
    ],
)
def test_one_that_may_be_real_is_refused(changed: dict[str, Value], why: str) -> None:
    params = {**SIMULATING, **changed}
    with pytest.raises(Refused, match=why):
        ardupilot_simulates({name: value for name, value in params.items() if value is not None})


def test_a_px4_in_hitl() -> None:
    assert len(px4_simulates({"SYS_HITL": 1}, HIL)) == 2


@pytest.mark.parametrize(
    ("params", "base_mode", "why"),
    [
        ({}, HIL, "no SYS_HITL"),
        ({"SYS_HITL": 0}, HIL, "SYS_HITL is 0"),
        ({"SYS_HITL": 2}, HIL, "SYS_HITL is 2"),  # simulates on board, and says no HIL
        ({"SYS_HITL": 1}, "MAV_MODE_FLAG_CUSTOM_MODE_ENABLED", "reboot it"),  # set, but not yet in force
    ],
)
def test_a_px4_that_may_be_real_is_refused(params: dict[str, Value], base_mode: str, why: str) -> None:
    with pytest.raises(Refused, match=why):
        px4_simulates(params, base_mode)
