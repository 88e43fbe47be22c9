"""The simulated copter beside the recording of a real ArduCopter (SITL) on the same flight: messages, rates, fields.

The flight: boot, arm when there is a position, 10 m up, a 75 m square, land. Both are cut into phases by what
GLOBAL_POSITION_INT says, and every field's median is compared phase by phase. What differs must be in :data:`KNOWN`,
with its reason.
"""

from __future__ import annotations

import functools
import statistics
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import Dialect, load_dialect
from zmav.mavlink.frames import Splitter
from zmav.sim import REALISTIC_READY_S

if TYPE_CHECKING:
    from tests.sim.conftest import Desk, MakeDesk

GUIDED = 4
SIDE_M = 75.0
Message = tuple[float, str, dict[str, Any]]  # seconds, name, fields

# What may differ by so much (in the field's units) or by a third.
TOLERANCE = {
    "": 3.0,
    "rad": 0.06,
    "deg": 4.0,
    "cdeg": 400.0,
    "degE7": 3000.0,
    "rad/s": 0.05,
    "mrad/s": 50.0,
    "m": 0.5,
    "mm": 500.0,
    "m/s": 0.6,
    "cm/s": 60.0,
    "m/s/s": 0.6,
    "mG": 20.0,
    "mgauss": 140.0,  # a dipole for a field
    "%": 6.0,
    "d%": 60.0,
    "us": 60.0,
    "cA": 400.0,
    "hPa": 2.0,
}
CLOCKS = {"time_boot_ms", "time_usec", "time_unix_usec", "tc1", "ts1"}
# message.field -> why it is not the same
KNOWN = {
    "GPS_RAW_INT.cog": "without motion it is noise",
    "RAW_IMU.ygyro": "the real one wobbles more on its way",
    "SCALED_IMU2.ygyro": "the real one wobbles more on its way",
}
NOT_SENT = {
    "TERRAIN_REQUEST": "the simulated ground is flat, and nobody is asked for it",
    "PARAM_VALUE": "what the real one learns and saves in flight",
}
NOT_SAID = {
    "EKF3 IMU0 MAG0 in-flight yaw alignment complete": "the compass has no errors to learn",
    "EKF3 IMU1 MAG0 in-flight yaw alignment complete": "the compass has no errors to learn",
}


def from_tlog(path: Path, dialect: Dialect) -> Iterator[Message]:
    """Messages of a recording: 8 bytes of big-endian microseconds before each frame."""
    data, at, start = path.read_bytes(), 0, None
    splitter = Splitter(dialect)
    while at < len(data):
        stamp = int.from_bytes(data[at : at + 8], "big") / 1e6
        start = stamp if start is None else start
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        for frame in splitter.feed(data[at + 8 : at + 8 + size]):
            if frame.verified:
                yield stamp - start, dialect.name_of(frame.msgid), decode(frame, dialect)
        at += 8 + size


def phase_of(position: dict[str, Any], armed: bool, was_armed: bool) -> str:
    north, east, down = position["vx"], position["vy"], position["vz"]
    if not armed:
        return "landed" if was_armed else "standing"
    if down < -150:
        return "climbing"
    if 40 < down < 60 and position["relative_alt"] < 9000:
        return "landing"
    for name, along, across in (("north", north, east), ("east", east, north)):
        if abs(along) > 800 and abs(across) < 100:
            return name if along > 0 else {"north": "south", "east": "west"}[name]
    return ""


def by_phase(messages: list[Message]) -> dict[tuple[str, str, str], list[float]]:
    """(phase, message, field) -> values."""
    found: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    phase, armed, was_armed = "", False, False
    for _, name, fields in messages:
        if name == "HEARTBEAT":
            armed = bool(fields["base_mode"] & 128)
            was_armed |= armed
        if name == "GLOBAL_POSITION_INT" and fields["lat"] != 0:
            phase = phase_of(fields, armed, was_armed)
        for field, value in fields.items():
            if phase and field not in CLOCKS and isinstance(value, int | float):
                found[phase, name, field].append(float(value))
    return found


def rates(messages: list[Message]) -> dict[str, float]:
    """Messages a second, from the first to the last, of those that came at least ten times."""
    times: dict[str, list[float]] = defaultdict(list)
    for at, name, _ in messages:
        times[name].append(at)
    return {name: (len(t) - 1) / (t[-1] - t[0]) for name, t in times.items() if len(t) >= 10}


