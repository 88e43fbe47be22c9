"""Makes private/messages.txt, by which the toolbox decodes frames: ``python ground/matlab/messages.py`` after a change.

A line for each message: its id, name, crc_extra, and its fields in the payload's order as name:type:count.
"""

from __future__ import annotations

from pathlib import Path

from zmav.mavlink import load_dialect
from zmav.mavlink.dialect import Field, MessageType

TABLE = Path(__file__).resolve().parent / "private" / "messages.txt"
TYPES = {"char": "char", "float": "single", "double": "double"}


def table(dialect: str = "ardupilotmega") -> str:
    """The file's text."""
    messages = load_dialect(dialect).by_id
    return "".join(_line(messages[msgid]) for msgid in sorted(messages))


def _line(message: MessageType) -> str:
    fields = " ".join(_field(field) for field in message.wire_fields)
    return f"{message.id} {message.name} {message.crc_extra} {fields}\n"


def _field(field: Field) -> str:
    return f"{field.name}:{TYPES.get(field.type, field.type.removesuffix('_t'))}:{field.length or 1}"


if __name__ == "__main__":
    TABLE.write_text(table())
    print(f"{TABLE}: {len(table().splitlines())} messages")
