"""Parameter files: what other ground stations write is read, what we write comes back, and faults are named."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadInput
from zmav.formats.paramfile import FileParam, Format, ParamFile, format_of, read, write
from zmav.mavlink.paramvalue import bounds, float32, shortest
from zmav.wire import PARAM_TYPES

QGC = """\
# Onboard parameters for Vehicle 1
#
# Stack: PX4 Pro
# Vehicle: Multi-Rotor
# Version: 1.16.1 \n# Git Revision: \n#
# Vehicle-Id Component-Id Name Value Type
1\t1\tBAT1_CAPACITY\t-1.000000000000000000\t9
1\t1\tCOM_RC_IN_MODE\t3\t6
1\t154\tGMB_PITCH\t0.5\t9
"""
PLANNER = """\
#NOTE: 7/3/2026 Plane: 4.7.0
ACRO_BAL_PITCH,1
ARMING_CHECK,1.000000
ATC_ANG_RLL_P , 4.5
"""
MAVPROXY = "FRAME_CLASS      1.000000\r\nSERVO1_FUNCTION  0x21   # in hex\r\n\r\nRTL_ALT\t3000\r\n"


def test_qgroundcontrol_s_file() -> None:
    found = read(QGC.encode(), "q.params")
    assert found.params == [
        FileParam("BAT1_CAPACITY", -1.0, "REAL32", 1),
        FileParam("COM_RC_IN_MODE", 3, "INT32", 1),
        FileParam("GMB_PITCH", 0.5, "REAL32", 154),
    ]
    assert (found.format, found.sysid) == ("qgc", 1)
    assert found.values() == {"BAT1_CAPACITY": -1.0, "COM_RC_IN_MODE": 3}
    assert found.values(154) == {"GMB_PITCH": 0.5}


def test_what_qgroundcontrol_writes_is_what_we_write() -> None:
    lines = QGC.replace("-1.000000000000000000", "-1").splitlines()
    file = read(QGC.encode())
    file.stack, file.vehicle, file.version = "PX4 Pro", "Multi-Rotor", "1.16.1"
    assert write(file).decode().splitlines() == lines


def test_mission_planner_s_and_mavproxy_s_files() -> None:
    found = read(PLANNER.encode("utf-8-sig"))
    assert (found.format, found.values()) == (
        "planner",
        {"ACRO_BAL_PITCH": 1, "ARMING_CHECK": 1.0, "ATC_ANG_RLL_P": 4.5},
    )
    assert read(MAVPROXY.encode()).values() == {"FRAME_CLASS": 1.0, "SERVO1_FUNCTION": 33, "RTL_ALT": 3000}
    assert write(found).decode().splitlines()[1:] == ["ACRO_BAL_PITCH,1", "ARMING_CHECK,1", "ATC_ANG_RLL_P,4.5"]


def test_no_number_is_kept_as_none() -> None:
    assert read(b"A,nan\n").params == [FileParam("A", None)]
    assert read(write(ParamFile("planner", [FileParam("A", None)]))).params == [FileParam("A", None)]


def test_the_same_line_twice_is_one() -> None:
    assert read(b"A,1\nB,2\nA,1\n").values() == {"A": 1, "B": 2}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("A,1\nB\n", 2, "'B' is not NAME,VALUE"),
        ("A 1 @READONLY\n", 1, "is not NAME,VALUE"),
        ("A,one\n", 1, "'one' is not a number"),
        ("A,1_000\n", 1, "'1_000' is not a number"),
        ("A,inf\n", 1, "'inf' is not a number"),
        ("A,1e999\n", 1, "is not a number"),
        ("A,\u0661\n", 1, "is not a number"),
        ("A_NAME_THAT_IS_FAR_TOO_LONG,1\n", 1, "cannot be a parameter's name"),
        ("\u00e4,1\n", 1, "cannot be a parameter's name"),
        ("A,1\n\n# x\nA,2\n", 4, "A has another value than in line 1"),
        ("1\t1\tA\t1\t9\n1\t1\tB\t1\n", 2, "has 4 columns, not 5"),
        ("1\t1\tA\t1\t9\nB,1\n", 2, "has 1 columns, not 5"),
        ("1\t1\tA\t1\t11\n", 1, "type '11': expected a number from 1 to 10"),
        ("1\t1\tA\t1\t0\n", 1, "type '0'"),
        ("1\t1\tA\t1.5\t6\n", 1, "A: '1.5' is no integer, which its type INT32 expects"),
        ("1\t1\tA\tnan\t6\n", 1, "is no integer"),
        ("256\t1\tA\t1\t9\n", 1, "vehicle '256'"),
        ("1\tx\tA\t1\t9\n", 1, "component 'x'"),
        ("1\t1\tA\t1\t9\n2\t1\tA\t1\t9\n", 2, "expected one vehicle"),
    ],
)
def test_faults_name_the_file_and_the_line(text: str, line: int, words: str) -> None:
    with pytest.raises(BadInput, match=r"^my\.params") as caught:
        read(text.encode(), "my.params")
    assert str(caught.value).startswith(f"my.params, line {line}: ")
    assert words in str(caught.value)
    assert caught.value.detail["value"] == "my.params"


@pytest.mark.parametrize("data", [b"", b"\n\n", b"# only words\n"])
def test_a_file_without_parameters(data: bytes) -> None:
    with pytest.raises(BadInput, match="e holds no parameters"):
        read(data)


def test_what_is_no_text() -> None:
    with pytest.raises(BadInput, match="line 2: is not UTF-8"):
        read(b"A,1\n\xff\xfe,2\n")


def test_the_format_is_told_by_the_ending() -> None:
    assert [format_of(p) for p in ("a.params", "x/B.PARM", "c.param")] == ["qgc", "planner", "planner"]
    with pytest.raises(BadInput, match=r"path is a.txt; expected .params \(QGroundControl\)"):
        format_of("a.txt")


def test_a_type_is_needed_for_qgroundcontrol() -> None:
    with pytest.raises(BadInput, match="RTL_ALT: its type is not known"):
        write(ParamFile("qgc", [FileParam("RTL_ALT", 1)]))


names = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_", min_size=1, max_size=16)
reals = st.floats(width=32, allow_nan=False, allow_infinity=False).map(shortest)


@st.composite
def typed(draw: st.DrawFn) -> FileParam:
    kind = draw(st.sampled_from(PARAM_TYPES))
    real = kind.startswith("REAL")
    value = draw(st.one_of(reals, st.none()) if real else st.integers(*bounds(kind)))
    return FileParam(draw(names), value, kind, draw(st.integers(1, 255)))


@given(st.lists(typed(), min_size=1, unique_by=lambda p: (p.compid, p.name)), st.integers(1, 255))
def test_there_and_back_qgroundcontrol(params: list[FileParam], sysid: int) -> None:
    file = ParamFile("qgc", params, sysid, "ArduPilot", "Quadrotor", "4.7.0")
    assert read(write(file)) == ParamFile("qgc", sorted(params, key=lambda p: (p.compid or 0, p.name)), sysid)


@given(st.dictionaries(names, st.one_of(reals, st.integers(-(2**31), 2**31)), min_size=1))
def test_there_and_back_mission_planner(values: dict[str, float]) -> None:
    found = read(write(ParamFile("planner", [FileParam(name, value) for name, value in values.items()])))
    assert {name: float32(value or 0.0) for name, value in found.values().items()} == {
        name: float32(value) for name, value in values.items()
    }
    forms: list[Format] = [found.format]
    assert forms == ["planner"]
