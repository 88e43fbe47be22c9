"""ArduPilot's files ``@MISSION/mission.dat``, ``fence.dat`` and ``rally.dat``: a whole plan each, by MAVFTP.

A header of five uint16 (magic, MAV_MISSION_TYPE, options, number of the first item, how many items), then every item
as the whole payload of a MISSION_ITEM_INT, addressed to nobody. The layout is that of ArduPilot's
``libraries/AP_Filesystem/AP_Filesystem_Mission.h``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from zmav.errors import BadMessage
from zmav.mavlink.codec import unpack
from zmav.mavlink.dialect import Dialect

PATH = "@MISSION/{}.dat"
"""of "mission", "fence" or "rally\""""
ITEM = "MISSION_ITEM_INT"
MAGIC = 0x763D
HEADER = struct.Struct("<5H")


def pack_header(kind: int, count: int) -> bytes:
    """Of a whole plan of ``kind`` (MAV_MISSION_TYPE)."""
    return HEADER.pack(MAGIC, kind, 0, 0, count)


def count_of(data: bytes | bytearray, kind: int) -> int:
    """How many items the header announces; raises :class:`BadMessage` where it is none of a whole plan of ``kind``."""
    if len(data) < HEADER.size or HEADER.unpack_from(data)[:4] != (MAGIC, kind, 0, 0):
        expected = pack_header(kind, 0)[:-2].hex()
        found = bytes(data[: HEADER.size]).hex()
        raise BadMessage(f"a plan's file begins with {found}", field="header", value=found, expected=expected)
    return int(HEADER.unpack_from(data)[4])


def size_of(count: int, dialect: Dialect) -> int:
    """Bytes of a file of ``count`` items."""
    return HEADER.size + count * dialect.message(ITEM).max_length


def pack_item(fields: Mapping[str, Any], dialect: Dialect) -> bytes:
    """An item with the fields of a MISSION_ITEM_INT; those it lacks are zero."""
    message = dialect.message(ITEM)
    return message.struct.pack(*(fields.get(field.name, 0) for field in message.wire_fields))


def unpack_items(data: bytes | bytearray, dialect: Dialect) -> list[dict[str, Any]]:
    """The fields of every whole item behind the header."""
    message = dialect.message(ITEM)
    size = message.max_length
    return [unpack(message, bytes(data[at : at + size])) for at in range(HEADER.size, len(data) - size + 1, size)]
