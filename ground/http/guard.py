"""Who may ask the gateway: the door in front of every face.

Refused here are requests without the token where one is asked for, requests by another site's page in somebody's
browser, names that are not ours (a page that has its own name resolve to our address), bodies that are too large or
too slow, and, where the gateway only reads, whatever writes.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import re
from collections.abc import Collection
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ground.http.reply import Failure, refusal
from zmav.waiting import within

logger = logging.getLogger(__name__)
LONGEST_TARGET = 16_384
"""bytes of path and query string"""
LARGEST_BODY = 1_000_000
"""bytes"""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
WRITING = ("send", "do", "setpoint", "release")
"""first parts of paths that write to vehicles whatever the method: what MATLAB's urlread can do is GET"""
STEERING = "replay"
"""first part of the path that moves a recording on: no vehicle hears it"""
LOOKING = "camera"
"""first part of the paths by which cameras are looked at: of video by a POST"""
ACTING = (*WRITING, "stream", "stop")
"""those, and what changes something here: nobody is to be made to do it by a link on a page"""
OPEN = "static"
"""first part of the paths of what the pages are made of, which is the same everywhere: no token is asked for it"""
HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^:\[\]]*))(?::[0-9]*)?")
"""RFC 3986, 3.2.2 and 3.2.3: brackets only around an IPv6 address, and after them a port or nothing"""
ADMITTED = "admitted"
"""in a scope's state: what asks showed that it may"""
READING = ("GET", "HEAD", "OPTIONS")


@dataclass(frozen=True)
class Rules:
    """``hosts``: names and addresses that are ours, without a port; ``origins``: sites whose pages may ask, too."""

    token: str = ""
    read_only: bool = False
    hosts: Collection[str] = LOOPBACK
    origins: Collection[str] = field(default_factory=tuple)
    body_patience: float = 15.0
    """s for the whole body of a request to come"""


