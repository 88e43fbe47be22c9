"""Read message definitions from the Python modules that come with pymavlink.

They are run on first use, because that is slow, and then dropped. Nothing is written anywhere, nothing is printed, and
no environment variable is set: pymavlink's switches that work by those are not needed for the tables alone.
"""

from __future__ import annotations

import functools
import importlib.util
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from zmav.errors import BadConfig
from zmav.mavlink.dialect import TYPE_CODES, Dialect, Field, MessageType

_DIALECTS = "pymavlink.dialects.v20"
EXPECTED = "ardupilotmega, common, development, or another dialect of pymavlink"

Enums = dict[str, dict[str, int]]


def load_dialect(name: str = "ardupilotmega") -> Dialect:
    """A dialect by pymavlink's name ("ardupilotmega", "common", "development" ...), loaded once and then kept.

    Raises :class:`BadConfig` where pymavlink has none such: its own ``mavgen`` makes one of your XML.
    """
    return _load(name)


@functools.lru_cache(maxsize=16)
def _load(name: str) -> Dialect:
    spec = importlib.util.find_spec(f"{_DIALECTS}.{name}") if re.fullmatch(r"[A-Za-z]\w*", name) else None
    if spec is None or spec.loader is None:
        raise BadConfig(f"no dialect called {name!r}", field="dialect", value=name, expected=EXPECTED)
    module = importlib.util.module_from_spec(spec)  # not by import, for what is imported stays
    spec.loader.exec_module(module)
    messages, enums = _read(module)
    vars(module).clear()  # 6 MB: typing's cache keeps a class of it, whose methods keep the module's globals
    return Dialect.build(name, str(_shipped(f"{name}.xml")), with_additions(messages), enums)


def _read(module: Any) -> tuple[list[MessageType], Enums]:
    """Messages and enums of a generated module."""
    bitmasks = {enum for enum, entries in module.enums.items() if getattr(entries, "bitmask", False)}
    enums = {enum: _entries(enum, entries) for enum, entries in module.enums.items()}
    return [_from_class(cls, bitmasks) for cls in module.mavlink_map.values()], enums


def _entries(enum: str, entries: dict[int, Any]) -> dict[str, int]:
    # The generator adds an entry X_ENUM_END, which is no part of the protocol.
    return {entry.name: value for value, entry in entries.items() if entry.name != f"{enum}_ENUM_END"}


def _from_class(cls: Any, bitmasks: set[str]) -> MessageType:
    # The generated constructor gives defaults to extension fields and to nothing else, and they come last. (The tests
    # hold this against crc_extra, which covers exactly the fields that are not extensions.)
    extensions = len(cls.__init__.__defaults__ or ())
    first_extension = len(cls.fieldnames) - extensions
    lengths = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    fields = []
    for index, (name, ctype) in enumerate(zip(cls.fieldnames, cls.fieldtypes, strict=True)):
        enum = cls.fieldenums_by_name.get(name, "")
        fields.append(
            Field(
                name=name,
                type=ctype,
                length=lengths[name],
                units=cls.fieldunits_by_name.get(name, ""),
                enum=enum,
                bitmask=cls.fielddisplays_by_name.get(name) == "bitmask" or enum in bitmasks,
                extension=index >= first_extension,
                instance=name == cls.instance_field,
            )
        )
    return MessageType.build(cls.id, cls.msgname, cls.crc_extra, fields, list(cls.ordered_fieldnames))


def read_trees(path: Path) -> list[ET.Element]:
    """The XML of a dialect and of all it includes; raises :class:`BadConfig` where one is not there."""
    roots: dict[Path, ET.Element] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop(0)
        if file not in roots:
            try:
                roots[file] = ET.parse(file).getroot()
            except (OSError, ET.ParseError) as error:
                text = f"dialect file {file}: {error}"
                raise BadConfig(text, field="dialect", value=str(file), expected="one of pymavlink's") from error
            waiting += [_shipped(Path((each.text or "").strip()).name) for each in roots[file].iter("include")]
    return list(roots.values())


def _shipped(name: str) -> Path:
    """The file of that name among pymavlink's dialects."""
    package = importlib.util.find_spec(_DIALECTS)
    folders = (package.submodule_search_locations or ["."]) if package else ["."]
    return Path(next(iter(folders)), name)


_MISSING = """
8 LINK_NODE_STATUS 117 uint64_t timestamp ms, uint8_t tx_buf %, uint8_t rx_buf %, uint32_t tx_rate bytes/s,
    uint32_t rx_rate bytes/s, uint16_t rx_parse_err bytes, uint16_t tx_overflows bytes, uint16_t rx_overflows bytes,
    uint32_t messages_sent, uint32_t messages_received, uint32_t messages_lost
380 TIME_ESTIMATE_TO_TARGET 232 int32_t safe_return s, int32_t land s, int32_t mission_next_item s,
    int32_t mission_end s, int32_t commanded_action s
410 EVENT 160 uint8_t destination_component, uint8_t destination_system, uint32_t id, uint32_t event_time_boot_ms ms,
    uint16_t sequence, uint8_t log_levels, uint8_t[40] arguments
411 CURRENT_EVENT_SEQUENCE 106 uint16_t sequence, uint8_t flags
412 REQUEST_EVENT 33 uint8_t target_system, uint8_t target_component, uint16_t first_sequence, uint16_t last_sequence
413 RESPONSE_EVENT_ERROR 77 uint8_t target_system, uint8_t target_component, uint16_t sequence,
    uint16_t sequence_oldest_available, uint8_t reason
435 AVAILABLE_MODES 134 uint8_t number_modes, uint8_t mode_index, uint8_t standard_mode, uint32_t custom_mode,
    uint32_t properties, char[35] mode_name
436 CURRENT_MODE 193 uint8_t standard_mode, uint32_t custom_mode, uint32_t intended_custom_mode
"""
"""number, name, CRC_EXTRA; then each field's type, name and unit, in declared order"""


def with_additions(messages: list[MessageType]) -> list[MessageType]:
    """``messages``, and those of the above that are not among them. Raises :class:`BadConfig` where a number or a name
    of theirs means something else there: PX4's frames would be taken for damaged ones.
    """
    taken = {m.id: m.name for m in messages}
    missing = [_message(text) for text in re.split(r"\n(?=\d)", _MISSING.strip())]
    found = [each for each in missing if taken.get(each.id) != each.name]
    for each in found:
        if each.id in taken or each.name in taken.values():
            text = f"{each.name} ({each.id}) is defined in common.xml: give your own message another number and name"
            raise BadConfig(text, field="dialect", value=each.name, expected="another number and name")
    return [*messages, *found]


def _message(text: str) -> MessageType:
    msgid, name, crc_extra, layout = text.split(maxsplit=3)
    fields = [_field(*part.split()) for part in layout.split(",")]
    order = sorted(fields, key=lambda field: -struct.calcsize(TYPE_CODES[field.type]))  # as they lie in the payload
    return MessageType.build(int(msgid), name, int(crc_extra), fields, [field.name for field in order])


def _field(kind: str, name: str, units: str = "") -> Field:
    base, _, length = kind.rstrip("]").partition("[")
    return Field(name=name, type=base, length=int(length or 0), units=units)
