"""What every payload is made from: structs, JSON in and out, errors that name the field."""

from __future__ import annotations

import collections
import contextlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from zmav.errors import BadInput, ZmavError, from_code

Vector = tuple[float, float, float]


class Wire(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Base of every payload: keyword-only. What asks for something is strict: what it says and nobody here knows would
    not be done, so all of it is refused.
    """


class Told(Wire, kw_only=True, forbid_unknown_fields=False):
    """Base of what says how something is. A newer version says more than an older one knows, which leaves that out."""


class ErrorBody(Told, kw_only=True):
    """Payload of an error reply: see :mod:`zmav.errors`."""

    code: str
    message: str
    detail: dict[str, Any] = {}


W = TypeVar("W", bound=msgspec.Struct)
_encoder = msgspec.json.Encoder(enc_hook=str)
_NAMED_FIELD = re.compile(r"field `([^`]*)`")


def encode(payload: msgspec.Struct) -> bytes:
    """JSON bytes; NaN and infinities become null."""
    return _encoder.encode(payload)


def encode_request(payload: Wire) -> bytes:
    """JSON bytes of what asks for something. Raises :class:`BadInput` for a number that JSON does not have: null in its
    place would mean that it was not given, and something else be done.
    """
    check_finite(msgspec.structs.asdict(payload))
    return encode(payload)


def build(values: dict[str, Any], kind: type[W], what: str) -> W:
    """A ``kind`` from plain values by their names; raises as :func:`decode` and :func:`encode_request` do."""
    check_finite(values)
    return decode(_encoder.encode(values), kind, what)


def check_finite(values: Mapping[str, Any], within: str = "") -> None:
    """Raise :class:`BadInput` that names the field which is NaN or infinite, or has such a number in it.

    A payload within one is looked into, and of a list the numbers only: a mission's items and a command's parameters
    may have nulls.
    """
    pending: list[tuple[str, Mapping[str, Any]]] = [(within, values)]
    while pending:
        before, held = pending.pop()
        for name, value in held.items():
            field = before + name
            if isinstance(value, msgspec.Struct):
                pending.append((f"{field}.", msgspec.structs.asdict(value)))
            for number in value if isinstance(value, (tuple, list)) else (value,):
                if isinstance(number, float) and not math.isfinite(number):
                    raise BadInput.wrong(field, value, "a finite number")


def decode(data: bytes, kind: type[W], what: str) -> W:
    """``data`` as a ``kind``; raises :class:`BadInput` that names the field and what was expected."""
    try:
        return msgspec.json.decode(data or b"{}", type=kind)
    except msgspec.ValidationError as e:
        text, _, path = str(e).partition(" - at `$")
        named = _NAMED_FIELD.search(text)  # a missing or an unknown field: the path is that of the object around it
        field = ".".join(filter(None, (path.strip("`").lstrip("."), named and named[1]))) or kind.__name__
        raise BadInput(f"{what}: {text} (at {field})", field=field, value=_clip(data), expected=text) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise BadInput(f"{what}: not JSON: {e}", field=what, value=_clip(data), expected="a JSON object") from None


def refuse_repeated(data: bytes, what: str) -> None:
    """Raise :class:`BadInput` where an object in ``data`` gives a name twice.

    For orders, whose arguments somebody may have read and approved: readers of JSON differ in which of the two they
    take, and ours takes the last in silence. Costs as much as another decoding, so it is not for telemetry. What is no
    JSON at all is :func:`decode`'s to refuse.
    """

    def look(pairs: list[tuple[str, Any]]) -> None:
        names = [name for name, _ in pairs]
        if len(set(names)) < len(names):
            field = collections.Counter(names).most_common(1)[0][0]
            raise BadInput(f"{what}: {field} is given twice", field=field, value=_clip(data), expected="one value")

    with contextlib.suppress(ValueError, RecursionError):
        json.loads(data, object_pairs_hook=look, parse_int=float)  # an int of thousands of digits would not be read


def _clip(data: bytes) -> str:
    return data[:80].decode("utf-8", "replace")


def error_body(error: ZmavError, **more: Any) -> bytes:
    """An error as it is replied; ``more`` stands beside its own detail."""
    return encode(ErrorBody(code=error.code, message=error.message, detail=error.detail | more))


def error_from(data: bytes) -> ZmavError:
    """The exception an error reply stands for."""
    try:
        body = msgspec.json.decode(data, type=ErrorBody)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ZmavError(_clip(data) or "an error without a text")
    return from_code(body.code, body.message, body.detail)
