"""JSON Schemas of what is recorded: from the payload types, from the dialect, and those that Foxglove knows by name.

Readers are less able than the standard: Foxglove wants an object on top, one type for each field, arrays of one kind
and no references. So what :func:`msgspec.json.schema` makes is simplified to that. Values may be null nevertheless.
Foxglove's schemas: https://docs.foxglove.dev/docs/sdk/schemas
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import msgspec

from zmav import wire
from zmav.mavlink import Dialect
from zmav.mavlink.dialect import Field, MessageType

Table = dict[str, Any]
JSON, BYTES, FRAMES, CDR = "json", "application/octet-stream", "mavlink", "cdr"
"""message encodings: ``mavlink`` is one frame, byte for byte; ``cdr`` a message of ROS 2"""
AS_IT_CAME, ALL_FRAMES, DECODED, DERIVED = "as it came", "frames", "decoded", "derived"
"""what a topic holds: the payloads of the key that it is called by; every frame of a vehicle; the frames of one key,
decoded; or what was made of other topics for a reader's sake. Only the first two are played again."""
MOST_NAMED = 400
"""entries of an enumeration, and signals, that are named; no dialect's enumeration is longer"""


class Schema(NamedTuple):
    """As it stands in a file; ``data`` is JSON, or a definition of ROS where ``encoding`` says so."""

    name: str
    data: bytes
    encoding: str = "jsonschema"


def of_payload(kind: type[msgspec.Struct]) -> Schema:
    """Of a payload type of :mod:`zmav.wire`."""
    whole = msgspec.json.schema(kind)
    return _schema(f"zmav.{kind.__name__}", _simple(whole, whole.get("$defs", {}), ()))


def of_signals(sample: wire.Signals) -> Schema:
    """Of an agent's stream, with the names of its numbers as they are in ``sample``, so many as are named at most."""
    names = list(sample.values)[:MOST_NAMED]
    values: Table = {"type": "object", "properties": {name: {"type": "number"} for name in names}}
    return _schema("zmav.Signals", {"type": "object", "properties": {"t": {"type": "number"}, "values": values}})


def of_any(name: str) -> Schema:
    """Of JSON objects that nobody described."""
    return _schema(name, {"type": "object", "properties": {}})


def of_message(message: MessageType, dialect: Dialect) -> Schema:
    """Of a message decoded by :class:`ground.record.decoder.Decoder`."""
    properties = {field.name: _field(field, dialect) for field in message.fields}
    return _schema(f"mavlink.{message.name}", {"type": "object", "title": message.name, "properties": properties})


def _schema(name: str, table: Table) -> Schema:
    return Schema(name, msgspec.json.encode(table))


def _field(field: Field, dialect: Dialect) -> Table:
    words = [field.units and f"{field.units}", field.enum and f"{'flags' if field.bitmask else 'enum'} {field.enum}"]
    scalar: Table = {"type": "number" if field.type in ("float", "double") else "integer"}
    if field.type == "char":
        return _described({"type": "string"}, words)
    entries = dialect.enums.get(field.enum, {})
    if entries and field.bitmask:
        words.append(", ".join(f"{value}: {name}" for name, value in list(entries.items())[:MOST_NAMED]))
    elif entries:
        scalar["oneOf"] = [{"title": name, "const": value} for name, value in list(entries.items())[:MOST_NAMED]]
    return _described({"type": "array", "items": scalar} if field.length else scalar, words)


def _described(table: Table, words: list[str]) -> Table:
    said = "; ".join(filter(None, words))
    return {**table, "description": said} if said else table


def _simple(table: Table, defined: Table, within: tuple[str, ...]) -> Table:
    """One schema, without what readers do not know."""
    if "$ref" in table:
        name = table["$ref"].rpartition("/")[2]
        return {"type": "object"} if name in within else _simple(defined[name], defined, (*within, name))
    for choice in ("anyOf", "oneOf"):
        if choice in table:
            kinds = [kind for kind in table[choice] if kind.get("type") != "null"]
            return _simple(kinds[0], defined, within) if kinds else {"type": "object"}
    found: Table = {"type": table["type"]} if "type" in table else _of_values(table)
    if "description" in table:
        found["description"] = " ".join(table["description"].split())
    if found["type"] == "array":
        items: Table = table.get("items") or next(iter(table.get("prefixItems", [])), {})
        found["items"] = _simple(items, defined, within)
    if found["type"] == "object":
        parts = table.get("properties", {})
        found["properties"] = {name: _simple(part, defined, within) for name, part in parts.items()}
    return found


def _of_values(table: Table) -> Table:
    values = [value for value in (*table.get("enum", ()), table.get("const")) if value is not None]
    if values:
        return {"type": "string" if isinstance(values[0], str) else "number"}
    return {"type": "object"}  # anything at all


_TIME: Table = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_STRING: Table = {"type": "string"}
_NUMBER: Table = {"type": "number"}
LOCATION = _schema(
    "foxglove.LocationFix",
    {
        "type": "object",
        "title": "foxglove.LocationFix",
        "properties": {
            "timestamp": _TIME,
            "frame_id": _STRING,
            "latitude": _NUMBER,
            "longitude": _NUMBER,
            "altitude": _NUMBER,
            "position_covariance": {"type": "array", "items": _NUMBER},
            "position_covariance_type": {"type": "integer"},
        },
    },
)


def _time(t: float) -> Table:
    part, whole = math.modf(t)
    return {"sec": int(whole), "nsec": int(part * 1e9)}


def location(state: wire.VehicleState) -> bytes | None:
    """A vehicle's place for Foxglove's map (altitude AMSL); None where it has none."""
    place = state.position
    if place is None:
        return None
    return msgspec.json.encode(
        {
            "timestamp": _time(state.t),
            "frame_id": state.name,
            "latitude": place.lat_deg,
            "longitude": place.lon_deg,
            "altitude": place.alt_amsl,
            "position_covariance": [0.0] * 9,
            "position_covariance_type": 0,
        }
    )
