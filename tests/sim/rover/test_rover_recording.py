"""The simulated rover beside the recording of a real ArduRover (SITL) on the same drive: messages, rates, states, words
and the track.

The drive: boot, GUIDED and armed when there is a position, 15 m north, 15 m east, back, and stopped on the way by HOLD
and a disarming.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.sim.yardstick.reading import Message, from_tlog, rates
from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import load_dialect
from zmav.sim import REALISTIC_READY_S

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

GUIDED, HOLD = 15, 4
ORDERS = ((43.3, 15.0, 0.0), (49.3, 15.0, 15.0), (56.3, 0.0, 0.0))  # s, to half a second as recorded; m north, east
NOT_SENT = {"PARAM_VALUE": "what the real one learns and saves"}
NOT_SAID = {"INS: alloc 6144 bytes for ISB (free=524288)": "there is no memory to speak of"}
OFF_M = 2.5
"""that the two tracks may be apart at any time: half a second of the way, and what the real estimate wanders"""


def drive(yard: Yard) -> list[Message]:
    """The recorded drive, on the simulated rover."""
    desk, seen = yard.desk, []

    def put(frame: bytes) -> None:
        for each in desk.splitter.feed(frame):
            desk.frames.append(each)
            seen.append((desk.world.time_s, desk.dialect.name_of(each.msgid), decode(each, desk.dialect)))

    desk.put = put  # type: ignore[method-assign]
    desk.world.step(1.0)
    for stream, rate in {0: 2, 6: 5, 10: 10, 11: 10}.items():
        desk.send("REQUEST_DATA_STREAM", req_stream_id=stream, req_message_rate=rate, start_stop=1)
    assert desk.command(511, 32, 1e5) == 0
    desk.until(lambda: desk.world.time_s >= 42.4)
    assert yard.mode(GUIDED) == 0
    assert desk.command(400, 1) == 0
    for at, north, east in ORDERS:
        desk.until(lambda at=at: desk.world.time_s >= at)  # type: ignore[misc]
        desk.frames.clear()
        yard.goto(north, east)
    desk.until(lambda: desk.world.time_s >= 65.2)
    assert yard.mode(HOLD) == 0
    assert desk.command(400, 0) == 0
    desk.until(lambda: desk.world.time_s >= 69.0)
    return seen


def steps(messages: list[Message], name: str, *fields: str) -> list[tuple[int, ...]]:
    """The values that fields took, one after another."""
    found: list[tuple[int, ...]] = []
    for _, each, values in messages:
        step = tuple(values[f] for f in fields if f in values)
        if each == name and found[-1:] != [step]:
            found.append(step)
    return found


def track(messages: list[Message]) -> dict[int, tuple[float, float]]:
    """Where it was, by tenths of a second since GUIDED."""
    start = next(t for t, name, f in messages if name == "HEARTBEAT" and f["custom_mode"] == GUIDED)
    places = [(t, f["x"], f["y"]) for t, name, f in messages if name == "LOCAL_POSITION_NED" and t > start]
    return {round((t - start) * 10): (x, y) for t, x, y in places}


def test_the_drive_looks_the_same(make_yard: MakeYard, shared_data: Path) -> None:
    real = list(from_tlog(shared_data / "rover.tlog", load_dialect("ardupilotmega")))
    ours = drive(make_yard(ready_s=REALISTIC_READY_S))

    expected, found = rates(real), rates(ours)
    assert expected.keys() - found.keys() == NOT_SENT.keys()
    assert found.keys() <= expected.keys()
    steady = [name for name in found if name != "STATUSTEXT"]
    assert {name: found[name] for name in steady} == pytest.approx({name: expected[name] for name in steady}, rel=0.06)

    for fields in (("base_mode", "custom_mode", "system_status", "type"),):
        assert steps(ours, "HEARTBEAT", *fields) == steps(real, "HEARTBEAT", *fields)
    sensors = tuple(f"onboard_control_sensors_{part}" for part in ("present", "enabled", "health"))
    assert set(steps(ours, "SYS_STATUS", *sensors)) <= set(steps(real, "SYS_STATUS", *sensors))
    words = [{f["text"] for _, name, f in messages if name == "STATUSTEXT"} for messages in (real, ours)]
    assert words[0] - words[1] == NOT_SAID.keys()
    assert words[1] <= words[0]

    there, here = track(real), track(ours)
    apart = {t: math.dist(there[t], here[t]) for t in there.keys() & here.keys() if t <= 230}
    assert len(apart) > 150
    assert max(apart.values()) < OFF_M, max(apart, key=lambda t: apart[t])
