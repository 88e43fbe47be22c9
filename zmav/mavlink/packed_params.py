"""ArduPilot's file ``@PARAM/param.pck``: all parameters in a few bytes each, to be fetched by MAVFTP.

A header of three uint16 (magic, parameters in the file, parameters in all), then for each parameter: its type and
flags, how much of its name is the name before it, the rest of the name, the value. Zeros may stand before a parameter:
they keep a value from lying across two reads, so that it never is half an old and half a new one. The layout is
described in ArduPilot's ``libraries/AP_Filesystem/README.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from zmav.errors import BadMessage

PATH = "@PARAM/param.pck"
MAGIC, MAGIC_WITH_DEFAULTS = 0x671B, 0x671C
_HEADER = struct.Struct("<HHH")
_VALUES = {1: struct.Struct("<b"), 2: struct.Struct("<h"), 3: struct.Struct("<i"), 4: struct.Struct("<f")}
_TYPES = {1: 2, 2: 4, 3: 6, 4: 9}
"""ArduPilot's own type -> MAV_PARAM_TYPE"""
_OWN_TYPES = {mav: own for own, mav in _TYPES.items()}
_LONGEST_NAME = 16


class PackedParam(NamedTuple):
    """A parameter; ``type`` is a MAV_PARAM_TYPE, ``default`` is given where the file tells it and it differs."""

    name: str
    value: float
    type: int
    default: float | None = None


def pack_params(
    params: Iterable[PackedParam], total: int | None = None, read_size: int = 239, *, with_defaults: bool = False
) -> bytes:
    """The file, laid out for reads of ``read_size`` bytes. ``total``: of all parameters there are."""
    rows = list(params)
    magic = MAGIC_WITH_DEFAULTS if with_defaults else MAGIC
    out = bytearray(_HEADER.pack(magic, len(rows), len(rows) if total is None else total))
    before = b""
    for row in rows:
        name = row.name.encode("ascii")
        common = min(_common(before, name), len(name) - 1, 15)
        kind = _OWN_TYPES[row.type]
        value = _pack_value(kind, row.value)
        default = b"" if row.default is None or not with_defaults else _pack_value(kind, row.default)
        rest = name[common:]
        entry = bytes((kind | bool(default) << 4, common | (len(rest) - 1) << 4)) + rest + value + default
        over = (len(out) + len(entry)) % read_size
        if len(value) > 1 and 0 < over < len(value):
            out += bytes(len(value) - over)
        out += entry
        before = name
    return bytes(out)


def _pack_value(kind: int, value: float) -> bytes:
    return _VALUES[kind].pack(value if kind == 4 else int(value))


def unpack_params(data: bytes) -> list[PackedParam]:
    """The parameters of such a file; raises :class:`BadMessage` for what is none, or not whole."""
    if len(data) < _HEADER.size:
        raise _bad("it has no header")
    magic, count, _ = _HEADER.unpack_from(data)
    if magic not in (MAGIC, MAGIC_WITH_DEFAULTS):
        raise _bad(f"it begins with 0x{magic:04x}")
    found: list[PackedParam] = []
    at, before = _HEADER.size, b""
    for _ in range(count):
        while at < len(data) and data[at] == 0:
            at += 1
        if at + 2 > len(data):
            raise _bad(f"it ends after {len(found)} of {count} parameters")
        kind, flags, common, length = data[at] & 15, data[at] >> 4, data[at + 1] & 15, (data[at + 1] >> 4) + 1
        layout = _VALUES.get(kind)
        if layout is None or common > len(before) or common + length > _LONGEST_NAME:
            raise _bad(f"parameter {len(found)} makes no sense")
        end = at + 2 + length + layout.size * (2 if flags & 1 else 1)
        if end > len(data):
            raise _bad(f"it ends after {len(found)} of {count} parameters")
        name = before[:common] + data[at + 2 : at + 2 + length]
        values = [float(v) for (v,) in layout.iter_unpack(data[at + 2 + length : end])]
        found.append(PackedParam(name.decode("ascii", "replace"), values[0], _TYPES[kind], *values[1:]))
        at, before = end, name
    return found


def _common(a: bytes, b: bytes) -> int:
    count = 0
    for x, y in zip(a, b, strict=False):
        if x != y:
            break
        count += 1
    return count


def _bad(why: str) -> BadMessage:
    return BadMessage(f"not a file of packed parameters: {why}", field="data", value="", expected=PATH)
