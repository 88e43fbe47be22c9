"""mavlink2rest's face: its paths and its JSON, so that its clients (BlueOS, Cockpit, many scripts) find what they know.

``GET /v1/mavlink/...`` is the tree of last messages, down to any field; ``POST /v1/mavlink`` sends; ``GET
/v1/helper/mavlink?name=`` is a message to fill in; ``WS /v1/ws/mavlink?filter=`` is in :mod:`ground.http.restws`. All
without ``/v1``, too, and under ``/mavlink2rest``, where BlueOS has it. https://github.com/mavlink/mavlink2rest
"""

from __future__ import annotations

from datetime import datetime, timezone
from importlib.metadata import version
from typing import Any, Literal

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from ground.http.arguments import object_of
from ground.http.gateway import Gateway, Kept
from ground.http.reply import Failure, failure_of
from ground.http.restjson import frame_of, message, template
from ground.http.restws import RestSockets
from zmav.errors import BadInput, BadMessage

PREFIXES = ("/v1", "", "/mavlink2rest/v1", "/mavlink2rest")
SOURCE = (255, 0)
"""system and component of a header that says none, as mavlink2rest has it"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    face, sockets = Mavlink2Rest(gateway), RestSockets(gateway, SOURCE)
    found: list[BaseRoute] = []
    for prefix in PREFIXES:
        listed = prefix == PREFIXES[0]  # the others are the same
        found += [
            Route(f"{prefix}/mavlink", face.get, methods=["GET"], include_in_schema=listed),
            Route(f"{prefix}/mavlink", face.post, methods=["POST"], include_in_schema=listed),
            Route(f"{prefix}/mavlink/{{path:path}}", face.get, include_in_schema=listed),
            Route(f"{prefix}/helper/mavlink", face.helper, include_in_schema=listed),
            Route(f"{prefix}/info", face.info, include_in_schema=listed),
            WebSocketRoute(f"{prefix}/ws/mavlink", sockets),
        ]
    return found


class Mavlink2Rest:
    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway

    async def get(self, request: Request) -> Response:
        """The tree, or what is at a path in it; 404 where nothing is."""
        path = request.path_params.get("path", "").rstrip("/")
        parts = path.split("/") if path else []
        place = _place(parts)
        if None not in place and len(parts) > 5:
            await self._gateway.wanted(place[0] or 0, place[1] or 0, parts[5])
            if not self._gateway.kept(*place, parts[5]):
                raise Failure(404, "not_found", self._gateway.missing(place[0] or 0, place[1] or 0, parts[5]))
        return _pretty(_walk(self._tree(parts, place), parts))

    def _tree(self, parts: list[str], place: tuple[int | None, int | None]) -> dict[str, Any]:
        """The tree as far as the path goes: what lies beside it need not be decoded."""
        chosen = self._gateway.kept(*place, parts[5] if len(parts) > 5 else None)
        vehicles: dict[str, Any] = {}
        for kept in sorted(chosen, key=lambda kept: kept.at):  # of two with the same ids, the newest
            shown = self._shown(kept)
            if shown is not None:
                sysid, compid = kept.origin.sysid, kept.origin.compid
                vehicle = vehicles.setdefault(str(sysid), {"id": sysid, "components": {}})
                component = vehicle["components"].setdefault(str(compid), {"id": compid, "messages": {}})
                component["messages"][kept.origin.message] = shown
        return {"vehicles": vehicles}

    def _shown(self, kept: Kept) -> dict[str, Any] | None:
        try:
            fields = message(self._gateway.parse(kept), self._gateway.dialect)
        except BadMessage:
            return None  # the dialect lacks it, and no client could read it
        times = {
            "counter": kept.counter,
            "first_update": _time(kept.first),
            "frequency": round(kept.hz, 3),
            "last_update": _time(kept.last),
        }
        return {"message": fields, "status": {"time": times}}

    async def helper(self, request: Request) -> Response:
        """A message to fill in and post."""
        name = request.query_params.get("name")
        if name is None:
            raise Failure(400, "bad_input", "which message? ?name=HEARTBEAT")
        try:
            return _pretty(template(name, self._gateway.dialect, SOURCE), order=None)
        except BadMessage:
            raise Failure(404, "not_found", "Invalid message name.") from None

    async def post(self, request: Request) -> Response:
        """Send one message; the answer is empty. What is wrong with it is 404, as clients know it.

        A refusal by the vehicle is not waited for: sticks are sent this way many times a second.
        """
        gateway = self._gateway
        try:
            given = object_of(await request.body())
            gateway.send(frame_of(given, gateway.dialect, SOURCE, gateway.next_seq))
        except BadInput as e:
            failure = failure_of(e)
            failure.status = 404
            raise failure from e
        return Response()

    async def info(self, request: Request) -> Response:
        """Who serves this, in mavlink2rest's shape."""
        service = {
            "authors": "the zmav project",
            "build_date": "",
            "name": "zmav",
            "sha": "0",
            "version": version("zmav"),
        }
        return _pretty({"service": service, "version": 0})


def _place(parts: list[str]) -> tuple[int | None, int | None]:
    """The system and component that a path names, None where it goes not so far or names none."""
    found = [_index(parts[at]) if len(parts) > at else None for at in (1, 3)]
    return found[0], found[1]


def _walk(value: Any, parts: list[str]) -> Any:
    """What is at a path; raises :class:`Failure` where nothing is."""
    for at, part in enumerate(parts):
        index = _index(part)
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, list) and index is not None and index < len(value):
            value = value[index]
        else:
            raise _nothing(parts, at)
    return value


def _nothing(parts: list[str], at: int) -> Failure:
    return Failure(404, "not_found", f"there is no {parts[at]} in /{'/'.join(parts[:at])}")


def _index(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 6 else None


def _time(t: float) -> str:
    return datetime.fromtimestamp(t, timezone.utc).isoformat(timespec="microseconds").replace("+00:00", "Z")


def _pretty(value: Any, order: Literal["sorted"] | None = "sorted") -> Response:
    text = msgspec.json.format(msgspec.json.encode(value, order=order), indent=2)
    return Response(text, media_type="application/json", headers={"Cache-Control": "no-store"})
