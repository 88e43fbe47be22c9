"""The four bytes in which PARAM_VALUE and PARAM_SET carry a value of any type, in either of the two encodings.

C_CAST (ArduPilot): the value converted to a 32-bit float, so that integers beyond 2^24 lose their last digits.
BYTEWISE (PX4): the value's own bytes, little-endian, laid into the float field.
https://mavlink.io/en/services/parameter.html#parameter-encoding
"""

from __future__ import annotations

import enum
import math
import struct

from zmav.errors import BadInput, Unsupported
from zmav.wire import PARAM_TYPES

Value = float | int | None
"""None: not a number"""

_FLOAT = struct.Struct("<f")
_FLOAT_MAX = _FLOAT.unpack(b"\xff\xff\x7f\x7f")[0]
_BYTEWISE = {
    "UINT8": struct.Struct("<Bxxx"),
    "INT8": struct.Struct("<bxxx"),
    "UINT16": struct.Struct("<Hxx"),
    "INT16": struct.Struct("<hxx"),
    "UINT32": struct.Struct("<I"),
    "INT32": struct.Struct("<i"),
    "REAL32": _FLOAT,
}
_REALS = ("REAL32", "REAL64")


class ParamEncoding(str, enum.Enum):
    C_CAST = "c_cast"
    BYTEWISE = "bytewise"


def type_name(number: int) -> str | None:
    """The type's name of a MAV_PARAM_TYPE; None where there is no such type."""
    return PARAM_TYPES[number - 1] if 1 <= number <= len(PARAM_TYPES) else None


def type_number(name: str) -> int:
    """MAV_PARAM_TYPE of a type's name."""
    return PARAM_TYPES.index(name) + 1


def value_of(raw: bytes, kind: str, encoding: ParamEncoding) -> Value:
    """The value behind the field's four bytes, floats as a person writes them (0.1 and not 0.10000000149)."""
    if encoding is ParamEncoding.BYTEWISE and kind not in _REALS and kind in _BYTEWISE:
        return int(_BYTEWISE[kind].unpack(raw)[0])
    number = _FLOAT.unpack(raw)[0]
    if not math.isfinite(number):
        return None
    return shortest(number) if kind in _REALS else round(number)


def raw_of(name: str, value: float | int, kind: str, encoding: ParamEncoding) -> bytes:
    """The field's four bytes; raises :class:`BadInput` where the type or the encoding cannot hold the value."""
    number = _checked(name, value, kind)
    if encoding is ParamEncoding.BYTEWISE:
        if kind not in _BYTEWISE:
            raise Unsupported(f"{name} is {kind}: four bytes cannot carry it", field="type", value=kind)
        return _BYTEWISE[kind].pack(number)
    raw = _FLOAT.pack(number)
    if kind not in _REALS and _FLOAT.unpack(raw)[0] != number:
        near = int(_FLOAT.unpack(raw)[0])
        text = f"{name}: this autopilot takes integers as 32-bit floats, which cannot hold {number}; {near} is near"
        raise BadInput(text, field=name, value=value, expected=f"an integer such as {near}")
    return raw


def _checked(name: str, value: float | int, kind: str) -> float | int:
    """The value as its type takes it."""
    if isinstance(value, bool) or (isinstance(value, float) and not math.isfinite(value)):
        raise BadInput(f"{name}: {value!r} is not a number", field=name, value=repr(value), expected="a number")
    if kind in _REALS:
        if abs(value) > _FLOAT_MAX:
            text = f"{name}: {_clip(value)} is beyond a 32-bit float"
            raise BadInput(text, field=name, value=_clip(value), expected=f"±{_FLOAT_MAX:.6g} at most")
        return float(value)
    low, high = bounds(kind)
    expected = f"an integer from {low} to {high}"
    if value != int(value):
        text = f"{name} is {kind} and takes integers; {value!r} is none"
        raise BadInput(text, field=name, value=value, expected=expected)
    if not low <= value <= high:
        text = f"{name} is {kind} and cannot hold {_clip(value)}"
        raise BadInput(text, field=name, value=_clip(value), expected=expected)
    return int(value)


def _clip(value: float | int) -> str:
    """JSON's integers have no end."""
    shown = repr(value) if abs(value) < 1 << 64 or isinstance(value, float) else hex(value)
    return shown if len(shown) <= 30 else f"{shown[:30]}..."


def bounds(kind: str) -> tuple[int, int]:
    """The least and the greatest value of an integer type."""
    bits = int(kind.lstrip("UINT"))
    return (0, 2**bits - 1) if kind.startswith("U") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def as_field(raw: bytes) -> float:
    """The four bytes as the number to give for the float field.

    Raises :class:`Unsupported` for the bytes of a signalling NaN (the integers -8388607 to -4194305 and 2139095041 to
    2143289343, bytewise): they would not come out of a floating-point register as they went in.
    """
    number: float = _FLOAT.unpack(raw)[0]
    if _FLOAT.pack(number) != raw:
        text = f"the bytes {raw.hex()} are a signalling NaN and cannot be sent unharmed"
        raise Unsupported(text, field="value", value=raw.hex())
    return number


def float32(value: float) -> float:
    """As the value travels: rounded to a 32-bit float; what is beyond one becomes infinite."""
    return float(_FLOAT.unpack(_FLOAT.pack(value))[0]) if abs(value) <= _FLOAT_MAX else math.copysign(math.inf, value)


def shortest(value: float) -> float:
    """The number with the fewest digits that is the same 32-bit float: what a person wrote to get it."""
    for digits in (6, 7, 8, 9):
        candidate = float(f"{value:.{digits}g}")
        if float32(candidate) == value:
            return candidate
    return value  # the largest there is: rounded to fewer digits it is beyond itself


def same(one: Value, other: Value) -> bool:
    """Equal as they travel: floats as 32-bit floats, integers exactly."""
    if one is None or other is None:
        return one is other
    if isinstance(one, int) and isinstance(other, int):
        return one == other
    return float32(float(one)) == float32(float(other))
