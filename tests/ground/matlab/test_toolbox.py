"""The MATLAB toolbox, run by GNU Octave against the gateway and a simulated copter: each script asserts by itself."""

from __future__ import annotations

import importlib.util
import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

from tests.ground.matlab.conftest import TOKEN, TOOLBOX, Fleet, Octave
from zmav.mavlink import decode, encode, load_dialect, parse_frame
from zmav.verbs import VERBS, Access
from zmav.wire import VehicleState

DIALECT = load_dialect("ardupilotmega")


def test_help_texts(octave: Octave) -> None:
    octave("help_texts.m")


def test_what_it_looks_up_and_what_it_refuses(octave: Octave, fleet: Fleet) -> None:
    octave("look.m", URL=fleet.url, GUARDED=fleet.guarded, TOKEN=TOKEN)


def test_it_flies_the_square(octave: Octave, fleet: Fleet) -> None:
    """Octave says where it has been; what the vehicle itself has published says the same."""
    fleet.world.set_speed(8.0)
    try:
        said = octave("fly.m", URL=fleet.url)
    finally:
        fleet.world.set_speed(1.0)  # where nothing flies, a fast clock is only work
    assert said.count("m north") == 5
    assert "quad1 has landed" in said
    at_height = [state for state in fleet.track if state.local is not None and abs(state.local[2] + 6) < 1.5]
    for north, east in ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)):
        assert min(_away(state, north, east) for state in at_height) < 3.0  # five states a second, of a fast clock
    assert {"GUIDED", "LAND", "RTL"} <= {state.mode for state in fleet.track}
    assert fleet.track[-1].armed is False


def _away(state: VehicleState, north: float, east: float) -> float:
    assert state.local is not None
    return math.dist(state.local[:2], (north, east))


def test_agents(octave: Octave, fleet: Fleet) -> None:
    octave("agents.m", URL=fleet.url)


def test_messages_by_udp(octave: Octave, fleet: Fleet, java: str) -> None:
    octave("stream.m", URL=fleet.url, TRANSPORT="java", JAVA_HOME=java)


def test_messages_without_udp(octave: Octave, fleet: Fleet) -> None:
    octave("stream.m", URL=fleet.url, TRANSPORT="poll")


def test_the_blocks_without_simulink(octave: Octave, fleet: Fleet, tmp_path: Path) -> None:
    """Octave lets nobody but a class itself call its protected methods, so that Simulink's part needs them public."""
    for path in TOOLBOX.glob("*.m"):
        (tmp_path / path.name).write_text(path.read_text().replace("Access = protected", "Access = public"))
    shutil.copytree(TOOLBOX / "private", tmp_path / "private")
    octave("blocks.m", tmp_path, URL=fleet.url)


FRAMES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    (
        "HEARTBEAT",
        {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 4000000000, "system_status": 4},
        {"seq": 8},
    ),
    ("ATTITUDE", {"time_boot_ms": 5, "roll": 0.25, "pitch": -1.5, "yaw": 3.0}, {"version": 1, "sysid": 9}),
    ("GLOBAL_POSITION_INT", {"lat": -353632610, "lon": 1491652300, "vz": -12, "hdg": 65535}, {"compid": 190}),
    ("STATUSTEXT", {"severity": 6, "text": "all is well"}, {"seq": 255}),
    ("SYSTEM_TIME", {"time_unix_usec": 2**63 + 1025, "time_boot_ms": 1}, {}),
    ("GPS_RAW_INT", {"fix_type": 6, "alt": -70000, "yaw": 35999}, {}),
    ("ATTITUDE_QUATERNION", {"q1": 1.0, "rollspeed": math.nan, "repr_offset_q": [1.0, 0.5, 0.0, -2.0]}, {}),
    ("LOG_REQUEST_LIST", {"start": 1, "end": 65535, "target_system": 1}, {}),
    ("AHRS", {}, {}),
]


def test_frames_are_decoded(octave: Octave, tmp_path: Path) -> None:
    whole = b""
    expected = []
    for name, fields, how in FRAMES:
        frame = encode(DIALECT, name, _complete(name) | fields, **{"sysid": 1, "compid": 1, "seq": 7, **how})
        whole += frame
        expected.append(_expected(frame))
    unknown = bytes.fromhex("fd 02 00 00 07 01 01 ff ff 7f aa bb 12 34")
    signed = bytearray(encode(DIALECT, "PARAM_REQUEST_LIST", _complete("PARAM_REQUEST_LIST"), sysid=255, compid=190))
    broken = bytearray(encode(DIALECT, "HEARTBEAT", _complete("HEARTBEAT"), sysid=1, compid=1))
    broken[12] ^= 1
    newer = bytes([0xFD, 0, 2, *range(9)])  # an incompatibility flag that nobody knows
    stamp = bytes.fromhex("00 06 2b 1f 8a 3c 7d fe")  # as in a .tlog: its end and what follows look like message 8
    data = stamp + whole + bytes(broken) + unknown + newer + bytes(signed[:9])
    expected.append(
        {
            "version": 2,
            "sys": 1,
            "comp": 1,
            "seq": 7,
            "msgid": 0x7FFFFF,
            "name": "",
            "signed": False,
            "checked": False,
            "fields": {},
        }
    )
    (tmp_path / "frames").write_bytes(data)
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    given = {"FRAMES": str(tmp_path / "frames"), "EXPECTED": str(tmp_path / "expected.json")}
    octave("decode.m", **given, REST="9", SKIPPED=str(len(stamp) + len(broken) + len(newer)))


def _complete(name: str) -> dict[str, Any]:
    message = DIALECT.message(name)
    zero: dict[str, Any] = {"char": ""}
    return {f.name: zero.get(f.type, [0] * f.length if f.length else 0) for f in message.fields}


def _expected(data: bytes) -> dict[str, Any]:
    frame = parse_frame(data, DIALECT)
    message = DIALECT.by_id[frame.msgid]
    fields = {}
    for name, value in decode(frame, DIALECT).items():
        field = message.by_name[name]
        fields[name] = str(value) if field.type in ("int64_t", "uint64_t") else value
    return {
        "version": frame.version,
        "sys": frame.sysid,
        "comp": frame.compid,
        "seq": frame.seq,
        "msgid": frame.msgid,
        "name": message.name,
        "signed": False,
        "checked": True,
        "fields": fields,
    }


def test_the_table_of_messages_is_the_dialects() -> None:
    spec = importlib.util.spec_from_file_location("messages", TOOLBOX / "messages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = (TOOLBOX / "private" / "messages.txt").read_text()
    assert text == module.table(), "make it again: python ground/matlab/messages.py"


def test_orders_that_move_end_its_own_stream() -> None:
    (listed,) = re.findall(r"moving = \{(.*?)\};", (TOOLBOX / "zmav_do.m").read_text())
    assert set(re.findall(r"'(\w+)'", listed)) == {verb.name for verb in VERBS.values() if verb.access is Access.MOVE}
