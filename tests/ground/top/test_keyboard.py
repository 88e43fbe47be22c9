"""Keys from bytes."""

from __future__ import annotations

from ground.top.terminal import Keyboard


def test_sequences_plain_keys_and_a_lone_escape() -> None:
    keyboard = Keyboard()
    assert keyboard.feed(b"q\x1b[A\x1bOBj\r\x7f\x1b[5~\x1b[1~") == [
        "q",
        "up",
        "down",
        "j",
        "enter",
        "backspace",
        "pageup",
        "home",
    ]
    assert keyboard.feed(b"\x1b") == ["esc"]
    assert keyboard.feed(b"\x1bx") == ["esc", "x"]


def test_what_is_no_key_is_left_out() -> None:
    keyboard = Keyboard()
    assert keyboard.feed(b"\x00\x01\t\x1b[<0;10;10M\x1b[99~a") == ["a"]
    assert keyboard.feed(b"\x1b[" + b"1;" * 40) != ["q"]
    assert keyboard.feed(b"\xc3") == []
    assert keyboard.feed(b"\xa9") == ["é"]
