"""What travels under the keys, for programs: JSON Schema of each payload, and one AsyncAPI document of the key space.

Both are made of :data:`zmav.keys.CHANNELS`, :data:`zmav.verbs.VERBS` and the payloads' own types, so they are true of
the zmav that makes them. Sources: JSON Schema 2020-12; https://www.asyncapi.com/docs/reference/specification/v3.0.0.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import itertools
import re
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any, NamedTuple

import msgspec

from zmav import keys, wire
from zmav.errors import BadInput
from zmav.trust.roster import SignedRoster
from zmav.verbs import SWARM_VERBS, VERBS

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ASYNCAPI = "asyncapi"
"""the name under which the whole document is asked for"""
_REF = "#/components/schemas/{name}"


class Spoken(NamedTuple):
    """What is said on one key expression, ``address``, and in which version."""

    name: str
    """``state``, ``do/takeoff``, ``fleet/goal``"""
    address: str
    channel: keys.Channel
    payload: type | None
    """None: bytes, or a token, which carries nothing"""
    others: tuple[type, ...]
    """what a query carries, or a second kind that is published"""
    writers: tuple[str, ...]
    version: int
    doc: str


@functools.cache
def channel_docs() -> dict[str, str]:
    """What stands below each channel in the registry, by the channel's name."""
    found = {}
    for node, doc in itertools.pairwise(ast.parse(inspect.getsource(keys)).body):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            channel = getattr(keys, node.targets[0].id, None)
            if isinstance(channel, keys.Channel) and isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant):
                found[channel.name] = str(doc.value.value)
    return found


def spoken() -> Iterator[Spoken]:
    """Every channel; those of orders and of the fleet's topics by verb and by topic."""
    docs = channel_docs()
    for c in keys.CHANNELS.values():
        address, doc = f"{keys.ROOT}/{c.template}", docs[c.name]
        if c is keys.DO or c is keys.SWARM:
            for verb in (VERBS if c is keys.DO else SWARM_VERBS).values():
                where = address.replace("{verb}", verb.name)
                yield Spoken(
                    f"{c.name}/{verb.name}", where, c, c.payload, (verb.args,), verb.writers, verb.version, verb.doc
                )
        elif c is keys.FLEET:
            for topic, payload in {**keys.TOPIC_PAYLOADS, keys.ROSTER: SignedRoster}.items():
                where = address.replace("{topic}", topic)
                yield Spoken(
                    f"{c.name}/{topic}", where, c, payload, (), keys.TOPICS[topic], c.version, f"the fleet's {topic}"
                )
        else:
            yield Spoken(c.name, address, c, c.payload, c.others, c.writers, c.version, doc)


@functools.cache
def _schemas() -> tuple[dict[type, dict[str, Any]], dict[str, dict[str, Any]]]:
    """A reference to the schema of each payload, and the schemas by name."""
    kinds: dict[type, None] = {wire.ErrorBody: None}
    for each in spoken():
        kinds.update(dict.fromkeys(kind for kind in (each.payload, *each.others) if kind is not None))
    references, components = msgspec.json.schema_components(list(kinds), ref_template=_REF)
    return dict(zip(kinds, references, strict=True)), components


def payload_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of one payload, whole by itself; raises :class:`BadInput` naming those there are."""
    _, components = _schemas()
    if name not in components:
        expected = ", ".join(sorted(components))
        raise BadInput(f"no payload {name!r}; there are {expected}", field="schema", value=name, expected=expected)
    found = dict.fromkeys([name])
    for each in itertools.count():  # grows as it is gone through: what those refer to
        if each == len(found):
            break
        text = msgspec.json.encode(components[list(found)[each]]).decode()
        found.update(dict.fromkeys(re.findall(r'"#/components/schemas/([^"]+)"', text)))
    whole = {"$schema": DIALECT, "$ref": f"#/$defs/{name}", "$defs": {each: components[each] for each in found}}
    text = msgspec.json.encode(whole).decode().replace(_REF.format(name=""), "#/$defs/")
    decoded: dict[str, Any] = msgspec.json.decode(text)
    return decoded


@functools.cache
def asyncapi() -> dict[str, Any]:
    """The AsyncAPI document; made once, so change a copy."""
    references, components = _schemas()
    channels: dict[str, Any] = {}
    operations: dict[str, Any] = {}
    messages: dict[str, Any] = {
        "error": {"contentType": "application/json", "payload": references[wire.ErrorBody]},
        "bytes": {"contentType": "application/octet-stream", "payload": {}},
    }
    for each in spoken():
        if each.channel.kind == "token":
            continue  # liveliness: nothing is sent
        name = each.name.replace("/", ".")
        said = [_message(messages, kind, references, each) for kind in (each.payload, *each.others)]
        said += ["error"] if each.channel.kind == "query" else []
        channels[name] = {
            "address": each.address,
            "description": " ".join(each.doc.split()),
            "parameters": {part: {} for part in re.findall(r"{(\w+)}", each.address)},
            "messages": {key: {"$ref": f"#/components/messages/{key}"} for key in dict.fromkeys(said)},
            "x-version": each.version,
            "x-class-of-service": each.channel.qos.value,
            "x-writers": list(each.writers),
            "x-proof-of-origin": each.channel.proven,
        }
        where = {"$ref": f"#/channels/{name}"}
        if each.channel.kind == "query":
            operations[name] = {"action": "receive", "channel": where, "reply": {"channel": where}}
        else:
            operations[name] = {"action": "send" if each.channel.kind == "pub" else "receive", "channel": where}
    document = {
        "asyncapi": "3.0.0",
        "info": {
            "title": "zmav's key space",
            "version": _digest(channels, components),
            "x-zmav": version("zmav"),
            "description": "Zenoh keys as a vehicle's agent serves them: 'send' is published, 'receive' without a "
            "reply is put, and with a reply is a Zenoh query, which an error answers instead. x-version moves where an "
            "older program would misread a payload.",
            "license": {"name": "Apache-2.0"},
        },
        "defaultContentType": "application/json",
        "channels": channels,
        "operations": operations,
        "components": {"messages": messages, "schemas": components},
    }
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(document))  # as it is read elsewhere
    return plain


def _message(messages: dict[str, Any], kind: type | None, references: dict[type, dict[str, Any]], each: Spoken) -> str:
    """The name of the message of that payload, which stands among the ``messages`` then."""
    if kind is None and each.channel.encoding is keys.RAW:
        return "bytes"
    if kind is None:
        messages.setdefault("json", {"contentType": "application/json", "payload": {}})
        return "json"
    name = (
        str(references[kind]["$ref"]).rpartition("/")[2] if "$ref" in references[kind] else each.name.replace("/", ".")
    )
    messages[name] = {"contentType": "application/json", "payload": references[kind]}
    return name


def digest() -> str:
    """What tells two key spaces apart in a word, whatever zmav's own version."""
    return str(asyncapi()["info"]["version"])


def _digest(*parts: object) -> str:
    return hashlib.sha256(msgspec.json.encode(parts, order="sorted")).hexdigest()[:12]
