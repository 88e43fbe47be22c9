"""The application: every face's routes behind one guard."""

from __future__ import annotations

import json

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ground.http import (
    audit,
    cameras,
    keyspace,
    mavlink2rest,
    mavnode,
    metrics,
    missions,
    openapi,
    orders,
    page,
    replay,
    setpoints,
    watching,
    ws,
)
from ground.http.gateway import Gateway
from ground.http.guard import Guard, Rules
from ground.http.reply import Failure, failure_of, refusal
from zmav.errors import ZmavError

MARK = b"envelope=1"
ENDLESS = "/camera/"


class Envelope:
    """ASGI middleware, in front of the guard, so that its refusals are put into an envelope, too. A camera's pictures
    have no end, and go into none.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        parts = scope.get("query_string", b"").split(b"&")
        if scope["type"] != "http" or MARK not in parts or scope["path"].startswith(ENDLESS):
            await self._app(scope, receive, send)
            return
        inside = {**scope, "query_string": b"&".join(part for part in parts if part != MARK)}
        head: list[Message] = []
        body: list[bytes] = []

        async def keep(message: Message) -> None:
            if message["type"] == "http.response.start":
                head.append(message)
            elif message["type"] == "http.response.body":
                body.append(message.get("body", b""))

        await self._app(inside, receive, keep)
        if not head:  # nobody is left to answer to
            return
        status, headers = int(head[0]["status"]), Headers(raw=head[0].get("headers", []))
        await _wrapped(status, headers, b"".join(body))(scope, receive, send)


def _wrapped(status: int, headers: Headers, body: bytes) -> Response:
    json_body = headers.get("content-type", "").partition(";")[0].strip() == "application/json"
    inner = body if json_body and body else json.dumps(body.decode("utf-8", "replace")).encode()
    kept = {name: headers[name] for name in ("access-control-allow-origin", "vary", "cache-control") if name in headers}
    content = b'{"ok":%s,"status":%d,"body":%s}' % (b"true" if status < 400 else b"false", status, inner)
    return Response(content, media_type="application/json", headers=kept)


VIEWS = (page, replay, openapi, metrics, watching, cameras)
FACES = (*VIEWS, mavnode, mavlink2rest, orders, missions, setpoints, ws, keyspace)


def make_app(gateway: Gateway, rules: Rules | None = None) -> Starlette:
    """The faces' routes in order, the first that fits answers; each face is a module with ``routes(gateway)``."""
    routes: list[BaseRoute] = [route for face in FACES for route in face.routes(gateway)]
    handlers = {Failure: _on_failure, ZmavError: _on_error, HTTPException: _on_http}
    rules = rules or Rules(read_only=gateway.read_only)
    middleware = [Middleware(Envelope), Middleware(Guard, rules=rules), Middleware(audit.Audited, audit=gateway.audit)]
    if rules.origins:
        methods, headers = ("GET", "POST"), ("authorization", "content-type")
        origins = tuple(rules.origins)
        cors = Middleware(CORSMiddleware, allow_origins=origins, allow_methods=methods, allow_headers=headers)
        middleware.insert(1, cors)
    return Starlette(routes=routes, middleware=middleware, exception_handlers=handlers)  # type: ignore[arg-type]


async def _on_failure(request: HTTPConnection, failure: Failure) -> Response:
    return refusal(request.url.path, failure)


async def _on_error(request: HTTPConnection, error: ZmavError) -> Response:
    return refusal(request.url.path, failure_of(error))


async def _on_http(request: Request, error: HTTPException) -> Response:
    """No such path, or not with that method."""
    text = f"there is no {request.url.path} here: / lists what there is"
    kind = "not_found"
    if error.status_code == 405:
        kind, text = "method", f"{request.method} cannot be used on {request.url.path}"
    elif error.status_code != 404:
        kind, text = "request", str(error.detail)
    headers = dict(error.headers) if error.headers else None
    return refusal(request.url.path, Failure(error.status_code, kind, text), headers)
