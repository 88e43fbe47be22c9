"""What programs read of the key space: schemas of every payload, one AsyncAPI document, versions that move in time."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from docs import generate
from docs.compatible import breaks
from zmav import keys, schemas, wire
from zmav.cli import zmav
from zmav.errors import BadInput
from zmav.verbs import SWARM_VERBS, VERBS

Change = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module")
def stored() -> dict[str, Any]:
    document: dict[str, Any] = json.loads((generate.DOCS / "asyncapi.json").read_bytes())
    return document


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for name, inner in value.items():
            if name == "$ref":
                yield inner
            yield from references(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from references(inner)


def test_no_older_program_misreads_what_is_said_now(stored: dict[str, Any]) -> None:
    """The versions that channels and orders declare move first: see docs/compatible.py."""
    assert list(breaks(stored, schemas.asyncapi())) == []


def test_every_channel_order_and_topic_is_in_it(stored: dict[str, Any]) -> None:
    names = set(stored["channels"])
    assert {f"do.{verb}" for verb in VERBS} | {f"swarm.{verb}" for verb in SWARM_VERBS} <= names
    assert {f"fleet.{topic}" for topic in keys.TOPICS} <= names
    orders = {"do", "swarm", "fleet"}
    for channel in keys.CHANNELS.values():
        assert (channel.name in names) == (channel.kind != "token" and channel.name not in orders), channel
    for channel in stored["channels"].values():
        assert set(re.findall(r"{(\w+)}", channel["address"])) == set(channel["parameters"])
        assert channel["x-version"] >= 1


def test_every_reference_in_it_leads_somewhere(stored: dict[str, Any]) -> None:
    found = set(references(stored))
    assert len(found) > 100
    for reference in found:
        at: Any = stored
        for part in reference.removeprefix("#/").split("/"):
            at = at[part]


def test_a_payloads_schema_is_whole_by_itself() -> None:
    found = schemas.payload_schema("VehicleState")
    assert set(references(found)) == {f"#/$defs/{name}" for name in found["$defs"]}
    assert found["$schema"].endswith("2020-12/schema")
    with pytest.raises(BadInput, match=r"no payload 'State'; there are .*VehicleState"):
        schemas.payload_schema("State")


def field(name: str, value: Any) -> Change:
    return lambda d: d["components"]["schemas"]["Takeoff"]["properties"].__setitem__(name, value)


STATE = "VehicleState"
HARMLESS: dict[str, Change] = {
    "a new field": field("pitch", {"type": "number", "default": 0.0}),
    "a new channel": lambda d: d["channels"].__setitem__("new", copy.deepcopy(d["channels"]["state"])),
    "other words": lambda d: d["components"]["schemas"]["Takeoff"].__setitem__("description", "climb"),
    "another version": lambda d: (
        d["channels"]["do.takeoff"].__setitem__("x-version", 2),
        d["components"]["schemas"]["Takeoff"]["properties"].pop("alt_rel"),
    ),
}
BREAKING: dict[str, tuple[Change, str]] = {
    "a field less": (lambda d: d["components"]["schemas"]["Takeoff"]["properties"].pop("alt_rel"), "alt_rel is gone"),
    "a field that is required": (
        lambda d: d["components"]["schemas"]["Takeoff"]["required"].append("wait"),
        "Takeoff.wait is required, and was not",
    ),
    "another type": (field("alt_rel", {"type": "string"}), "alt_rel.type was 'number', is 'string'"),
    "another default": (field("wait", {"type": "number", "default": 9.0}), "wait.default was 0.5, is 9.0"),
    "one that was always told": (
        lambda d: d["components"]["schemas"][STATE]["required"].remove("instance"),
        "VehicleState.instance is not always there, and was",
    ),
    "deep in another": (
        lambda d: d["components"]["schemas"]["Gps"]["properties"].pop("hdop"),
        ".hdop is gone",
    ),
    "a channel less": (
        lambda d: d["channels"].pop("do.takeoff"),
        "do.takeoff: zmav/{fleet}/{vehicle}/do/takeoff is gone",
    ),
    "a version back": (lambda d: d["channels"]["state"].__setitem__("x-version", 0), "went back to 0"),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_an_older_program_can_live_with_passes(stored: dict[str, Any], name: str) -> None:
    now = copy.deepcopy(stored)
    HARMLESS[name](now)
    assert list(breaks(stored, now)) == []


@pytest.mark.parametrize("name", BREAKING)
def test_what_it_would_misread_wants_another_version(stored: dict[str, Any], name: str) -> None:
    now = copy.deepcopy(stored)
    change, words = BREAKING[name]
    change(now)
    assert any(words in text for text in breaks(stored, now))


def kinds(base: type[msgspec.Struct]) -> Iterator[type[msgspec.Struct]]:
    for each in base.__subclasses__():
        yield each
        yield from kinds(each)


def test_what_asks_is_strict_and_what_tells_is_not() -> None:
    """A newer ground's order or setpoint is refused whole by an older vehicle; a newer vehicle's state is read."""
    strict: list[type[msgspec.Struct]] = [verb.args for verb in (*VERBS.values(), *SWARM_VERBS.values())]
    strict += [wire.Setpoint, wire.SegmentPoint, wire.MissionItem, wire.Origin]
    strict += [wire.swarm.Obstacle, wire.swarm.Book, wire.swarm.Body]
    assert all(kind.__struct_config__.forbid_unknown_fields for kind in strict)
    told = list(kinds(wire.Told))
    assert {wire.VehicleState, wire.Event, wire.Outcome, wire.ErrorBody, wire.swarm.Beacon} <= set(told)
    assert not any(kind.__struct_config__.forbid_unknown_fields for kind in told)


def test_a_newer_vehicles_state_is_read_and_a_newer_grounds_order_is_not() -> None:
    lease = {"holder": "me", "expires": 2.0, "reach": 3}
    newer = {"t": 1.0, "fleet": "f", "name": "n", "instance": "i", "lease": lease, "mood": {"of": ["day"]}}
    state = wire.decode(json.dumps(newer).encode(), wire.VehicleState, "state")
    assert state.lease is not None
    assert (state.name, state.lease.holder) == ("n", "me")
    for kind, data in (
        (wire.Takeoff, b'{"alt_rel":5,"pitch":1}'),
        (wire.Setpoint, b'{"lease":"a","seq":1,"deadline":2,"a":1}'),
    ):
        with pytest.raises(BadInput, match="unknown field"):
            wire.decode(data, kind, "it")


def test_the_version_is_told_with_all_that_others_rely_on() -> None:
    assert re.fullmatch(r"zmav, version [\d.]+\n", CliRunner().invoke(zmav, ["--version"]).stdout)
    told = json.loads(CliRunner().invoke(zmav, ["--version", "--json"]).stdout)
    assert (told["dialect"], told["schema"]) == ("ardupilotmega", schemas.digest())
    assert told["versions"]["eclipse-zenoh"]
    assert told["channels"]["do/takeoff"] == 1
    assert CliRunner().invoke(zmav, ["--json", "ls"]).exit_code == 2
