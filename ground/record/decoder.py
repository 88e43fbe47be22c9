"""From a frame to flat JSON, fast: what a recorder does with every frame there is.

:func:`zmav.mavlink.describe` is for people; this is for plots. Enumerations and flags stay numbers (the schema names
them), nothing is said of the header, and per message type all is prepared once: two calls, ``struct`` and ``msgspec``.
"""

from __future__ import annotations

import operator
import struct
from collections.abc import Callable
from typing import Any

import msgspec

from zmav.mavlink import Dialect
from zmav.mavlink.dialect import Field, MessageType
from zmav.mavlink.frame import CHECKSUM, HEADER_V1, HEADER_V2, MAGIC_V1, MAGIC_V2, SIGNATURE, SIGNED
from zmav.mavlink.values import text

_encode = msgspec.json.Encoder().encode
Arrange = Callable[[tuple[Any, ...]], Any]
_KINDS: dict[str, Any] = {"float": float, "double": float, "char": str}


def is_frame(data: bytes) -> bool:
    """Whether these bytes are one whole frame by its header: whatever else they hold, a recording stays readable."""
    if len(data) < HEADER_V1 + CHECKSUM:
        return False
    if data[0] == MAGIC_V1:
        return len(data) == HEADER_V1 + data[1] + CHECKSUM
    if data[0] != MAGIC_V2 or len(data) < HEADER_V2 + CHECKSUM or data[2] & ~SIGNED:
        return False
    return len(data) == HEADER_V2 + data[1] + CHECKSUM + (SIGNATURE if data[2] else 0)


class Decoder:
    """Decodes frames of one dialect. One thread at a time."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._plans: dict[int, _Plan | None] = {}

    def json(self, frame: bytes) -> bytes | None:
        """The fields as a JSON object; None where the dialect lacks the message. NaN and infinities are null.

        ``frame`` must be one by :func:`is_frame`. Its checksum is not looked at: the vehicle's agent has checked it.
        """
        if frame[0] == MAGIC_V2:
            msgid, payload = int.from_bytes(frame[7:10], "little"), frame[HEADER_V2 : HEADER_V2 + frame[1]]
        else:
            msgid, payload = frame[5], frame[HEADER_V1 : HEADER_V1 + frame[1]]
        try:
            plan = self._plans[msgid]
        except KeyError:
            plan = self._plan(msgid)
        return None if plan is None else plan.json(payload)

    def _plan(self, msgid: int) -> _Plan | None:
        message = self._dialect.by_id.get(msgid)
        plan = None if message is None else _Plan(message)
        if message is not None:  # of unknown ids there are sixteen million
            self._plans[msgid] = plan
        return plan


class _Plan:
    """How one message's payload becomes JSON."""

    def __init__(self, message: MessageType) -> None:
        self._size = message.max_length
        self._unpack: Callable[[bytes], tuple[Any, ...]] = message.struct.unpack
        # Fields may be called what Python forbids, so the struct's own names are numbers.
        fields: list[Any] = [
            (f"f{n}", list if f.length and f.type != "char" else _KINDS.get(f.type, int), msgspec.field(name=f.name))
            for n, f in enumerate(message.fields)
        ]
        self._make: Callable[..., Any] = msgspec.defstruct(message.name, fields, gc=False)
        self._arrange = _arrange(message)

    def json(self, payload: bytes) -> bytes:
        size = self._size
        if len(payload) != size:
            payload = payload[:size].ljust(size, b"\0")
        values = self._unpack(payload)
        return _encode(self._make(*(self._arrange(values) if self._arrange else values)))


def _arrange(message: MessageType) -> Arrange | None:
    """From what ``struct`` found, in the payload's order, to one value a field in declared order; None: it is that."""
    plain = all(not f.length and f.type != "char" for f in message.fields)
    if plain and message.fields == message.wire_fields:
        return None
    if plain:
        order = [message.wire_fields.index(f) for f in message.fields]
        return operator.itemgetter(*order) if len(order) > 1 else None
    parts = _parts(message)
    return lambda values: [take(values) for take in parts]


def _parts(message: MessageType) -> list[Callable[[tuple[Any, ...]], Any]]:
    takers: dict[str, Callable[[tuple[Any, ...]], Any]] = {}
    at = 0
    for field in message.wire_fields:
        takers[field.name], at = _taker(field, at)
    return [takers[field.name] for field in message.fields]


def _taker(field: Field, at: int) -> tuple[Callable[[tuple[Any, ...]], Any], int]:
    """How to take a field out of the unpacked values that begin at ``at``, and where the next one begins."""
    if field.type == "char":
        return (lambda values: text(values[at])), at + 1
    if field.length:
        part = slice(at, at + field.length)
        return (lambda values: values[part]), at + field.length
    return operator.itemgetter(at), at + 1


STAMP = struct.Struct(">Q")
"""what goes before each frame in a .tlog: microseconds since 1970"""
