"""Schemas that Foxglove's reader understands: one type for each field, no references, no alternatives."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from ground.record import schemas
from zmav import keys, wire
from zmav.mavlink import Dialect

TYPES = {"object", "array", "string", "number", "integer", "boolean"}


def parts(table: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield table
    for inner in table.get("properties", {}).values():
        yield from parts(inner)
    if "items" in table:
        yield from parts(table["items"])


def check(schema: schemas.Schema) -> dict[str, Any]:
    table: dict[str, Any] = json.loads(schema.data)
    assert table["type"] == "object"
    for part in parts(table):
        assert part["type"] in TYPES
        assert (part["type"] == "array") == ("items" in part)
        assert not {"$ref", "$defs", "anyOf", "prefixItems"} & part.keys()
    return table


PAYLOADS = sorted({c.payload for c in keys.CHANNELS.values() if c.recorded and c.payload}, key=str)


@pytest.mark.parametrize("kind", [*PAYLOADS, wire.NeighbourQuality], ids=lambda kind: kind.__name__)
def test_payloads(kind: Any) -> None:
    table = check(schemas.of_payload(kind))
    assert list(table["properties"])[-1] == kind.__struct_encode_fields__[-1]
    assert set(kind.__struct_encode_fields__) <= table["properties"].keys()


def test_what_is_inside_is_spelt_out() -> None:
    table = check(schemas.of_payload(wire.VehicleState))["properties"]
    assert table["position"]["properties"]["lat_deg"] == {"type": "number"}
    assert table["velocity"] == {"type": "array", "items": {"type": "number"}}
    assert table["armed"] == {"type": "boolean"}


def test_signals_are_numbers_by_their_names() -> None:
    table = check(schemas.of_signals(wire.Signals(t=1.0, values={"is.x": 2.0, "took_us": 400.0})))["properties"]
    assert table["values"]["properties"] == {"is.x": {"type": "number"}, "took_us": {"type": "number"}}
    many = wire.Signals(t=1.0, values={f"s{i}": 0.0 for i in range(1000)})
    listed = check(schemas.of_signals(many))["properties"]["values"]["properties"]
    assert list(listed) == [f"s{i}" for i in range(schemas.MOST_NAMED)]


def test_messages(dialect: Dialect) -> None:
    for message in dialect.by_id.values():
        table = check(schemas.of_message(message, dialect))
        assert list(table["properties"]) == [field.name for field in message.fields]
    heartbeat = json.loads(schemas.of_message(dialect.by_name["HEARTBEAT"], dialect).data)["properties"]
    assert {"title": "MAV_TYPE_QUADROTOR", "const": 2} in heartbeat["type"]["oneOf"]
    assert "128: MAV_MODE_FLAG_SAFETY_ARMED" in heartbeat["base_mode"]["description"]
    position = json.loads(schemas.of_message(dialect.by_name["GLOBAL_POSITION_INT"], dialect).data)["properties"]
    assert position["lat"] == {"type": "integer", "description": "degE7"}


def test_what_is_made_for_foxglove_is_as_its_schema_says() -> None:
    place = wire.GlobalPosition(lat_deg=1.0, lon_deg=2.0, alt_amsl=3.0, alt_rel=0.0)
    state = wire.VehicleState(t=5.25, fleet="demo", name="quad1", instance="i", position=place)
    fix = schemas.location(state)
    assert fix is not None
    assert set(json.loads(fix)) == set(check(schemas.LOCATION)["properties"])
    assert json.loads(fix)["timestamp"] == {"sec": 5, "nsec": 250_000_000}
    assert (json.loads(fix)["latitude"], json.loads(fix)["altitude"]) == (1.0, 3.0)
    assert schemas.location(wire.VehicleState(t=5.0, fleet="demo", name="quad1", instance="i")) is None
