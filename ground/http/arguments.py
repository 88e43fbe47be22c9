"""What a request gives by name: query parameters, a form, a JSON object."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, TypeVar
from urllib.parse import parse_qsl

import msgspec
from starlette.requests import Request

from zmav import wire
from zmav.errors import BadInput

CALLER = "as"
"""the query parameter that names the caller: no argument of an order"""
FORM = "application/x-www-form-urlencoded"
MOST_FIELDS = 100
T = TypeVar("T")


async def arguments_of(request: Request, kind: type[msgspec.Struct]) -> dict[str, Any]:
    """The request's named values: query parameters, and over these a body of JSON or of a form.

    A parameter's value is JSON where it can be, else text; what is text in ``kind`` stays text, in quotes or without
    (``id="7"``, ``id=7``). Raises :class:`BadInput` for a name given twice and for a body that holds no names.
    """
    pairs = [(name, text) for name, text in request.query_params.multi_items() if name != CALLER]
    texts = frozenset(field.encode_name for field in msgspec.structs.fields(kind) if field.type is str)
    values, body = _once(pairs, texts), await request.body()
    if not body.strip():
        return values
    if request.headers.get("content-type", "").startswith(FORM):
        return {**values, **_form(body, texts)}
    return {**values, **object_of(body)}


def object_of(body: bytes) -> dict[str, Any]:
    """A body that is a JSON object; raises :class:`BadInput`."""
    try:
        found = msgspec.json.decode(body, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        text = f"the body is not a JSON object: {e}"
        raise BadInput(text, field="body", value=_clip(body), expected="a JSON object") from e
    wire.refuse_repeated(body, "the body")
    return found


def number_of(values: Mapping[str, str], name: str, default: T, most: float, unit: str) -> float | T:
    """A parameter above 0 and at most ``most``; raises :class:`BadInput`."""
    text = values.get(name)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value <= most:
        expected = f"a number above 0, at most {most:g} {unit}"
        raise BadInput(f"{name} {text[:80]!r}: expected {expected}", field=name, value=text[:80], expected=expected)
    return value


def _form(body: bytes, texts: Collection[str]) -> dict[str, Any]:
    try:
        pairs = parse_qsl(body.decode(), keep_blank_values=True, strict_parsing=True, max_num_fields=MOST_FIELDS)
    except ValueError as e:
        text = f"the body is not a form: {e}"
        raise BadInput(text, field="body", value=_clip(body), expected="name=value&name=value") from e
    return _once(pairs, texts)


def _once(pairs: Iterable[tuple[str, str]], texts: Collection[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, text in pairs:
        if name in values:
            raise BadInput(f"{name} is given twice", field=name, value=text[:80], expected="one value")
        value = _guessed(text)
        if isinstance(value, (dict, list)):
            wire.refuse_repeated(text.encode(), name)
        values[name] = text if name in texts and not isinstance(value, str) else value
    return values


def _guessed(text: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return text


def _clip(body: bytes) -> str:
    return body[:80].decode("utf-8", "replace")
