"""Which frames of a ground station pass whatever stands against them: those that can only land, return or halt."""

from __future__ import annotations

import pytest

from zmav.autopilots import autopilot_for
from zmav.autopilots.safety import makes_safe
from zmav.mavlink import Packer, Splitter, load_dialect

ARDUPILOT, PX4 = 3, 12
PLANE, COPTER, ROVER = 1, 2, 10
DIALECT = load_dialect()
SAFE = [
    (ARDUPILOT, COPTER, "LAND RTL SMART_RTL BRAKE", "GUIDED AUTO STABILIZE LOITER"),
    (ARDUPILOT, ROVER, "HOLD RTL SMART_RTL LOITER", "GUIDED AUTO MANUAL"),
    (ARDUPILOT, PLANE, "RTL LOITER AUTOLAND QLAND QRTL", "GUIDED AUTO TAKEOFF QLOITER"),
    (PX4, COPTER, "HOLD LAND RTL", "OFFBOARD MISSION TAKEOFF POSCTL"),
]


@pytest.mark.parametrize(
    ("stack", "kind", "mode", "safe"),
    [
        (stack, kind, mode, safe)
        for stack, kind, yes, no in SAFE
        for safe, modes in ((True, yes), (False, no))
        for mode in modes.split()
    ],
)
def test_modes_that_make_safe(stack: int, kind: int, mode: str, safe: bool) -> None:
    autopilot = autopilot_for(stack, kind)
    entered, packer = autopilot.mode(mode), Packer(DIALECT, 255, 190)
    params = {f"param{n}": value for n, value in enumerate(entered.command.padded(), start=1)}
    command = DIALECT.value("MAV_CMD", "MAV_CMD_DO_SET_MODE")
    to = {"target_system": 1}
    for data in (
        packer.pack("COMMAND_LONG", **to, target_component=1, command=command, confirmation=0, **params),
        packer.pack("SET_MODE", **to, base_mode=1, custom_mode=entered.custom),
    ):
        (frame,) = Splitter(DIALECT).feed(data)
        assert makes_safe(frame, DIALECT, autopilot) is safe
