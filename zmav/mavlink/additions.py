"""Messages that PX4 speaks and pymavlink's dialects lack: every dialect gets those that it does not define itself.

Definitions: https://mavlink.io/en/messages/common.html; the CRC_EXTRAs were held against recorded frames.
"""

from __future__ import annotations

import struct

from zmav.errors import BadConfig
from zmav.mavlink.dialect import TYPE_CODES, Field, MessageType

# Number, name, CRC_EXTRA; then each field's type, name and unit, in declared order.
_MISSING = (
    (
        8,
        "LINK_NODE_STATUS",
        117,
        "uint64_t timestamp ms, uint8_t tx_buf %, uint8_t rx_buf %, uint32_t tx_rate bytes/s, uint32_t rx_rate bytes/s,"
        "uint16_t rx_parse_err bytes, uint16_t tx_overflows bytes, uint16_t rx_overflows bytes, uint32_t messages_sent,"
        "uint32_t messages_received, uint32_t messages_lost",
    ),
    (
        380,
        "TIME_ESTIMATE_TO_TARGET",
        232,
        "int32_t safe_return s, int32_t land s, int32_t mission_next_item s, int32_t mission_end s, "
        "int32_t commanded_action s",
    ),
    (
        410,
        "EVENT",
        160,
        "uint8_t destination_component, uint8_t destination_system, uint32_t id, uint32_t event_time_boot_ms ms, "
        "uint16_t sequence, uint8_t log_levels, uint8_t[40] arguments",
    ),
    (411, "CURRENT_EVENT_SEQUENCE", 106, "uint16_t sequence, uint8_t flags"),
    (
        412,
        "REQUEST_EVENT",
        33,
        "uint8_t target_system, uint8_t target_component, uint16_t first_sequence, uint16_t last_sequence",
    ),
    (
        413,
        "RESPONSE_EVENT_ERROR",
        77,
        "uint8_t target_system, uint8_t target_component, uint16_t sequence, uint16_t sequence_oldest_available, "
        "uint8_t reason",
    ),
    (
        435,
        "AVAILABLE_MODES",
        134,
        "uint8_t number_modes, uint8_t mode_index, uint8_t standard_mode, uint32_t custom_mode, uint32_t properties, "
        "char[35] mode_name",
    ),
    (436, "CURRENT_MODE", 193, "uint8_t standard_mode, uint32_t custom_mode, uint32_t intended_custom_mode"),
)


def with_additions(messages: list[MessageType]) -> list[MessageType]:
    """``messages``, and those of the above that are not among them. Raises :class:`BadConfig` where a number or a name
    of theirs means something else there: PX4's frames would be taken for damaged ones.
    """
    taken = {m.id: m.name for m in messages}
    found = [_message(*each) for each in _MISSING if taken.get(each[0]) != each[1]]
    for each in found:
        if each.id in taken or each.name in taken.values():
            text = f"{each.name} ({each.id}) is defined in common.xml: give your own message another number and name"
            raise BadConfig(text, field="dialect", value=each.name, expected="another number and name")
    return [*messages, *found]


def _message(msgid: int, name: str, crc_extra: int, text: str) -> MessageType:
    fields = [_field(*part.split()) for part in text.split(",")]
    order = sorted(fields, key=lambda field: -struct.calcsize(TYPE_CODES[field.type]))  # as they lie in the payload
    return MessageType.build(msgid, name, crc_extra, fields, [field.name for field in order])


def _field(kind: str, name: str, units: str = "") -> Field:
    base, _, length = kind.rstrip("]").partition("[")
    return Field(name=name, type=base, length=int(length or 0), units=units)
