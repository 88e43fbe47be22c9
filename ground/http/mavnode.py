"""The MAVNode face: plain text by GET, for what can do no more, such as MATLAB's ``urlread``.

``/vehicles``, ``/stream/{sys}/{comp}`` and ``/stop/...``, ``/last/{sys}/{comp}/{MSG}``, ``/send/...``: after Coombes et
al. 2014, where a vehicle's computer sends its messages on to anyone who asks for them by a GET.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from ground.http.reply import Failure, one_line
from ground.http.streams import FrameStreams, Wish
from zmav import keys, wire
from zmav.errors import BadMessage, Forbidden, Refused, ZmavError
from zmav.mavlink import describe, encode
from zmav.mavlink.dialect import Field, MessageType
from zmav.subscription import document
from zmav.vehicle.rates import MAX_HZ
from zmav.waiting import within

SOURCE = (255, 190)
"""system and component that we speak as: a ground station's"""
PATIENCE = 0.3
"""s for a refusal to come, as 'zmav send' waits"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    face = MavNode(gateway, FrameStreams(gateway, gateway.stream_timeout))
    return [
        Route("/vehicles", face.vehicles),
        Route("/stream/{sys}/{comp}", face.stream),
        Route("/stop/{sys}/{comp}", face.stop),
        Route("/last/{sys}/{comp}/{message}", face.last),
        Route("/send/{sys}/{comp}/{message}", face.send),
    ]


class MavNode:
    """The handlers, each ``GET``; what fails is a status and a line of text."""

    def __init__(self, gateway: Gateway, streams: FrameStreams) -> None:
        self._gateway, self.streams = gateway, streams
        self._hearing: asyncio.Task[None] | None = None
        self._hears = asyncio.Event()
        self._waiting: set[asyncio.Queue[tuple[str, wire.Event]]] = set()
        """where refusals go, for each frame that was just sent"""
        gateway.at_end(self._end)

    def _end(self) -> None:
        if self._hearing is not None:
            self._hearing.cancel()

    async def vehicles(self, request: Request) -> Response:
        """A line a vehicle: ``name sysid compid autopilot kind mode armed``; ``-`` where it is not known.

        Mode and arming are not known of a vehicle that was last heard too long ago.
        """
        _none_other(request)
        lines = []
        for vehicle in self._gateway.client.fleet():
            s = vehicle.last_state
            said = (s.sysid, s.compid, s.autopilot, s.kind) if s is not None else (None,) * 4
            now = (s.mode, s.armed) if s is not None and vehicle.present else (None, None)
            lines.append(" ".join([vehicle.name, *(_word(each) for each in (*said, *now))]))
        return _text(*lines)

    async def stream(self, request: Request) -> Response:
        """The UDP port to which the system's frames go from now on, one a datagram, until ``/stop``.

        ``?port=`` names the port, ``?msg=A,B`` the messages, ``?hz=`` the most a second of each.
        """
        _none_other(request, "port", "msg", "hz")
        sysid, compid = _ids(request)
        if len(self._gateway.vehicle_of(sysid)) != 1:
            self._gateway.the_vehicle(sysid)  # says which
        given = request.query_params
        names = tuple(name for name in given.get("msg", "").split(",") if name)
        for name in names:
            self._gateway.dialect.message(name)
        wish = Wish(sysid, compid, names, _number(given["hz"], "hz", 0.0, MAX_HZ) if "hz" in given else 0.0)
        return _text(str(self.streams.start(_asker(request), wish, _port(request)).port))

    async def stop(self, request: Request) -> Response:
        """End the asker's streams of a system and component (0: of all); the answer says how many there were."""
        _none_other(request, "port")
        sysid, compid = _ids(request)
        ended = self.streams.stop(_asker(request), sysid, compid, _port(request))
        if not ended:
            there = [f"{s.wish.sysid}/{s.wish.compid} to port {s.port}" for s in self.streams.of(_asker(request))]
            text = f"no stream of {sysid}/{compid} goes to {_asker(request)}; there are {', '.join(there) or 'none'}"
            raise Failure(404, "not_found", text)
        return _text(f"{ended} stopped")

    async def last(self, request: Request) -> Response:
        """The last message decoded, ``name value`` a line, after a line ``age SECONDS``; arrays with blanks between."""
        _none_other(request)
        (sysid, compid), name = _ids(request), request.path_params["message"]
        kept = await self._gateway.wanted(sysid, compid, name)
        if kept is None:
            raise Failure(404, "not_found", self._gateway.missing(sysid, compid, name))
        message = describe(self._gateway.parse(kept), self._gateway.dialect)
        lines = [f"{field} {_shown(value)}" for field, value in message.fields.items()]
        return _text(f"age {time.monotonic() - kept.at:.3f}", *lines)

    async def send(self, request: Request) -> Response:
        """Send one message, every field given but extensions and the target, which is ``sys`` and ``comp``."""
        (sysid, compid), gateway = _ids(request), self._gateway
        message = _message(gateway, request.path_params["message"])
        fields = {**_target(message, sysid, compid), **_fields(message, request)}
        source = {"sysid": SOURCE[0], "compid": SOURCE[1], "seq": gateway.next_seq(*SOURCE)}
        try:
            frame = encode(gateway.dialect, message.name, fields, **source)
        except BadMessage as e:
            raise Failure(400, e.code, _wrong(message, e)) from e
        sent = await self._put(frame, (sysid, compid))
        names = ", ".join(key.split("/")[2] for key in sent)
        return _text(f"{message.name} sent to {names or 'nobody'} ({len(frame)} bytes)")

    async def _put(self, frame: bytes, target: tuple[int, int]) -> list[str]:
        """Put a frame, and raise what a vehicle says of it within a short while: :class:`Refused` or
        :class:`Forbidden`. Silence is no promise: a vehicle says at most one refusal a second, and the autopilot's own
        answer is a message like any other.
        """
        if self._hearing is None or self._hearing.done():
            self._hears.clear()
            self._hearing = asyncio.create_task(self._hear())
        await self._hears.wait()
        came: asyncio.Queue[tuple[str, wire.Event]] = asyncio.Queue()
        self._waiting.add(came)
        try:
            sent, deadline = self._gateway.send(frame, target), time.monotonic() + PATIENCE
            with contextlib.suppress(asyncio.TimeoutError):
                while True:  # a put has no answer: a refusal comes as an event
                    key, event = await within(deadline - time.monotonic(), came.get())
                    if error := _about(key, event.text, sent):
                        raise error
        finally:
            self._waiting.discard(came)
        return sent

    async def _hear(self) -> None:
        """What vehicles refuse, from the first frame on: one subscription for all that are sent."""
        client = self._gateway.client
        try:
            async with client.subscribe(keys.EVENT.key(client.fleet_name, "*"), document(wire.Event)) as events:
                self._hears.set()
                async for key, event in events:
                    for came in self._waiting if event.kind == "refused" else ():
                        came.put_nowait((key, event))
        finally:
            self._hears.set()  # who waits sends all the same


