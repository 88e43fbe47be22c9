"""What supervisor and controller say to each other, one datagram each over a Unix socket: cycles and outputs in fixed
binary form, 250 times a second, and everything else as JSON.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.types import (
    LEVELS,
    MOTORS,
    OUTPUTS,
    Acceleration,
    AttitudeThrust,
    Output,
    Reference,
    State,
    Trim,
    Velocity,
)

MOST = 1 << 17
"""bytes of a datagram"""
MOST_SIGNALS = 1000
"""numbers: more than anybody looks at, and their names would be no datagram any more"""
CYCLE, OUTPUT, TALK = b"c", b"o", b"j"
_CYCLE = struct.Struct(f"<cBBI{19 + MOTORS + 19 + 8}d")
"""kind, phase (see :mod:`agents.controllers.cycle`), the reference's level, number; state, motors, reference, trim"""
_OUTPUT = struct.Struct("<cBI6d")
"""kind, which output, number; its six numbers"""
_CLASSES = tuple(OUTPUTS.values())
NOTHING = 255
"""in place of an output: the controller only follows what the autopilot does"""


class Answer(NamedTuple):
    """What came of one cycle."""

    number: int
    output: Output | None
    signals: tuple[float, ...]
    """in the order of the names that were told"""


def pack_cycle(number: int, phase: int, state: State, reference: Reference, trim: Trim) -> bytes:
    s, r = state, reference
    motors = [math.nan] * MOTORS if s.motors is None else [*s.motors, *[math.nan] * MOTORS][:MOTORS]
    return _CYCLE.pack(
        CYCLE,
        phase,
        LEVELS.index(r.level),
        number,
        s.t,
        s.dt,
        *s.pos,
        *s.vel,
        *s.q,
        *s.rates,
        *s.sticks,
        *motors,
        *r.pos,
        *r.vel,
        *r.acc,
        r.yaw,
        r.yaw_rate,
        *r.attitude,
        *r.rates,
        r.thrust,
        trim.thrust,
        *trim.attitude,
        *trim.rates,
    )


def unpack_cycle(data: bytes) -> tuple[int, int, State, Reference, Trim]:
    _, phase, level, number, *values = _CYCLE.unpack(data)
    row = np.array(values)
    motors = row[19 : 19 + MOTORS]
    motors = motors[~np.isnan(motors)]
    state = State(
        values[0], values[1], row[2:5], row[5:8], row[8:12], row[12:15], motors if len(motors) else None, row[15:19]
    )
    r = row[19 + MOTORS :]
    reference = Reference(
        LEVELS[level], r[0:3], r[3:6], r[6:9], float(r[9]), float(r[10]), r[11:15], r[15:18], float(r[18])
    )
    return number, phase, state, reference, Trim(float(r[19]), r[20:24], r[24:27])


def pack_output(number: int, output: Output | None, signals: dict[str, float]) -> bytes:
    """Raises TypeError, ValueError or struct.error for what is no output."""
    if output is None:
        return _OUTPUT.pack(OUTPUT, NOTHING, number, *[math.nan] * 6)
    if len(signals) > MOST_SIGNALS:
        raise ValueError(f"{len(signals)} signals are too many: at most {MOST_SIGNALS} numbers go out with a cycle")
    which = _CLASSES.index(type(output))
    head = _OUTPUT.pack(OUTPUT, which, number, *_numbers(output))
    return head + struct.pack(f"<{len(signals)}d", *signals.values())


def unpack_output(data: bytes) -> Answer:
    _, which, number, *values = _OUTPUT.unpack_from(data)
    signals = struct.unpack_from(f"<{(len(data) - _OUTPUT.size) // 8}d", data, _OUTPUT.size)
    return Answer(number, None if which == NOTHING else _output(_CLASSES[which], values), signals)


def _numbers(output: Output) -> list[float]:
    """Its vector, and what follows; six with zeros."""
    vector, *rest = vars(output).values()
    row, size = [float(part) for part in vector], _size(type(output))
    if len(row) != size:
        raise ValueError(f"it has {len(row)} numbers; expected {size}")
    may_lack = isinstance(output, Velocity | Acceleration)
    row += [math.nan if each is None and may_lack else float(each) for each in rest]
    return row + [0.0] * (6 - len(row))


def _output(cls: type[Output], v: list[float]) -> Output:
    size, count = _size(cls), len(fields(cls)) - 1
    rest: list[Any] = [None if math.isnan(each) else each for each in v[size : size + count]]
    return cls(np.array(v[:size]), *rest)


def _size(cls: type[Output]) -> int:
    """Of its vector: a quaternion, or north, east, down or x, y, z."""
    return 4 if cls is AttitudeThrust else 3


def pack_message(**what: Any) -> bytes:
    return TALK + json.dumps(what).encode()


def unpack_message(data: bytes) -> dict[str, Any]:
    """Raises ValueError for what is not JSON."""
    said = json.loads(data[1:])
    if not isinstance(said, dict):
        raise ValueError("expected an object")
    return said
