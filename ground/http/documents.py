"""What the gateway shows of a sample or an answer: JSON with its key, its time and its value."""

from __future__ import annotations

import base64
from typing import Any

import msgspec
import zenoh
from starlette.responses import Response

from zmav import keys, wire
from zmav.doctor.rules import Reason, of_state
from zmav.errors import BadInput, BadKey
from zmav.mavlink import Dialect
from zmav.zenoh_codec import readable

_encoder = msgspec.json.Encoder(enc_hook=str)


def to_json(value: object) -> bytes:
    """NaN and infinities become null."""
    return _encoder.encode(value)


def answer(value: object, status: int = 200) -> Response:
    """A JSON answer that no cache keeps."""
    return Response(to_json(value), status, media_type="application/json", headers={"Cache-Control": "no-store"})


def document_of(key: str, t: float, payload: bytes, encoding: str, dialect: Dialect) -> dict[str, Any]:
    """``{"key", "t", "value"}``: a frame decoded, JSON as it is, a picture in base64, other bytes in hexadecimal;
    beside a state its ``alarms``, the worst first: what is not well, by the rules of :mod:`zmav.doctor`.

    ``t``: UTC seconds at which it came here. Bytes that should be a frame and are none: ``{"error", "hex"}``.
    """
    channel = _channel(key)
    shown = _frame(key, payload, dialect) if channel in (keys.RX, keys.TX) else _value(payload, encoding)
    alarms = {"alarms": _alarms(payload)} if channel is keys.STATE else {}
    return {"key": key, "t": t, "value": shown, **alarms}


def document_of_sample(sample: zenoh.Sample, t: float, dialect: Dialect) -> dict[str, Any]:
    """As :func:`document_of`; of what was deleted the value is None and ``deleted`` true."""
    key = str(sample.key_expr)
    if sample.kind == zenoh.SampleKind.DELETE:
        return {"key": key, "t": t, "value": None, "deleted": True}
    return document_of(key, t, sample.payload.to_bytes(), str(sample.encoding), dialect)


def _frame(key: str, payload: bytes, dialect: Dialect) -> Any:
    shown = readable(key, payload, dialect)
    return shown.get("message", shown)


def _value(payload: bytes, encoding: str) -> Any:
    if encoding.startswith(("image/", "video/", "audio/")):
        return {"content_type": encoding, "base64": base64.b64encode(payload).decode("ascii")}
    try:
        msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return {"hex": payload.hex()}
    return msgspec.Raw(payload)  # as it came: what is JSON need not be made again


def _alarms(payload: bytes) -> list[dict[str, Any]]:
    try:
        found = of_state(wire.decode(payload, wire.VehicleState, "state"))
    except BadInput:
        text = "its state is not understood: another version of zmav?"
        found = [Reason(rule="state", level="bad", text=text)]
    return [msgspec.to_builtins(each) for each in found]


def _channel(key: str) -> keys.Channel | None:
    try:
        return keys.match(key)[0]
    except BadKey:
        return None


def names_a_message(key: str) -> bool:
    """A key expression is of frames of one message: what an autopilot can be asked to send."""
    chunks = key.split("/")
    return len(chunks) == 8 and chunks[3:5] == ["mav", "rx"] and keys.MESSAGE.match(chunks[-1]) is not None