def _about(event_key: str, text: str, sent: Sequence[str]) -> ZmavError | None:
    """The error that a refusal is for anyone who put on these keys; None where it is about something else."""
    for key in sent:
        vehicle = key.partition("/mav/tx/")[0]
        if event_key == f"{vehicle}/event":
            words = f"{vehicle.rpartition('/')[2]}: {text}"
            if text.startswith("refused: "):  # no proof of origin, or not with that role: see zmav.onboard
                return Forbidden(words)
            if f"frame on {key} " in text:
                return Refused(words)
    return None


def _message(gateway: Gateway, name: str) -> MessageType:
    try:
        return gateway.dialect.message(name)
    except BadMessage as e:
        raise Failure(404, e.code, e.message) from e


def _target(message: MessageType, sysid: int, compid: int) -> dict[str, Any]:
    """The target's fields, as far as the message has them (MANUAL_CONTROL alone calls one ``target``)."""
    system = "target" if message.name == "MANUAL_CONTROL" else "target_system"
    return {name: value for name, value in ((system, sysid), ("target_component", compid)) if name in message.by_name}


def _fields(message: MessageType, request: Request) -> dict[str, Any]:
    """The query string's fields as values; raises :class:`Failure` for one given twice."""
    found: dict[str, Any] = {}
    for name, text in request.query_params.multi_items():
        if name in found:
            raise Failure(400, "bad_message", f"{message.name}: {name} is given twice")
        field = message.by_name.get(name)
        found[name] = text if field is None else _value(field, text)
    return found


