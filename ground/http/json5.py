"""JSON as people write it (JSON5): comments, commas at the end, names without quotes, single quotes, hexadecimal.

What is read becomes plain JSON, token by token, in one pass; the standard library's parser does the rest.
https://spec.json5.org
"""

from __future__ import annotations

import collections
import json
import re
from typing import Any

from zmav.errors import BadInput

LONGEST = 65_536
"""characters that are looked at one by one"""
_TOKEN = re.compile(
    r"""
    (?P<blank>[\s\ufeff]+ | //[^\n\r\u2028\u2029]* | /\*(?:[^*]|\*(?!/))*\*/)
  | (?P<text>"(?:[^"\\\n]|\\[\s\S])*" | '(?:[^'\\\n]|\\[\s\S])*')
  | (?P<number>[+-]?(?:0[xX][0-9a-fA-F]+ | (?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)? | Infinity | NaN)(?![\w$.]))
  | (?P<name>[A-Za-z_$][\w$]*)
  | (?P<mark>[{}\[\]:,])
    """,
    re.VERBOSE,
)
_ESCAPE = re.compile(r"\\(?:u([0-9a-fA-F]{4})|x([0-9a-fA-F]{2})|(\r\n|[\s\S]))")
_LETTERS = {"b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v", "0": "\0"}
_LINE_ENDS = ("\n", "\r", "\r\n", "\u2028", "\u2029")


def loads(data: bytes) -> Any:
    """The value; raises :class:`BadInput` saying where it stops to be JSON. NaN and infinities are floats."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as e:
        raise BadInput(f"not UTF-8: {e.reason} at byte {e.start}", field="body", expected="JSON") from e
    try:
        try:
            return json.loads(text, object_pairs_hook=_object)  # nearly always plain JSON, and quick
        except ValueError:
            if len(text) > LONGEST:
                raise
        return json.loads("".join(_plain(text)), object_pairs_hook=_object)
    except RecursionError:
        raise BadInput("not JSON: nested too deeply", field="body", expected="JSON") from None
    except ValueError as e:
        raise BadInput(f"not JSON: {e}", field="body", value=text[:80], expected="JSON") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """What others may have read is what is sent: no name twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError(f"{collections.Counter(name for name, _ in pairs).most_common(1)[0][0]} is given twice")
    return found


def _plain(text: str) -> list[str]:
    """The tokens in JSON's own words; ValueError for what is no token."""
    found: list[str] = []
    position = 0
    while position < len(text):
        token = _TOKEN.match(text, position)
        if token is None:
            raise ValueError(f"{text[position : position + 20]!r} at character {position} is not understood")
        position = token.end()
        kind, word = token.lastgroup, token.group()
        if kind == "blank":
            continue
        if kind == "text":
            word = json.dumps(_ESCAPE.sub(_escaped, word[1:-1]))
        elif kind == "number":
            word = _number(word)
        elif kind == "name" and (word not in ("true", "false", "null") or _follows_as_key(text, position)):
            word = json.dumps(word)
            if not _follows_as_key(text, position):
                raise ValueError(f"{word} at character {token.start()} has no quotes")
        elif word in ("}", "]") and found[-1:] == [","] and found[-2:-1] not in (["{"], ["["], [","]):
            found.pop()  # a comma after the last of several
        found.append(word)
    return found


def _follows_as_key(text: str, position: int) -> bool:
    """A colon comes next: what stood before it is a name."""
    while (token := _TOKEN.match(text, position)) is not None and token.lastgroup == "blank":
        position = token.end()
    return text[position : position + 1] == ":"


def _escaped(found: re.Match[str]) -> str:
    four, two, other = found.groups()
    if four or two:
        return chr(int(four or two, 16))
    return "" if other in _LINE_ENDS else _LETTERS.get(other, other)


def _number(word: str) -> str:
    word = word.lstrip("+")
    if "x" in word.lower():
        return str(int(word, 16))
    if word.endswith(("Infinity", "NaN")):
        return word.replace("-NaN", "NaN")
    sign, digits = ("-", word[1:]) if word.startswith("-") else ("", word)
    mantissa, mark, exponent = digits.lower().partition("e")
    whole, point, rest = mantissa.partition(".")
    return f"{sign}{int(whole or '0')}{point and '.' + (rest or '0')}{mark}{exponent}"
