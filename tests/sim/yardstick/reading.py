"""Recordings as lists of messages, no matter who made them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Splitter

Message = tuple[float, str, dict[str, Any]]
"""seconds since the beginning, name, fields"""


def from_tlog(path: Path, dialect: Dialect, sysid: int | None = None) -> Iterator[Message]:
    """Messages of a recording: 8 bytes of big-endian microseconds before each frame."""
    data, at, start = path.read_bytes(), 0, None
    splitter = Splitter(dialect)
    while at < len(data):
        stamp = int.from_bytes(data[at : at + 8], "big") / 1e6
        start = stamp if start is None else start
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        for frame in splitter.feed(data[at + 8 : at + 8 + size]):
            if frame.verified and sysid in (None, frame.sysid):
                yield stamp - start, dialect.name_of(frame.msgid), decode(frame, dialect)
        at += 8 + size


def flat(fields: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Numbers by field; those of an array as ``name[0]``, ``name[1]``, ..."""
    for name, value in fields.items():
        if isinstance(value, int | float):
            yield name, float(value)
        elif isinstance(value, list | tuple):
            for i, each in enumerate(value):
                if isinstance(each, int | float):
                    yield f"{name}[{i}]", float(each)


def rates(messages: list[Message]) -> dict[str, float]:
    """Messages a second, from the first to the last, of those that came at least ten times."""
    times: dict[str, list[float]] = defaultdict(list)
    for at, name, _ in messages:
        times[name].append(at)
    return {name: (len(t) - 1) / (t[-1] - t[0]) for name, t in times.items() if len(t) >= 10}


def states(messages: list[Message], name: str, *fields: str) -> list[tuple[int, ...]]:
    """The values that these fields went through."""
    found: list[tuple[int, ...]] = []
    for _, each, values in messages:
        step = tuple(values[f] for f in fields if f in values)
        if each == name and found[-1:] != [step]:
            found.append(step)
    return found