class Guard:
    """ASGI middleware. What comes through has its token taken out of the query string."""

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self._app, self._rules = app, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        try:
            scope = self._admit(scope, headers)
            if _first(scope["path"]) != OPEN:  # which anybody gets
                scope.get("state", {})[ADMITTED] = True
            if scope["type"] == "http":
                receive = await _whole_body(headers, receive, self._rules.body_patience)
        except Failure as failure:
            extra = {"www-authenticate": "Bearer"} if failure.status == 401 else {}
            if failure.kind == "two_lengths":
                extra["connection"] = "close"  # where the next request would begin nobody knows
            await deny(refusal(scope["path"], failure, extra), scope, receive, send)
            return
        await self._run(scope, receive, send)

    async def _run(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the face answer; what goes wrong in it is its own affair, and never a traceback for the asker."""
        begun = scope["type"] == "websocket"  # whose messages go straight on

        async def sending(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, send if begun else sending)
        except Exception:
            logger.exception("error while answering %s", scope["path"])
            if not begun:
                failure = Failure(500, "internal", "an error inside the gateway; its log says which")
                await deny(refusal(scope["path"], failure), scope, receive, send)

    def _admit(self, scope: Scope, headers: Headers) -> Scope:
        """The scope to go on with; raises :class:`Failure`."""
        path: str = scope["path"]
        query: bytes = scope.get("query_string", b"")
        if len(scope.get("raw_path") or b"") + len(query) > LONGEST_TARGET:
            raise Failure(414, "too_long", f"the address is longer than {LONGEST_TARGET} bytes")
        if not path.isprintable() or "\ufffd" in path:
            raise Failure(400, "bad_path", "the path holds bytes that are no text")
        if "content-length" in headers and "transfer-encoding" in headers:
            text = "Content-Length and Transfer-Encoding together: the body's end would be a matter of opinion"
            raise Failure(400, "two_lengths", text)
        query, given = _without_token(query)
        bearer = headers.get("authorization", "")
        if bearer.lower().startswith("bearer "):
            given = bearer[7:].strip().encode("latin-1")
        method = scope.get("method", "GET")
        if _first(path) != OPEN:
            self._check_token(given)
        self._check_host(headers.get("host", ""))
        self._check_site(headers, method, path)
        if self._rules.read_only and _first(path) != STEERING and writes(method, path):
            raise Failure(403, "read_only", "this gateway only reads: it has --read-only, or plays a recording")
        return {**scope, "query_string": query}

    def _check_token(self, given: bytes) -> None:
        wanted = self._rules.token
        if wanted and not hmac.compare_digest(wanted.encode(), given):
            what = "that token is not this gateway's" if given else "this gateway asks for its token"
            raise Failure(401, "token", f"{what}: give it as 'Authorization: Bearer ...' or as ?token=...")

    def _check_host(self, host: str) -> None:
        """With a token there is no need: no other site's page has it."""
        if self._rules.token:
            return
        name = host_of(host)
        if name not in self._rules.hosts:
            raise Failure(421, "host", f"{name or 'no host'} is no name of this gateway: --allow-host adds names")

    def _check_site(self, headers: Headers, method: str, path: str) -> None:
        """Raise :class:`Failure` for what another site's page makes a browser ask, unless a person followed a link."""
        origin, site = headers.get("origin", ""), headers.get("sec-fetch-site", "")
        if origin in self._rules.origins:
            return
        ours = origin.partition("://")[2].lower() == headers.get("host", "").lower()
        if (ours or not origin) and site in ("", "same-origin", "none"):
            self._check_silence(headers, method, path)
            return
        followed = method == "GET" and headers.get("sec-fetch-mode") == "navigate" and not _acts(path)
        if not followed or "upgrade" in headers:
            who = origin or "another site"
            raise Failure(403, "cross_site", f"a page of {who} may not ask here: --allow-origin lets it")

    def _check_silence(self, headers: Headers, method: str, path: str) -> None:
        """Raise :class:`Failure` for a GET that acts under a name of ours where a browser would not say whose it is.

        It says so of this computer's own addresses (and over TLS); under any other name an image on a stranger's page
        looks like ``urlread``.
        """
        told = "origin" in headers or "sec-fetch-site" in headers
        if self._rules.token or told or method not in READING or not _acts(path):
            return
        name = host_of(headers.get("host", ""))
        if name not in LOOPBACK:
            text = f"under the name {name} a GET only reads: ask at 127.0.0.1, by POST, or have it start with a token"
            raise Failure(403, "cross_site", text)


def writes(method: str, path: str) -> bool:
    """The request can change something on a vehicle, or puts something in the key space."""
    return (method not in READING and _first(path) != LOOKING) or _first(path) in WRITING


def host_of(host: str) -> str:
    """The name in a ``Host`` header, without port and brackets; empty where it is none."""
    found = HOST.fullmatch(host.lower())
    return (found[1] or found[2]) if found else ""


async def deny(response: Response, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with ``response``: a WebSocket that was not accepted yet is refused with it, too."""
    if scope["type"] == "http":
        await response(scope, receive, send)
        return
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008})
        return
    start = {"type": "websocket.http.response.start", "status": response.status_code, "headers": response.raw_headers}
    await send(start)
    await send({"type": "websocket.http.response.body", "body": response.body})


def _first(path: str) -> str:
    return path.lstrip("/").partition("/")[0]


def _acts(path: str) -> bool:
    return _first(path) in ACTING


def _without_token(query: bytes) -> tuple[bytes, bytes]:
    """The query string without ``token=...``, and the token."""
    if b"token=" not in query:
        return query, b""
    pairs = parse_qsl(query.decode("latin-1"), keep_blank_values=True, encoding="utf-8", errors="replace")
    token = next((value for name, value in pairs if name == "token"), "")
    return urlencode([pair for pair in pairs if pair[0] != "token"]).encode(), token.encode("utf-8", "replace")


async def _whole_body(headers: Headers, receive: Receive, patience: float) -> Receive:
    """Read the body, and hand it on in one piece; raises :class:`Failure` where it is too large or does not come."""
    said = headers.get("content-length", "0")
    if said.isdecimal() and int(said) > LARGEST_BODY:
        raise Failure(413, "too_large", f"the body is larger than {LARGEST_BODY} bytes")
    if said == "0" and "transfer-encoding" not in headers:
        return receive
    try:
        body = await within(patience, _read(receive))
    except asyncio.TimeoutError:
        raise Failure(408, "too_slow", f"the body did not come within {patience:g} s") from None
    given = False

    async def replay() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay


async def _read(receive: Receive) -> bytes:
    parts: list[bytes] = []
    size = 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise Failure(400, "cut_off", "the connection ended before the body did")
        parts.append(message.get("body", b""))
        size += len(parts[-1])
        if size > LARGEST_BODY:
            raise Failure(413, "too_large", f"the body is larger than {LARGEST_BODY} bytes")
        if not message.get("more_body", False):
            return b"".join(parts)
