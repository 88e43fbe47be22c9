"""What was ordered through the gateway: who asked, from where, what, of whom, and how it ended.

A line is put on ``@fleet/order``, where a recorder hears it, after the answer is on its way: no order waits for it. The
same again within a second is counted, not said, and what floods is left out.
"""

from __future__ import annotations

import contextlib
import json
import logging
import time
from collections import deque
from collections.abc import MutableMapping
from contextvars import ContextVar
from typing import Any
from urllib.parse import parse_qsl

import zenoh
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from zmav import keys, wire
from zmav.client import Client
from zmav.errors import ZmavError
from zmav.ratelimit import RateLimit

logger = logging.getLogger(__name__)
ORDERING = ("do", "fleet", "swarm", "agent", "mission", "setpoint", "release")
"""first parts of the paths that give orders; frames are told of by who sends them"""
LOOKING = ("swarm/preview", "swarm/status", "mission/read")
AGAIN_S, MOST, KEPT = 1.0, 500, 500
"""s in which the same is told once; so many different ones in that time, and lines that the gateway itself keeps"""
WAITED_S, UNDER_WAY = 60.0, "running"
"""s in which it is told once that an order is under way, however often somebody asks"""
LONGEST = 400
"""characters of arguments, and of an outcome"""
LARGEST = 64_000
"""bytes of a request and of an answer that are read for their words"""
_from: ContextVar[tuple[str, str]] = ContextVar("asker", default=("", ""))


class Audit:
    """The lines. On the event loop."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.lines: deque[wire.OrderLine] = deque(maxlen=KEPT)
        self._limit = RateLimit[tuple[str, ...]](AGAIN_S, MOST)
        self._waited = RateLimit[tuple[str, ...]](WAITED_S, MOST)

    def say(self, verb: str, vehicles: list[str], args: str, outcome: str, took: float = 0.0) -> None:
        who, source = _from.get()
        about = (who, source, verb, *vehicles, outcome)
        more = self._waited.take((*about, args)) if UNDER_WAY in outcome else self._limit.take(about)
        if more is None:
            return
        member = self.client.member
        line = wire.OrderLine(
            t=time.time(),
            who=who or (member.credentials.name if member is not None else ""),
            source=source,
            verb=verb,
            vehicles=vehicles[:MOST],
            args=args[:LONGEST],
            outcome=outcome[:LONGEST],
            took=round(took, 3),
            more=more,
        )
        self.lines.append(line)
        try:
            self.client.put(keys.FLEET, keys.FLEET.key(self.client.fleet_name, topic=keys.ORDERED), line)
        except (ZmavError, zenoh.ZError) as e:
            logger.warning("an order is in no recording: %s", e)


class Audited:
    """ASGI middleware behind the guard: what came through is told with its outcome."""

    def __init__(self, app: ASGIApp, audit: Audit) -> None:
        self._app, self._audit = app, audit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        query = dict(parse_qsl(scope.get("query_string", b"").decode("latin-1")))
        client = scope.get("client")
        _from.set((query.pop("as", "")[:80], str(client[0]) if client else ""))
        path = scope["path"].strip("/")
        if scope["type"] != "http" or path.partition("/")[0] not in ORDERING or path in LOOKING:
            await self._app(scope, receive, send)
            return
        body, reply, status, began = b"", bytearray(), 500, time.monotonic()

        async def receiving() -> Message:
            nonlocal body
            message = await receive()
            if len(body) < LARGEST:
                body += message.get("body", b"")
            return message

        async def sending(message: Message) -> None:
            nonlocal status
            status = message.get("status", status)
            if len(reply) < LARGEST:
                reply.extend(message.get("body", b""))
            await send(message)

        try:
            await self._app(scope, receiving, sending)
        finally:
            with contextlib.suppress(Exception):  # the order was given, whatever there is to say of it
                args = {**query, **({} if path.startswith("mission") else _object(body))}
                verb, vehicles = _meant(path, args)
                if str(args.get("preview", "")).lower() != "true":
                    took = time.monotonic() - began
                    self._audit.say(verb, vehicles, json.dumps(args), _outcome(status, bytes(reply)), took)


def _object(body: bytes) -> dict[str, Any]:
    """A body's names, of JSON or of a form."""
    with contextlib.suppress(ValueError):
        found = json.loads(body) if body.lstrip()[:1] == b"{" else dict(parse_qsl(body.decode()))
        return found if isinstance(found, dict) else {}
    return {}


def _meant(path: str, args: MutableMapping[str, Any]) -> tuple[str, list[str]]:
    """``do/takeoff`` and whom it is for; takes these out of the arguments."""
    group, *rest = path.split("/")
    if group in ("do", "setpoint", "release", "agent"):
        return "/".join([group, *rest[1:]]), rest[:1]
    goal = args.get("goal")
    named = args.pop("vehicles", None) or (goal.get("vehicles") if isinstance(goal, dict) else None) or []
    return path, [str(name) for name in (named if isinstance(named, list) else str(named).split(","))]


def _outcome(status: int, reply: bytes) -> str:
    """``done``, ``running``, or what went wrong in words; of an order to several vehicle by vehicle."""
    try:
        told = json.loads(reply)
    except ValueError:
        told = reply.decode("utf-8", "replace").strip() if status >= 400 else "done"
    if not isinstance(told, dict):
        return str(told)
    if status >= 400:
        return f"{status}: {told.get('error', {}).get('text', told)}"
    each = told.get("vehicles")
    if isinstance(each, list):
        return ", ".join(f"{v.get('vehicle')} {v.get('status')}" for v in each) or "nobody"
    return str(told.get("status", "done"))
