"""The key space: ``GET /keys/{key expression}`` asks, ``PUT /keys/{key}`` writes where a channel lets others write.

The registry (:data:`zmav.keys.CHANNELS`) says which direction a key has. Frames (``mav/rx``) are published and answer
no query: of these the last ones heard are given.
"""

from __future__ import annotations

import time
from typing import Any

import msgspec
import zenoh
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import object_of, seconds_of
from ground.http.documents import answer, document_of, names_a_message
from ground.http.gateway import WANTED_HZ, Gateway
from ground.http.reply import Failure, body_of, failure_of
from mesh import linkstate
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadInput, BadKey, Forbidden, ZmavError
from zmav.mavlink import Dialect, decode, encode, parse_frame
from zmav.zenoh_codec import GROUND_STATION

MOST_ANSWERED = 32_000_000
"""bytes of answers after which no more are waited for"""
ADMIN = zenoh.KeyExpr("@/**")
"""routers' own keys; no wildcard but one that begins with the @ takes them in"""
FRAMES = zenoh.KeyExpr(keys.RX.key("*", "*", sys="*", comp="*", msg="*"))
ORDERS = (keys.DO, keys.AGENT_DO)
"""given by POST /do and /agent"""
TOPIC_PAYLOADS: dict[str, type[wire.Wire]] = {"origin": wire.Origin}
"""the fleet's topics of which the payload is laid down"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def get_key(request: Request) -> Response:
        """What answers to a key expression: quad1 (its state), quad*/ATTITUDE, quad1/param/RTL_ALT, quad1/link/*."""
        timeout = seconds_of(request.query_params, "timeout", 2.0, 60.0)
        found, status = await look(gateway, request.path_params["key"], timeout)
        return answer(found, status)

    async def put_key(request: Request) -> Response:
        """Write a key: a frame or its fields in JSON under mav/tx, a topic of the fleet (zmav/demo/@fleet/goal)."""
        key, size = write(gateway, request.path_params["key"], await request.body(), _is_json(request))
        return answer({"key": key, "bytes": size})

    return [Route("/keys/{key:path}", get_key, methods=["GET"]), Route("/keys/{key:path}", put_key, methods=["PUT"])]


async def look(gateway: Gateway, text: str, timeout: float) -> tuple[list[dict[str, Any]], int]:
    """Documents of what answers, by key, and the status: an error's where nothing but errors came.

    Raises :class:`Failure` (404) where nobody answers for a key without wildcards, :class:`BadKey`, and
    :class:`Forbidden` for what would be an order.
    """
    key = keys.expression(text, gateway.client.fleet_name)
    expression = zenoh.KeyExpr(key)
    _check_readable(expression)
    found = await heard(gateway, key, timeout)
    errors: list[ZmavError] = []
    if not FRAMES.includes(expression):
        for each in await _ask(gateway, key, timeout):
            if isinstance(each, ZmavError):
                errors.append(each)
            else:
                found.append(document_of(each.key, time.time(), each.payload, "", gateway.dialect))
    if not found and not errors and "*" not in key:
        raise Failure(404, "not_found", f"nobody answers for {key} within {timeout:g} s; {_present(gateway)}", key=key)
    status = failure_of(errors[0]).status if errors and not found else 200
    return [*sorted(found, key=_key_of), *({"key": key, **body_of(failure_of(each))} for each in errors)], status


async def heard(gateway: Gateway, key: str, timeout: float) -> list[dict[str, Any]]:
    """The last frames that a key expression takes in. One message by its name is asked of the autopilots for a while,
    and waited for where none of them has come: they do not send what nobody reads.
    """
    expression = zenoh.KeyExpr(key)
    found = frames(gateway, expression)
    if not names_a_message(key):
        return found
    fleet, vehicle, message = key.split("/")[1], key.split("/")[2], key.split("/")[-1]
    new = gateway.wants.want(vehicle, message, WANTED_HZ, fleet=fleet)
    if found or not new:
        return found
    await gateway.next_frame(lambda origin: expression.intersects(zenoh.KeyExpr(origin.key)), timeout)
    return frames(gateway, expression)


def frames(gateway: Gateway, expression: zenoh.KeyExpr) -> list[dict[str, Any]]:
    """The last frames heard of the messages that an expression takes in, decoded."""
    if not FRAMES.intersects(expression):
        return []
    fitting = (kept for kept in gateway.kept() if expression.intersects(zenoh.KeyExpr(kept.origin.key)))
    return [document_of(kept.origin.key, kept.last, kept.frame, "", gateway.dialect) for kept in fitting]


def write(gateway: Gateway, text: str, body: bytes, is_json: bool) -> tuple[str, int]:
    """Put on a key that others than its vehicle write; returns the key and the size of what was put.

    Raises :class:`BadKey`, :class:`BadInput` or :class:`BadMessage` naming what is wrong, :class:`Forbidden` for keys
    that only their vehicles write, or that our role may not.
    """
    client = gateway.client
    key = keys.expression(text, client.fleet_name)
    if "*" in key:
        raise BadKey(f"{key} has a wildcard: one key is written at a time", field="key", value=key, expected="one key")
    channel, parts = keys.match(key)
    if channel.kind != "put" and channel is not keys.FLEET:
        raise _not_written(key, channel)
    gateway.check_fleet(parts["fleet"])
    if client.member is not None:
        client.member.check_role(key)
    payload = _payload(channel, parts, body, is_json, gateway.dialect)
    client.put(channel, key, payload)
    return key, len(payload)


def _payload(channel: keys.Channel, parts: dict[str, str], body: bytes, is_json: bool, dialect: Dialect) -> bytes:
    if channel is keys.TX:
        return _frame(parts, body, is_json, dialect)
    kind = channel.payload if channel is not keys.FLEET else TOPIC_PAYLOADS.get(parts["topic"])
    if kind is not None:
        return wire.encode(wire.decode(body or b"null", kind, channel.name))
    if not body:
        raise BadInput("the body is empty", field="body", value="", expected="what to put")
    if is_json:
        try:
            msgspec.json.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
            said = body[:80].decode("utf-8", "replace")
            raise BadInput(f"the body is not JSON: {e}", field="body", value=said, expected="JSON") from e
    return body


def _frame(parts: dict[str, str], body: bytes, is_json: bool, dialect: Dialect) -> bytes:
    """A whole frame as it is, once it is known to be one; or one made of its fields, addressed by the key."""
    if not is_json:
        frame = parse_frame(body, dialect)
        name = dialect.name_of(frame.msgid)
        if name != parts["msg"]:
            raise BadKey(
                f"the frame is {name}, and the key says {parts['msg']}", field="msg", value=parts["msg"], expected=name
            )
        decode(frame, dialect)
        return body
    message = dialect.message(parts["msg"])
    try:
        target = {"target_system": int(parts["sys"]), "target_component": int(parts["comp"])}
    except ValueError:
        text = "the key names its target by numbers: mav/tx/SYSTEM/COMPONENT/MESSAGE"
        raise BadKey(text, field="key", value=f"{parts['sys']}/{parts['comp']}", expected="numbers") from None
    known = {name: number for name, number in target.items() if name in message.by_name}
    return encode(dialect, message.name, {**known, **object_of(body)}, **GROUND_STATION)


async def _ask(gateway: Gateway, key: str, timeout: float) -> list[Answer | ZmavError]:
    size = 0

    def enough(each: Answer) -> bool:
        nonlocal size
        size += len(each.payload)
        return size > MOST_ANSWERED

    return await gateway.client.ask(key, timeout=timeout, channel=keys.MSG, enough=enough)


def _check_readable(expression: zenoh.KeyExpr) -> None:
    """Raise :class:`Forbidden` where asking is acting: orders, measurements. Wildcards beyond them are none:
    vehicles leave those unanswered. Nor is a router asked for more than its links: see :mod:`mesh.linkstate`.
    """
    if ADMIN.includes(expression) and not zenoh.KeyExpr(linkstate.ASKED).includes(expression):
        text = f"{expression} is not asked: a question to routers can stop them for good; {linkstate.ASKED} is safe"
        raise Forbidden(text, key=str(expression))
    for channel in (*ORDERS, keys.SWARM, keys.BENCH):
        every = channel.key("*", "*", agent="*", verb="*", file="*", offset="*", order="*")
        if zenoh.KeyExpr(every).includes(expression):
            how = "POST /do and /agent give orders" if channel in ORDERS else f"{channel.name} is not for the gateway"
            raise Forbidden(f"{expression} is not looked at, it does something: {how}", channel=channel.name)


def _not_written(key: str, channel: keys.Channel) -> ZmavError:
    if channel in ORDERS:
        return BadInput(f"{key} is an order: POST /do or /agent gives it", field="method", value="PUT", expected="POST")
    who = "a token" if channel.kind == "token" else f"written by {' or '.join(channel.writers)}"
    if channel.kind == "query":
        who = "asked, and not written"
    return Forbidden(
        f"{key} is {who}; PUT is for mav/tx, setpoint and the fleet's topics (@fleet)", channel=channel.name
    )


def _is_json(request: Request) -> bool:
    """Whatever a client says that it is no stream of bytes: curl's own word for any data is that of a form."""
    return not request.headers.get("content-type", "").startswith("application/octet-stream")


def _present(gateway: Gateway) -> str:
    return f"present: {', '.join(vehicle.name for vehicle in gateway.client.fleet()) or 'nobody'}"


def _key_of(document: dict[str, Any]) -> str:
    return str(document["key"])
