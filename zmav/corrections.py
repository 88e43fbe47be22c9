"""Corrections for GNSS receivers as they travel to the whole fleet, and which of several sources is in charge.

What a base has measured for one moment is put once, on ``@fleet/rtcm``: some messages of RTCM 3 behind a header
(big-endian)::

    2s  magic "zR"          B  version, 1          B  priority of the source, the highest is in charge
    I   the source: a number it draws at its start  Q  UTC in µs since which it is in charge
    Q   UTC in µs at which the messages came to it  I  sequence           B  length of its name, which follows

Those of one moment that are too many for one datagram have the same time. No Zenoh and no clock here.
"""

from __future__ import annotations

import struct
from typing import Generic, NamedTuple, Protocol, TypeVar

from zmav.errors import BadMessage
from zmav.formats import rtcm3
from zmav.formats.rtcm3 import MOST_MESSAGE, Message

MAGIC, VERSION = b"zR", 1
HEADER = struct.Struct(">2sBBIQQIB")
ROOM = 1000
"""bytes of messages in one datagram of the network, beside its proof of origin; a message alone may be longer"""
MOST_NAME = 32
MOST = HEADER.size + MOST_NAME + ROOM + MOST_MESSAGE
"""bytes of a batch that are looked at"""
OLDEST_S = 5.0
"""s after which corrections are dropped: receivers would take them for of now a while longer, but newer ones come"""
PATIENCE_S = 10.0
"""s without a word of the source in charge after which another takes its place: some bases speak each five"""
LATEST_US = 1 << 57


class Batch(NamedTuple):
    """What one source had of one moment, or a part of it."""

    priority: int
    instance: int
    since_us: int
    t_us: int
    sequence: int
    source: str
    messages: tuple[Message, ...]

    @property
    def t(self) -> float:
        """UTC seconds, by the source's clock."""
        return self.t_us / 1e6

    @property
    def rank(self) -> tuple[int, int, int]:
        """Among several sources the highest is in charge: by priority, and then who has been for longest."""
        return self.priority, -self.since_us, -self.instance

    def pack(self) -> bytes:
        name = self.source.encode("ascii", "replace")[:MOST_NAME]
        head = MAGIC, VERSION, self.priority, self.instance, self.since_us, self.t_us, self.sequence, len(name)
        return HEADER.pack(*head) + name + b"".join(each.data for each in self.messages)


def unpack(payload: bytes) -> Batch:
    """Read what came; raises :class:`BadMessage` for anything that is not whole messages behind a header."""
    if not HEADER.size <= len(payload) <= MOST:
        raise BadMessage(f"{len(payload)} bytes are no corrections ({HEADER.size} to {MOST})")
    magic, version, priority, instance, since_us, t_us, sequence, length = HEADER.unpack_from(payload)
    if (magic, version) != (MAGIC, VERSION):
        raise BadMessage(f"they begin with {payload[:3]!r}, not as corrections of version {VERSION} do")
    name = payload[HEADER.size : HEADER.size + length]
    messages = rtcm3.split(payload[HEADER.size + length :])
    if length > MOST_NAME or len(name) < length or not name.isascii() or max(since_us, t_us) > LATEST_US:
        raise BadMessage("the header of these corrections is wrong")
    if not messages:
        raise BadMessage("they hold something else than whole RTCM 3 messages")
    return Batch(priority, instance, since_us, t_us, sequence, name.decode("ascii"), tuple(messages))


def batches(messages: list[Message]) -> list[tuple[Message, ...]]:
    """Those of one moment in their order, in as many parts as datagrams need."""
    found: list[list[Message]] = []
    size = 0
    for message in messages:
        if not found or size + len(message.data) > ROOM:
            found.append([])
            size = 0
        found[-1].append(message)
        size += len(message.data)
    return [tuple(each) for each in found]


class Ranked(Protocol):
    """What a source says, and how it stands among others."""

    @property
    def instance(self) -> int: ...

    @property
    def rank(self) -> tuple[float, float, float]: ...


R = TypeVar("R", bound=Ranked)


class Charge(Generic[R]):
    """Which source is in charge, as one listener hears it: the highest rank of those that spoke of late.

    A vehicle follows it, and a source stands by while another than itself is.
    """

    def __init__(self, patience: float = PATIENCE_S) -> None:
        self._patience = patience
        self.last: R | None = None
        """the newest of the one in charge"""
        self._at = 0.0

    def hear(self, batch: R, now: float) -> bool:
        """Whether it is of the source in charge, at ``now`` (monotonic seconds)."""
        last = self.of(now)
        if last is not None and batch.instance != last.instance and batch.rank < last.rank:
            return False
        self.last, self._at = batch, now
        return True

    def of(self, now: float) -> R | None:
        """The newest word of the source in charge; None where all are silent."""
        return self.last if now - self._at <= self._patience else None
