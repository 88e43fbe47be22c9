"""The file of an autopilot's events: formats, units, enums and tags as libevents has them; and what must do no harm."""

from __future__ import annotations

import json
import lzma
import math
import struct
from typing import Any

import pytest

from zmav.errors import BadMessage
from zmav.mavlink.event import LONGEST, MOST, MOST_PACKED, Event, EventWords

TYPES = ["uint8_t", "int16_t", "float", "px4::gait_t", "feet_t", "int64_t", "float"]
ARGUMENTS = struct.pack("<BhfBHqf", 7, -42, 3.14159, 2, 5, -(1 << 40), 21.5)
ENUMS: dict[str, dict[str, Any]] = {
    "gait_t": {"type": "uint8_t", "entries": {"2": {"name": "trot", "description": "Trot"}}},
    "feet_t": {
        "type": "uint16_t",
        "is_bitfield": True,
        "separator": " and ",
        "entries": {"1": {"name": "left", "description": "left"}, "4": {"name": "right", "description": "right"}},
    },
}


def packed(message: str, types: list[str] = TYPES, **more: Any) -> bytes:
    event = {"name": "an_event", "message": message, "arguments": [{"name": "a", "type": each} for each in types]}
    px4 = {"namespace": "px4", "enums": ENUMS, "event_groups": {"default": {"events": {"5": event}}}, **more}
    return lzma.compress(json.dumps({"version": 2, "components": {"1": px4}}).encode())


def told(message: str, types: list[str] = TYPES, arguments: bytes = ARGUMENTS) -> str:
    worded = EventWords.unpack(packed(message, types)).of(Event(1 << 24 | 5, 0, 0, 3, 3, arguments))
    assert worded is not None
    return worded.text


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ("{1} and {2}", "7 and -42"),
        ("{3}", "3.14159"),
        ("{3:.1}", "3.1"),
        ("{3:.0}", "3"),
        ("{3:.2m}", "3.14 m"),
        ("{3m_v}", "3.14159 m"),
        ("{7:.1C}, {7m/s}, {1m^2}", "21.5 C, 21.5 m/s, 7 m^2"),
        ("{1:.1}", "7.0"),
        ("{4}", "Trot"),
        ("{4:.1}", "Trot"),
        ("{5}", "left and right"),
        ("{6}", "-1099511627776"),
        ("{8} {0} {12}", "? ? ?"),
        ("{x} {1:5} {", "{x} {1:5} {"),
        (r"\{1} is \<b> \\", r"{1} is <b> \ ".strip()),
        ("set <param>COM_X</param>", "set COM_X"),
        ('see <a href="https://px4.io">the page</a>', "see the page (https://px4.io)"),
        ("see <a>https://px4.io</a>", "see https://px4.io"),
        ('for <profile name="dev">you {1}</profile><profile name="!dev">others</profile>!', "for you 7!"),
        ("one <blink>two</blink> three", "one three"),
        ("no end <param>X", "no end <param>X"),
        ("\x1b[31mred\n  next", "[31mred next"),
    ],
)
def test_messages(message: str, text: str) -> None:
    assert told(message) == text


def test_what_is_unknown_in_an_enum_is_said() -> None:
    types = ["px4::gait_t", "feet_t"]
    assert told("{1}; {2}", types, struct.pack("<BH", 9, 9)) == "(unknown: 9); left and (unknown: 8)"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("of", ["px4::gait_t", "feet_t"])
def test_an_enum_of_floats_is_read_whatever_they_are(of: str, value: float) -> None:
    enums = {name: {**enum, "type": "float"} for name, enum in ENUMS.items()}
    words = EventWords.unpack(packed("{1}!", [of], enums=enums))
    worded = words.of(Event(1 << 24 | 5, 0, 0, 3, 3, struct.pack("<f", value)))
    assert worded is not None
    assert worded.text in ("(unknown: 0)!", "!")


def test_arguments_that_are_cut_off_or_of_no_known_type_are_left_out() -> None:
    assert told("{1} {2}", ["uint8_t", "uint32_t"], b"\x05\x01") == "5 ?"
    assert told("{1} {2}", ["uint8_t", "string"], b"\x05\x01") == "5 ?"
    assert told("{1}", ["nothing::like_it_t"], b"\x05") == "?"


def test_an_event_that_it_does_not_have() -> None:
    words = EventWords.unpack(packed("x"))
    assert words.of(Event(2 << 24 | 5, 0, 0, 3, 3, b"")) is None


def test_modes_have_bits() -> None:
    words = EventWords.unpack(packed("x", navigation_mode_groups={"groups": {"3": [67371008], "4": [50593792, 7]}}))
    assert [words.mode_bit(mode) for mode in (67371008, 50593792, 7, 8)] == [8, 16, 16, None]


def bomb(size: int) -> bytes:
    return lzma.compress(b'{"version": 2, "components": {}, "x": "' + b" " * size + b'"}', preset=9)


DEEP = b'{"version": 2, "components": {}, "x": ' + b"[" * 200_000 + b"]" * 200_000 + b"}"


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "cut off"),
        (b"no xz at all", "cannot be read"),
        (packed("x")[:-20], "cut off"),
        (packed("x")[:60] + b"\xff" * 8 + packed("x")[68:], "cannot be read"),
        (bytes(MOST_PACKED + 1), "at most"),
        (bomb(MOST), "more than"),
        (lzma.compress(b"x", filters=[{"id": lzma.FILTER_LZMA2, "dict_size": 1 << 30}]), "cannot be read"),
        (lzma.compress(DEEP), "cannot be read"),
        (lzma.compress(b"\xff\xfe"), "cannot be read"),
        (lzma.compress(b"[]"), "cannot be read"),
        (lzma.compress(b'{"version": 0, "components": {}}'), "version 0"),
        (lzma.compress(b'{"version": 2, "components": {"x": {"namespace": "p", "event_groups": {}}}}'), None),
        (packed("x", event_groups={"g": {"events": {"9" * 5000: {"name": "n", "message": "m"}}}}), "cannot be read"),
        (packed("x", event_groups={"g": {"events": {"one": {"name": "n", "message": "m"}}}}), "cannot be read"),
        (packed("x", event_groups={"g": {"events": {"1": {"name": "n", "message": 5}}}}), "cannot be read"),
    ],
)
def test_a_damaged_or_hostile_file_is_refused(data: bytes, why: str | None) -> None:
    if why is None:
        assert EventWords.unpack(data).of(Event(5, 0, 0, 3, 3, b"")) is None
        return
    with pytest.raises(BadMessage, match=why):
        EventWords.unpack(data)


def test_a_bomb_of_exactly_what_is_read_passes() -> None:
    """The bound is on what comes out, not on how well it is compressed."""
    assert len(bomb(MOST - 100)) < MOST_PACKED
    EventWords.unpack(bomb(MOST - 100))


@pytest.mark.parametrize(
    "message",
    ["{4}" * 400, '<profile name="dev">' * 60, "<a>" * 400 + "</a>", "{3:.99}" * 200, "\\" * 2000, "x" * 100_000],
)
def test_a_message_stays_short(message: str) -> None:
    enums = {"gait_t": {"type": "uint8_t", "entries": {"2": {"name": "trot", "description": "t" * 100_000}}}}
    worded = EventWords.unpack(packed(message, enums=enums)).of(Event(1 << 24 | 5, 0, 0, 3, 3, ARGUMENTS))
    assert worded is not None
    assert len(worded.text) <= LONGEST
