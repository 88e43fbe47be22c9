"""Answers to clients that are shown the body of a good answer only: ``?envelope=1``.

urlread of MATLAB and of Octave hides the text of every answer that is an error. Asked with ``envelope=1`` the gateway
answers ``{"ok": ..., "status": ..., "body": ...}`` with status 200. ``body`` is the JSON or the text that it would
have answered, and ``ok`` says that ``status`` is no error.
"""

from __future__ import annotations

import json

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MARK = b"envelope=1"


class Envelope:
    """ASGI middleware, in front of the guard, so that its refusals are put into an envelope, too."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        parts = scope.get("query_string", b"").split(b"&")
        if scope["type"] != "http" or MARK not in parts:
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
