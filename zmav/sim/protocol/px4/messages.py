"""Messages that PX4 speaks and pymavlink's ardupilotmega dialect lacks.

Definitions: https://mavlink.io/en/messages/common.html and development.html; the checksums' seeds (CRC_EXTRA) were held
against recorded frames.
"""

from __future__ import annotations

import functools

from zmav.mavlink.dialect import Dialect, Field, MessageType, load_dialect


def _fields(text: str) -> list[Field]:
    """Fields of a line such as ``"uint32_t id, uint8_t[40] arguments"``."""
    fields = []
    for part in text.split(","):
        kind, name = part.split()
        base, _, length = kind.partition("[")
        fields.append(Field(name=name, type=base, length=int(length.rstrip("]") or 0) if length else 0))
    return fields


# Number, name, CRC_EXTRA, and the fields in the order of the payload.
_MISSING = (
    (
        8,
        "LINK_NODE_STATUS",
        117,
        "uint64_t timestamp, uint32_t tx_rate, uint32_t rx_rate, uint32_t messages_sent, uint32_t messages_received, "
        "uint32_t messages_lost, uint16_t rx_parse_err, uint16_t tx_overflows, uint16_t rx_overflows, uint8_t tx_buf, "
        "uint8_t rx_buf",
    ),
    (
        380,
        "TIME_ESTIMATE_TO_TARGET",
        232,
        "int32_t safe_return, int32_t land, int32_t mission_next_item, int32_t mission_end, int32_t commanded_action",
    ),
    (
        410,
        "EVENT",
        160,
        "uint32_t id, uint32_t event_time_boot_ms, uint16_t sequence, uint8_t destination_component, "
        "uint8_t destination_system, uint8_t log_levels, uint8_t[40] arguments",
    ),
    (411, "CURRENT_EVENT_SEQUENCE", 106, "uint16_t sequence, uint8_t flags"),
    (
        412,
        "REQUEST_EVENT",
        33,
        "uint16_t first_sequence, uint16_t last_sequence, uint8_t target_system, uint8_t target_component",
    ),
    (
        413,
        "RESPONSE_EVENT_ERROR",
        77,
        "uint16_t sequence, uint16_t sequence_oldest_available, uint8_t target_system, uint8_t target_component, "
        "uint8_t reason",
    ),
    (
        435,
        "AVAILABLE_MODES",
        134,
        "uint32_t custom_mode, uint32_t properties, uint8_t number_modes, uint8_t mode_index, uint8_t standard_mode, "
        "char[35] mode_name",
    ),
    (436, "CURRENT_MODE", 193, "uint32_t custom_mode, uint32_t intended_custom_mode, uint8_t standard_mode"),
)


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
    """ardupilotmega (for what a user's tools know) with PX4's own messages."""
    base = load_dialect("ardupilotmega")
    extra = [_longer(base.by_name[name], fields) for name, fields in _LONGER.items()]
    for msgid, name, seed, text in _MISSING:
        fields = _fields(text)
        extra.append(MessageType.build(msgid, name, seed, fields, [f.name for f in fields]))
    return Dialect.build("px4", base.source, [*base.by_id.values(), *extra], base.enums)
