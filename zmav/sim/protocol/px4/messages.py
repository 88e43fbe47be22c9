"""The dialect that a simulated PX4 speaks. Definitions: https://mavlink.io/en/messages/common.html"""

from __future__ import annotations

import functools

from zmav.mavlink import Dialect, Field, MessageType, load_dialect

# Numbers of the lists of items, which newer definitions have behind the others.
_LONGER = {
    "MISSION_COUNT": ("opaque_id",),
    "MISSION_ACK": ("opaque_id",),
    "MISSION_CURRENT": ("mission_id", "fence_id", "rally_points_id"),
}


def _longer(message: MessageType, names: tuple[str, ...]) -> MessageType:
    fields = [Field(name=name, type="uint32_t", extension=True) for name in names if name not in message.by_name]
    order = [field.name for field in (*message.wire_fields, *fields)]
    return MessageType.build(message.id, message.name, message.crc_extra, [*message.fields, *fields], order)


@functools.cache
def px4_dialect() -> Dialect:
    """ardupilotmega (for what a user's tools know) with the fields that PX4 has more."""
    base = load_dialect("ardupilotmega")
    longer = [_longer(base.by_name[name], fields) for name, fields in _LONGER.items()]
    return Dialect.build("px4", base.source, [*base.by_id.values(), *longer], base.enums)