def _value(field: Field, text: str) -> Any:
    """A field's value from its text: numbers, names of enums, arrays with commas. What it is not stays text, for the
    encoder to refuse."""
    if field.type == "char":
        return text
    if field.length:
        return [_scalar(field, part) for part in text.strip("[]").replace(",", " ").split()]
    return _scalar(field, text)


def _scalar(field: Field, text: str) -> Any:
    text = text.strip()
    if text.lower() in ("nan", "null"):
        return None
    try:
        return float(text) if field.type in ("float", "double") else int(text, 0)
    except ValueError:
        pass
    try:
        return float(text)  # 5.0, as programs without integers write it
    except ValueError:
        return text


def _wrong(message: MessageType, error: BadMessage) -> str:
    """The names that are missing, then what is wrong with the others."""
    fields: dict[str, str] = error.detail.get("fields", {})
    missing = [name for name, why in fields.items() if why.startswith("missing")]
    missing.sort(key=list(message.by_name).index)
    parts = [f"missing: {', '.join(missing)}"] if missing else []
    parts += [f"{name}: {why}" for name, why in fields.items() if name not in missing]
    return f"{message.name} was not sent; " + "; ".join(parts or [error.message])


def _ids(request: Request) -> tuple[int, int]:
    found = [_number(request.path_params[name], name, 0, 255, whole=True) for name in ("sys", "comp")]
    return int(found[0]), int(found[1])


def _port(request: Request) -> int | None:
    text = request.query_params.get("port")
    return None if text is None else int(_number(text, "port", 0, 65535, whole=True))


def _number(text: str, what: str, low: float, high: float, whole: bool = False) -> float:
    """Raises :class:`Failure` for what is no number from ``low`` (rates: above it) to ``high``."""
    try:
        value = float(text) if text.isascii() and (text.isdecimal() or not whole) else math.nan
    except ValueError:
        value = math.nan
    if not (low <= value <= high) or (value == 0 and what in ("hz", "port")):
        expected = f"{'a whole number' if whole else 'a number'} from {low:g} to {high:g}"
        raise Failure(400, "bad_input", f"{what} is {text[:40]!r}, but should be {expected}")
    return value


def _none_other(request: Request, *known: str) -> None:
    """Raise :class:`Failure` for a parameter that means nothing here: it was meant for something."""
    for name in request.query_params:
        if name not in known:
            there = ", ".join(known) or "none"
            raise Failure(400, "bad_input", f"no such parameter: {name[:40]!r}; there are {there}")


def _asker(request: Request) -> str:
    """Their address; one of IPv4 as such, where we listen on both."""
    return request.client.host.removeprefix("::ffff:") if request.client is not None else "127.0.0.1"


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_shown(each) for each in value)
    if value is None:
        return "nan"
    if isinstance(value, str):
        return one_line(value)
    return f"{value + 0.0:.9g}" if isinstance(value, float) else str(value)


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return str(int(value))
    return "-" if value in (None, "") else one_line(str(value)).replace(" ", "_")


def _text(*lines: str) -> PlainTextResponse:
    return PlainTextResponse("".join(f"{line}\n" for line in lines), headers={"Cache-Control": "no-store"})
