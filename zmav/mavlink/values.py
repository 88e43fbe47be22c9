"""Values of single fields: from the wire to what people and JSON see, and back; a refusal says what was expected."""

from __future__ import annotations

import math
import struct
from typing import Any

from zmav.errors import did_you_mean
from zmav.mavlink.dialect import Dialect, Field

_RANGES = {
    f"{'u' if unsigned else ''}int{bits}_t": (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for bits in (8, 16, 32, 64)
    for unsigned in (True, False)
}
_FLOATS = ("float", "double")
_FLOAT_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
_BYTES = ("uint8_t", "int8_t")
_REPLACEMENT = "\ufffd"


def text(raw: bytes) -> str:
    """A char array as text: UTF-8 up to the first NUL, U+FFFD for what is none."""
    return raw.split(b"\0", 1)[0].decode("utf-8", "replace")


def to_json(field: Field, value: Any, dialect: Dialect) -> Any:
    """A decoded value as :func:`zmav.mavlink.codec.describe` shows it."""
    if isinstance(value, list):
        return [to_json(field, item, dialect) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if field.enum and isinstance(value, int):
        return _name(field, value, dialect)
    return value


def _name(field: Field, value: int, dialect: Dialect) -> str | int:
    entries = dialect.enum_names.get(field.enum, {})
    if value in entries or not field.bitmask or value < 0:
        return entries.get(value, value)
    names = []
    rest = value
    for flag, name in entries.items():  # in the order of their numbers: see Dialect.build
        if flag > 0 and flag & (flag - 1) == 0 and value & flag:
            names.append(name)
            rest &= ~flag
    if not names:
        return value
    return " | ".join([*names, str(rest)] if rest else names)


def zeros(field: Field) -> list[Any]:
    """What the field's place in the payload holds when nobody gave a value."""
    return [b""] if field.type == "char" else [0] * (field.length or 1)


def from_json(field: Field, value: Any, dialect: Dialect) -> list[Any]:
    """The struct arguments for the field's place in the payload; ValueError says what was expected."""
    if field.type == "char":
        return [_chars(field, value)]
    if not field.length:
        return [_scalar(field, value, dialect)]
    if isinstance(value, (bytes, bytearray)) and field.type == "uint8_t":
        value = list(value)
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"{_short(value)} is not {expected(field)}")
    # Byte arrays are buffers with their own length field beside them; a short vector of numbers is a mistake.
    if len(value) > field.length or (len(value) < field.length and field.type not in _BYTES):
        raise ValueError(f"{len(value)} elements; expected {expected(field)}")
    packed = []
    for index, item in enumerate(value):
        try:
            packed.append(_scalar(field, item, dialect))
        except ValueError as error:
            raise ValueError(f"[{index}]: {error}") from None
    return packed + [0] * (field.length - len(packed))


def expected(field: Field) -> str:
    """What the field takes, in words."""
    if field.type == "char":
        return f"text of at most {field.length or 1} bytes"
    if not field.length:
        return _expected_scalar(field)
    count = f"up to {field.length}" if field.type in _BYTES else str(field.length)
    return f"a list of {count} values, each {_expected_scalar(field)}"


def _expected_scalar(field: Field) -> str:
    if field.type in _FLOATS:
        return "a number or null"
    low, high = _RANGES[field.type]
    enum = f" or {'flags' if field.bitmask else 'an entry'} of {field.enum}" if field.enum else ""
    return f"an integer from {low} to {high}{enum}"


def _chars(field: Field, value: Any) -> bytes:
    if isinstance(value, str):
        # U+FFFD stands for one or more bytes that were no text: "?" always fits where those were.
        raw = value.replace(_REPLACEMENT, "?").encode("utf-8", "replace")
    elif isinstance(value, (bytes, bytearray)):
        raw = bytes(value)
    else:
        raise ValueError(f"{_short(value)} is not {expected(field)}")
    if len(raw) > (field.length or 1):
        raise ValueError(f"{len(raw)} bytes; expected {expected(field)}")
    return raw


def _scalar(field: Field, value: Any, dialect: Dialect) -> int | float:
    if field.type in _FLOATS:
        return _float(field, value)
    if isinstance(value, str) and field.enum:
        value = _parse_names(field, value, dialect)
    elif isinstance(value, float) and value.is_integer():
        value = int(value)  # JSON writers without integers say 5.0
    if not isinstance(value, int):
        raise ValueError(f"{_short(value)} is not {_expected_scalar(field)}")
    low, high = _RANGES[field.type]
    if not low <= value <= high:
        raise ValueError(f"{_short(value)} is out of range; expected {_expected_scalar(field)}")
    return int(value)


def _float(field: Field, value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{_short(value)} is not {_expected_scalar(field)}")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(f"{_short(value)} is out of range of a {field.type}") from None
    if field.type == "float" and math.isfinite(number) and abs(number) > _FLOAT_MAX:
        raise ValueError(f"{_short(value)} is out of range of a {field.type}")
    return number


def _parse_names(field: Field, given: str, dialect: Dialect) -> int:
    """The number behind "NAME", or behind "A | B | 64" where the field holds flags."""
    entries = dialect.enums.get(field.enum, {})
    parts = [part.strip() for part in given.split("|")] if field.bitmask else [given.strip()]
    number = 0
    for part in parts:
        value = entries.get(part)
        if value is None:
            try:
                value = int(part, 0)
            except ValueError:
                hint = did_you_mean(part.upper(), entries)
                raise ValueError(f"{_short(part)} is no entry of {field.enum}{hint}") from None
        number |= value
    return number


def _short(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
