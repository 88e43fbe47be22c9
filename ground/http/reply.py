"""How an error is answered over HTTP: its status, and its text in the words of the face that was asked."""

from __future__ import annotations

import json
from typing import Any

import msgspec
from starlette.responses import PlainTextResponse, Response

from zmav.errors import ZmavError

STATUS = {
    "bad_input": 400,
    "bad_url": 400,
    "bad_key": 400,
    "bad_message": 400,
    "bad_config": 400,
    "forbidden": 403,
    "no_such_vehicle": 404,
    "refused": 409,
    "clash": 409,
    "not_holder": 409,
    "unsupported": 422,
    "vehicle": 502,
    "error": 502,
    "link": 503,
    "link_down": 503,
    "session": 503,
    "stale": 504,
    "timed_out": 504,
}
"""by an error's code; 502 for any other, which is a newer peer's"""
TEXT_FACE = ("stream", "stop", "send", "last", "vehicles")
"""first parts of the paths that answer with plain text"""
MAVLINK2REST_FACE = ("v1", "mavlink2rest", "mavlink", "helper", "info")
_encoder = msgspec.json.Encoder(enc_hook=str)


class Failure(Exception):
    """A request that is answered with this status; ``kind`` is a word for programs, ``text`` for people."""

    def __init__(self, status: int, kind: str, text: str, **detail: Any) -> None:
        super().__init__(text)
        self.status, self.kind, self.text, self.detail = status, kind, text, detail


def failure_of(error: ZmavError) -> Failure:
    """What an error of the fleet's, or of what was asked, is over HTTP."""
    failure = Failure(STATUS.get(error.code, 502), error.code, error.message)
    failure.detail = error.detail  # it may name a status of its own
    return failure


def body_of(failure: Failure) -> dict[str, Any]:
    """``{"error": {"kind", "text", ...}}`` with what more is known."""
    return {"error": {**failure.detail, "kind": failure.kind, "text": failure.text}}


def refusal(path: str, failure: Failure, headers: dict[str, str] | None = None) -> Response:
    """The answer in the form of the face that ``path`` belongs to.

    A line of text under ``/stream``, ``/send`` and their like; a JSON string as mavlink2rest has it under ``/mavlink``;
    elsewhere :func:`body_of`.
    """
    first = path.lstrip("/").partition("/")[0]
    if first in TEXT_FACE:
        return PlainTextResponse(one_line(failure.text) + "\n", failure.status, headers)
    if first in MAVLINK2REST_FACE:
        body = json.dumps(failure.text, ensure_ascii=False).encode("utf-8", "replace")
    else:
        body = _encoder.encode(body_of(failure))
    return Response(body, failure.status, headers, media_type="application/json")


def one_line(text: str) -> str:
    """``text`` without line breaks and other control characters."""
    return "".join(char if char.isprintable() else " " for char in text)