def fly(desk: Desk) -> list[Message]:
    """The recorded flight, on the simulated copter."""
    seen: list[Message] = []

    def put(frame: bytes) -> None:
        for each in desk.splitter.feed(frame):
            desk.frames.append(each)
            seen.append((desk.world.time_s, desk.dialect.name_of(each.msgid), decode(each, desk.dialect)))

    desk.put = put  # type: ignore[method-assign]
    desk.world.step(1.0)
    for stream, rate in {0: 2, 6: 5, 10: 10, 11: 10}.items():
        desk.send("REQUEST_DATA_STREAM", req_stream_id=stream, req_message_rate=rate, start_stop=1)
    assert desk.command(511, 32, 1e5) == 0
    desk.take_off(10.0)
    for north, east in ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)):
        desk.goto(north, east, -10.0)
        desk.until(functools.partial(desk.near, north, east, -10.0, 0.3))
        desk.frames.clear()
    assert desk.command(21) == 0
    desk.until(lambda: not desk.vehicle.copter.armed)
    desk.world.step(4.0)
    return seen


def angle_between(a: float, b: float, units: str) -> float:
    """The difference of two numbers; of angles, the short way round."""
    turn = {"deg": 360.0, "cdeg": 36000.0}.get(units)
    gap = abs(a - b)
    return gap if turn is None else min(gap % turn, turn - gap % turn)


@pytest.fixture(scope="module")
def dialect() -> Dialect:
    return load_dialect("ardupilotmega")


def test_the_flight_looks_the_same(make_desk: MakeDesk, shared_data: Path, dialect: Dialect) -> None:
    real = list(from_tlog(shared_data / "copter.tlog", dialect))
    ours = fly(make_desk(ready_s=REALISTIC_READY_S))
    same_messages_at_the_same_rates(real, ours)
    same_stages(real, ours)
    same_fields(real, ours, dialect)


def same_messages_at_the_same_rates(real: list[Message], ours: list[Message]) -> None:
    expected, found = rates(real), rates(ours)
    assert expected.keys() - found.keys() == NOT_SENT.keys()
    assert found.keys() <= expected.keys()
    steady = [name for name in found if name != "STATUSTEXT"]
    assert {name: found[name] for name in steady} == pytest.approx({name: expected[name] for name in steady}, rel=0.06)


def same_stages(real: list[Message], ours: list[Message]) -> None:
    """The same steps through the states, in the same order; and the same words."""

    def steps(messages: list[Message], name: str, *fields: str) -> list[tuple[int, ...]]:
        found: list[tuple[int, ...]] = []
        for _, each, values in messages:
            step = tuple(values[f] for f in fields if f in values)
            if each == name and found[-1:] != [step]:
                found.append(step)
        return found

    for name, fields in {
        "HEARTBEAT": ("base_mode", "custom_mode", "system_status"),
        "EKF_STATUS_REPORT": ("flags",),
        "GPS_RAW_INT": ("fix_type", "satellites_visible", "eph", "h_acc"),
    }.items():
        assert steps(ours, name, *fields) == steps(real, name, *fields), name

    def words(messages: list[Message]) -> set[str]:
        # Without the speed of the touch-down.
        return {f["text"].split(" at 0.")[0] for _, name, f in messages if name == "STATUSTEXT"}

    assert words(real) - words(ours) == NOT_SAID.keys()
    assert words(ours) <= words(real)


def same_fields(real: list[Message], ours: list[Message], dialect: Dialect) -> None:
    expected, found = by_phase(real), by_phase(ours)
    phases = {"standing", "climbing", "north", "east", "south", "west", "landing", "landed"}
    assert {key[0] for key in expected} == {key[0] for key in found} == phases
    compared = sorted(expected.keys() & found.keys())
    assert len(compared) > 1500
    differences = []
    for key in compared:
        phase, name, field = key
        a, b = statistics.median(expected[key]), statistics.median(found[key])
        units = dialect.by_name[name].by_name[field].units
        gap = angle_between(a, b, units)
        if gap > max(TOLERANCE.get(units, 3.0), max(abs(a), abs(b)) / 3) and f"{name}.{field}" not in KNOWN:
            differences.append(f"{phase}: {name}.{field} is {b:g}, was {a:g} {units}")
    assert differences == []
