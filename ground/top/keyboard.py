"""Keys from the bytes that a terminal sends for them."""

from __future__ import annotations

import codecs

SEQUENCES = {
    "[A": "up",
    "[B": "down",
    "[C": "right",
    "[D": "left",
    "OA": "up",
    "OB": "down",
    "OC": "right",
    "OD": "left",
    "[H": "home",
    "[F": "end",
    "OH": "home",
    "OF": "end",
    "[1~": "home",
    "[4~": "end",
    "[7~": "home",
    "[8~": "end",
    "[5~": "pageup",
    "[6~": "pagedown",
}
PLAIN = {"\r": "enter", "\n": "enter", "\x7f": "backspace", "\b": "backspace"}
LONGEST = 16
"""characters of a sequence that is not known, after which it is none"""


class Keyboard:
    """``feed(bytes)`` gives names (``up``, ``enter``, ``esc``...) and printable characters; others are left out.

    A terminal sends the bytes of one key at once, so an escape at the end of what was read is the escape key itself.
    """

    def __init__(self) -> None:
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    def feed(self, data: bytes) -> list[str]:
        text = self._decoder.decode(data)
        keys: list[str] = []
        at = 0
        while at < len(text):
            if text[at] == "\x1b":
                key, at = _escaped(text, at + 1)
            else:
                key, at = PLAIN.get(text[at], text[at]), at + 1
            if key in PLAIN.values() or len(key) > 1 or (key and key.isprintable()):
                keys.append(key)
        return keys


def _escaped(text: str, at: int) -> tuple[str, int]:
    """The key whose sequence begins behind an escape, and where the next one begins."""
    if at == len(text) or text[at] not in "[O":
        return "esc", at
    end = at + 1
    while end < len(text) and end - at < LONGEST and not ("@" <= text[end] <= "~"):
        end += 1
    return SEQUENCES.get(text[at : end + 1], ""), end + 1
