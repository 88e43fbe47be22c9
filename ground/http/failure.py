"""A request that fails: its status, and its text in the words of the face that was asked."""

from __future__ import annotations

import json
from typing import Any

from starlette.responses import PlainTextResponse, Response

from ground.http.replies import answer, status_of
from zmav.errors import ZmavError

TEXT_FACE = ("stream", "stop", "send", "last", "vehicles")
"""first parts of the paths that answer with plain text"""
MAVLINK2REST_FACE = ("v1", "mavlink", "helper", "info")


class Failure(Exception):
    """A request that is answered with this status; ``kind`` is a word for programs, ``text`` for people."""

    def __init__(self, status: int, kind: str, text: str, **detail: Any) -> None:
        super().__init__(text)
        self.status, self.kind, self.text, self.detail = status, kind, text, detail


def failure_of(error: ZmavError) -> Failure:
    """What an error of the fleet's, or of what was asked, is over HTTP."""
    failure = Failure(status_of(error), error.code, error.message)
    failure.detail = error.detail
    return failure


def refusal(path: str, failure: Failure, headers: dict[str, str] | None = None) -> Response:
    """The answer in the form of the face that ``path`` belongs to.

    A line of text under ``/stream``, ``/send`` and their like; a JSON string as mavlink2rest has it under ``/mavlink``;
    elsewhere ``{"error": {"kind", "text", ...}}`` with what more is known.
    """
    first = path.lstrip("/").partition("/")[0]
    if first in TEXT_FACE:
        response: Response = PlainTextResponse(one_line(failure.text) + "\n", failure.status)
    elif first in MAVLINK2REST_FACE:
        body = json.dumps(failure.text, ensure_ascii=False).encode("utf-8", "replace")
        response = Response(body, failure.status, media_type="application/json")
    else:
        response = answer({"error": {**failure.detail, "kind": failure.kind, "text": failure.text}}, failure.status)
    response.headers.update(headers or {})
    return response


def one_line(text: str) -> str:
    """``text`` without line breaks and other control characters."""
    return "".join(char if char.isprintable() else " " for char in text)
