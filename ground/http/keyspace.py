"""The key space: ``GET /keys/{key expression}`` asks.

Frames (``mav/rx``) are published and answer no query: of these the last ones heard are given.
"""

from __future__ import annotations

import time
from typing import Any

import zenoh
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import number_of
from ground.http.documents import answer, document_of, names_a_message
from ground.http.gateway import WANTED_HZ, Gateway
from ground.http.reply import Failure, body_of, failure_of
from mesh import linkstate
from zmav import keys
from zmav.client import Answer
from zmav.errors import Forbidden, ZmavError

MOST_ANSWERED = 32_000_000
"""bytes of answers after which no more are waited for"""
ADMIN = zenoh.KeyExpr("@/**")
"""routers' own keys; no wildcard but one that begins with the @ takes them in"""
FRAMES = zenoh.KeyExpr(keys.RX.key("*", "*", sys="*", comp="*", msg="*"))
ORDERS = (keys.DO, keys.AGENT_DO)
"""given by POST /do and /agent"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def get_key(request: Request) -> Response:
        """What answers to a key expression: quad1 (its state), quad*/ATTITUDE, quad1/param/RTL_ALT, quad1/link/*."""
        timeout = number_of(request.query_params, "timeout", 2.0, 60.0, "s")
        found, status = await look(gateway, request.path_params["key"], timeout)
        return answer(found, status)

    return [Route("/keys/{key:path}", get_key, methods=["GET"])]


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


def _present(gateway: Gateway) -> str:
    return f"present: {', '.join(vehicle.name for vehicle in gateway.client.fleet()) or 'nobody'}"


def _key_of(document: dict[str, Any]) -> str:
    return str(document["key"])
