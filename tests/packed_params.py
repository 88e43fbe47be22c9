"""Reads ArduPilot's file ``@PARAM/param.pck`` again: see :mod:`zmav.mavlink.packed_params`, which writes it."""

from __future__ import annotations

import struct

from zmav.mavlink.packed_params import MAGIC, PackedParam

_HEADER = struct.Struct("<HHH")
_VALUES = {1: struct.Struct("<b"), 2: struct.Struct("<h"), 3: struct.Struct("<i"), 4: struct.Struct("<f")}
_TYPES = {1: 2, 2: 4, 3: 6, 4: 9}
"""ArduPilot's own type -> MAV_PARAM_TYPE"""


def unpack_params(data: bytes) -> list[PackedParam]:
    """The parameters of such a file."""
    magic, count, _ = _HEADER.unpack_from(data)
    assert magic == MAGIC
    found: list[PackedParam] = []
    at, before = _HEADER.size, b""
    for _ in range(count):
        while data[at] == 0:
            at += 1
        kind, flags, common, length = data[at] & 15, data[at] >> 4, data[at + 1] & 15, (data[at + 1] >> 4) + 1
        assert not flags and common <= len(before) and common + length <= 16
        layout, begin = _VALUES[kind], at + 2 + length
        name = before[:common] + data[at + 2 : begin]
        (value,) = layout.unpack_from(data, begin)
        found.append(PackedParam(name.decode("ascii"), float(value), _TYPES[kind]))
        at, before = begin + layout.size, name
    assert at == len(data)
    return found
