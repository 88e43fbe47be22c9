"""Messages in mavlink2rest's JSON, and back.

Enums are ``{"type": "MAV_TYPE_QUADROTOR"}``, flags ``"A | B"``, char arrays strings, and a field called ``type`` is
``mavtype``, because ``type`` holds the message's name. See https://github.com/mavlink/mavlink2rest and the JSON of
rust-mavlink's serde feature.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from zmav.errors import BadMessage
from zmav.mavlink import Dialect, Frame, decode, encode
from zmav.mavlink.dialect import Field, MessageType
from zmav.mavlink.values import to_json

MAVTYPE = "mavtype"
HEADER = ("system_id", "component_id", "sequence")


def document(frame: Frame, dialect: Dialect) -> dict[str, Any]:
    """``{"header": ..., "message": ...}`` as the WebSocket sends it; raises :class:`BadMessage` for what is unknown."""
    header = {"system_id": frame.sysid, "component_id": frame.compid, "sequence": frame.seq}
    return {"header": header, "message": message(frame, dialect)}


def message(frame: Frame, dialect: Dialect) -> dict[str, Any]:
    """``type`` and the fields; raises :class:`BadMessage` for what the dialect lacks.

    NaN and infinities stay what they are: msgspec's JSON has null for them.
    """
    plain, kind = decode(frame, dialect), dialect.by_id[frame.msgid]
    if "type" in kind.by_name:
        plain = {_name(kind.by_name[name]): value for name, value in plain.items()}
    for field in kind.enum_fields:
        plain[_name(field)] = _shown(field, plain[_name(field)], dialect)
    return {"type": kind.name, **plain}


def template(name: str, dialect: Dialect, source: tuple[int, int]) -> dict[str, Any]:
    """A message to fill in, every field with its default: zeros, an enum's first entry, a first flag.

    Raises :class:`BadMessage` for a name the dialect lacks.
    """
    kind = dialect.message(name)
    fields = {_name(field): _default(field, dialect) for field in kind.wire_fields}
    return {"header": dict(zip(HEADER, (*source, 0), strict=True)), "message": {"type": kind.name, **fields}}


def frame_of(given: Any, dialect: Dialect, source: tuple[int, int], next_seq: Callable[[int, int], int]) -> bytes:
    """The frame of a document as it is posted; raises :class:`BadMessage` naming every fault.

    Extension fields may be left out, and of the header what is to be ours. The sequence number is counted here: a
    client's own is 0 for ever.
    """
    if not isinstance(given, Mapping) or not isinstance(given.get("message"), Mapping):
        raise BadMessage('expected {"header": {...}, "message": {"type": NAME, ...}}', field="message")
    name = given["message"].get("type")
    if not isinstance(name, str):
        raise BadMessage("the message has no type: expected a message's name", field="type", value=name)
    kind = dialect.message(name)
    header = _header(given.get("header", {}), source)
    fields = {}
    for key, value in given["message"].items():
        if key != "type":
            name = _field_name(key, kind)
            fields[name] = _plain(value, kind.by_name.get(name))
    try:
        return encode(dialect, kind.name, fields, sysid=header[0], compid=header[1], seq=next_seq(*header))
    except BadMessage as e:
        raise _named_as_given(kind, e) from e


def _named_as_given(kind: MessageType, error: BadMessage) -> BadMessage:
    """The same error, with the name that a field has here."""
    bad = {MAVTYPE if name == "type" else name: why for name, why in error.detail.get("fields", {}).items()}
    listed = "; ".join(f"{name}: {why}" for name, why in bad.items())
    return BadMessage(f"{kind.name} cannot be encoded: {listed}", fields=bad) if bad else error


def _header(given: Any, source: tuple[int, int]) -> tuple[int, int]:
    """Whom it is from."""
    if not isinstance(given, Mapping):
        raise BadMessage("the header is no object", field="header", value=given, expected=", ".join(HEADER))
    unknown = [str(key) for key in given if key not in HEADER]
    if unknown:
        raise BadMessage(f"the header has no {unknown[0]}; it has {', '.join(HEADER)}", field=unknown[0])
    found = given.get("system_id", source[0]), given.get("component_id", source[1])
    if not all(type(each) is int and 0 <= each <= 255 for each in found):
        raise BadMessage(f"the header's ids are {found[0]!r} and {found[1]!r}", field="header", expected="0 to 255")
    return found


def _name(field: Field) -> str:
    return MAVTYPE if field.name == "type" else field.name


def _field_name(key: str, kind: MessageType) -> str:
    return "type" if key == MAVTYPE and "type" in kind.by_name else key


def _shown(field: Field, value: Any, dialect: Dialect) -> Any:
    if field.type in ("float", "double"):  # PARAM_SET's value and its like: a number all the same
        return value
    if isinstance(value, list):
        return [_shown(field, each, dialect) for each in value]
    if field.bitmask:
        return to_json(field, value, dialect) if value else ""
    return {"type": to_json(field, value, dialect)}


def _plain(value: Any, field: Field | None) -> Any:
    """What :func:`zmav.mavlink.encode` takes for a value in this face's shape."""
    if isinstance(value, Mapping):
        if len(value) == 1 and "type" in value:
            return value["type"]
        if len(value) == 1 and "bits" in value:  # flags as older versions had them
            return value["bits"]
        return dict(value)  # the encoder says what it expected
    if isinstance(value, list):
        return [_plain(each, field) for each in value]
    return 0 if value == "" and field is not None and field.bitmask else value


def _default(field: Field, dialect: Dialect) -> Any:
    if field.type == "char":
        return ""
    one = _default_scalar(field, dialect)
    return [one] * field.length if field.length else one


def _default_scalar(field: Field, dialect: Dialect) -> Any:
    if field.type in ("float", "double"):
        return 0.0
    entries = dialect.enum_names.get(field.enum)
    if field.name == "mavlink_version":
        return 3
    if not entries:
        return 0
    if field.bitmask:
        return next((name for value, name in sorted(entries.items()) if value > 0), "")
    return {"type": entries[min(entries)]}
