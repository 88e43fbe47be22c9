"""What supervisor and controller say to each other, one datagram each over a Unix socket: cycles and outputs as
MessagePack, 250 times a second, and everything else as JSON.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agents.controllers.types import OUTPUTS, AttitudeThrust, Output, Reference, State, Trim

MOST = 1 << 17
"""bytes of a datagram"""
MOST_SIGNALS = 1000
"""numbers: more than anybody looks at, and their names would be no datagram any more"""
CYCLE, OUTPUT, TALK = b"c", b"o", b"j"


class Answer(NamedTuple):
    """What came of one cycle."""

    number: int
    output: Output | None
    """None: the controller only follows what the autopilot does"""
    signals: tuple[float, ...]
    """in the order of the names that were told"""


def _array(kind: type, row: Any) -> Any:
    return np.array(row, dtype=float)


_ENCODER = msgspec.msgpack.Encoder(enc_hook=lambda value: value.tolist())  # numpy's arrays and numbers
_CYCLE = msgspec.msgpack.Decoder(tuple[int, int, State, Reference, Trim], dec_hook=_array)
_ANSWER = msgspec.msgpack.Decoder(tuple[int, int, msgspec.Raw, tuple[float, ...]])
_CLASSES = (type(None), *OUTPUTS.values())
_OUTPUTS = tuple(msgspec.msgpack.Decoder(cls, dec_hook=_array) for cls in _CLASSES)


def pack_cycle(number: int, phase: int, state: State, reference: Reference, trim: Trim) -> bytes:
    """``phase``: see :mod:`agents.controllers.cycle`."""
    return CYCLE + _ENCODER.encode((number, phase, state, reference, trim))


def unpack_cycle(data: bytes) -> tuple[int, int, State, Reference, Trim]:
    return _CYCLE.decode(data[1:])


def pack_output(number: int, output: Output | None, signals: dict[str, float]) -> bytes:
    """Raises TypeError, ValueError or :class:`msgspec.MsgspecError` for what is no output."""
    if len(signals) > MOST_SIGNALS:
        raise ValueError(f"{len(signals)} signals are too many: at most {MOST_SIGNALS} numbers go out with a cycle")
    which, raw = _CLASSES.index(type(output)), msgspec.Raw(_ENCODER.encode(output))
    _read(which, raw)  # what the supervisor could not read is the controller's fault
    return OUTPUT + _ENCODER.encode((number, which, raw, list(signals.values())))


def unpack_output(data: bytes) -> Answer:
    """Raises as :func:`pack_output`."""
    number, which, raw, signals = _ANSWER.decode(data[1:])
    return Answer(number, _read(which, raw), signals)


def _read(which: int, raw: msgspec.Raw) -> Output | None:
    """Raises ValueError where its vector is no quaternion, or not north, east, down or x, y, z."""
    output: Output | None = _OUTPUTS[which].decode(raw)
    if output is not None:
        vector, size = next(iter(vars(output).values())), 4 if isinstance(output, AttitudeThrust) else 3
        if vector.shape != (size,):
            raise ValueError(f"it has {vector.size} numbers; expected {size}")
    return output


def pack_message(**what: Any) -> bytes:
    return TALK + json.dumps(what).encode()


def unpack_message(data: bytes) -> dict[str, Any]:
    """Raises ValueError for what is not JSON."""
    said = json.loads(data[1:])
    if not isinstance(said, dict):
        raise ValueError("expected an object")
    return said
