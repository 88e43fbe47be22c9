"""ArduPilot's file ``@PARAM/param.pck``: all parameters in a few bytes each, to be fetched by MAVFTP.

A header of three uint16 (magic, parameters in the file, parameters in all), then for each parameter: its type and
flags, how much of its name is the name before it, the rest of the name, the value. Zeros may stand before a parameter:
they keep a value from lying across two reads, so that it never is half an old and half a new one. The layout is
described in ArduPilot's ``libraries/AP_Filesystem/README.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from itertools import takewhile
from typing import NamedTuple

PATH = "@PARAM/param.pck"
MAGIC = 0x671B
_HEADER = struct.Struct("<HHH")
_VALUES = {1: struct.Struct("<b"), 2: struct.Struct("<h"), 3: struct.Struct("<i"), 4: struct.Struct("<f")}
_OWN_TYPES = {2: 1, 4: 2, 6: 3, 9: 4}
"""MAV_PARAM_TYPE -> ArduPilot's own type"""


class PackedParam(NamedTuple):
    """A parameter; ``type`` is a MAV_PARAM_TYPE."""

    name: str
    value: float
    type: int


def pack_params(params: Iterable[PackedParam], total: int | None = None, read_size: int = 239) -> bytes:
    """The file, laid out for reads of ``read_size`` bytes. ``total``: of all parameters there are."""
    rows = list(params)
    out = bytearray(_HEADER.pack(MAGIC, len(rows), len(rows) if total is None else total))
    before = b""
    for row in rows:
        name = row.name.encode("ascii")
        alike = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(before, name, strict=False)))
        common = min(alike, len(name) - 1, 15)
        kind = _OWN_TYPES[row.type]
        value = _VALUES[kind].pack(row.value if kind == 4 else int(row.value))
        rest = name[common:]
        entry = bytes((kind, common | (len(rest) - 1) << 4)) + rest + value
        over = (len(out) + len(entry)) % read_size
        if len(value) > 1 and 0 < over < len(value):
            out += bytes(len(value) - over)
        out += entry
        before = name
    return bytes(out)
