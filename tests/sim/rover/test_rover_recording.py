"""The simulated rover beside the recording of a real ArduRover (SITL) on the same drive: messages, rates, states, words
and the track.

The drive: boot, GUIDED and armed when there is a position, 15 m north, 15 m east, back, and stopped on the way by HOLD
and a disarming.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.sim.yardstick.flights import ROVER_GUIDED, rover
from tests.sim.yardstick.measure import only_what_is_explained_differs
from tests.sim.yardstick.reading import Message, from_tlog, rates, states
from zmav.mavlink import load_dialect

NOT_SENT = {"PARAM_VALUE": "what the real one learns and saves", "SIMSTATE": "nobody on the link reads it"}
NOT_SAID = {"INS: alloc 6144 bytes for ISB (free=524288)": "there is no memory to speak of"}
OFF_M = 2.5
"""that the two tracks may be apart at any time: half a second of the way, and what the real estimate wanders"""


def track(messages: list[Message]) -> dict[int, tuple[float, float]]:
    """Where it was, by tenths of a second since GUIDED."""
    start = next(t for t, name, f in messages if name == "HEARTBEAT" and f["custom_mode"] == ROVER_GUIDED)
    places = [(t, f["x"], f["y"]) for t, name, f in messages if name == "LOCAL_POSITION_NED" and t > start]
    return {round((t - start) * 10): (x, y) for t, x, y in places}


def test_the_drive_looks_the_same(shared_data: Path) -> None:
    real = list(from_tlog(shared_data / "rover.tlog", load_dialect("ardupilotmega")))
    ours = rover()

    expected, found = rates(real), rates(ours)
    assert expected.keys() - found.keys() == NOT_SENT.keys()
    assert found.keys() <= expected.keys()
    steady = [name for name in found if name != "STATUSTEXT"]
    assert {name: found[name] for name in steady} == pytest.approx({name: expected[name] for name in steady}, rel=0.06)

    for fields in (("base_mode", "custom_mode", "system_status", "type"),):
        assert states(ours, "HEARTBEAT", *fields) == states(real, "HEARTBEAT", *fields)
    sensors = tuple(f"onboard_control_sensors_{part}" for part in ("present", "enabled", "health"))
    assert set(states(ours, "SYS_STATUS", *sensors)) <= set(states(real, "SYS_STATUS", *sensors))
    words = [{f["text"] for _, name, f in messages if name == "STATUSTEXT"} for messages in (real, ours)]
    assert words[0] - words[1] == NOT_SAID.keys()
    assert words[1] <= words[0]

    there, here = track(real), track(ours)
    apart = {t: math.dist(there[t], here[t]) for t in there.keys() & here.keys() if t <= 230}
    assert len(apart) > 150
    assert max(apart.values()) < OFF_M, max(apart, key=lambda t: apart[t])
    only_what_is_explained_differs("rover", real, ours)
