"""What travels under a key, readable: for ``zmav echo``, and as a codec for the public ``zenoh`` command (zenoh-cli).

``zenoh --mode client --connect tcp/127.0.0.1:7447 subscribe -k 'zmav/**' --decoder mavlink`` prints each payload as one
line of JSON; ``put -k zmav/demo/quad1/mav/tx/1/1/SET_MODE --encoder mavlink -v '{"base_mode": 1, "custom_mode": 4}'``
sends a message. Both are found by the entry points ``zenoh_cli.codecs.decoders`` and ``zenoh_cli.codecs.encoders``.
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

from zmav import keys
from zmav.errors import BadKey, BadMessage
from zmav.mavlink import Dialect, describe, encode, load_dialect, parse_frame

GROUND_STATION = {"sysid": 255, "compid": 190}


def decode(key: object, payload: bytes) -> str:
    """One line of JSON: a frame decoded, JSON as it is, anything else in hexadecimal digits. Never raises."""
    shown = readable(str(key), payload, load_dialect())
    return json.dumps(shown.get("message", shown.get("value", shown)), ensure_ascii=False)


def readable(key: str, payload: bytes, dialect: Dialect) -> dict[str, Any]:
    """A payload as JSON: under ``message`` a decoded frame, under ``value`` what was JSON, else under ``hex``.

    Bytes that should be a frame and are none are under ``hex`` with the reason under ``error``.
    """
    if _holds_frames(key):
        try:
            return {"message": msgspec.to_builtins(describe(parse_frame(payload, dialect), dialect))}
        except BadMessage as e:
            return {"error": str(e), "hex": payload.hex()}
    try:
        return {"value": json.loads(payload)}
    except (ValueError, RecursionError):
        return {"hex": payload.hex()}


def encode_text(key: object, value: str) -> bytes:
    """A frame from its fields in JSON, for keys under ``mav/tx``, named and addressed by the key; else the text itself.

    Raises :class:`BadMessage` naming every bad field.
    """
    if not _holds_frames(str(key)):
        return value.encode()
    _, parts = keys.match(str(key))
    dialect = load_dialect()
    message = dialect.message(parts["msg"])
    try:
        fields = msgspec.json.decode(value, type=dict[str, Any])
        target = {"target_system": int(parts["sys"]), "target_component": int(parts["comp"])}
    except (msgspec.DecodeError, ValueError, RecursionError) as e:
        text = f"a message's fields as a JSON object, and its target by numbers in the key: {e}"
        raise BadMessage(f"expected {text}", field="fields", value=value, expected="an object") from None
    known = {name: number for name, number in target.items() if name in message.by_name}
    return encode(dialect, message.name, {**known, **fields}, **GROUND_STATION)


def _holds_frames(key: str) -> bool:
    try:
        return keys.match(key)[0] in (keys.RX, keys.TX)
    except BadKey:
        return False
