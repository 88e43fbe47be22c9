"""What the lab and its relay say to each other: MessagePack over a Unix socket, each message after its length.

The lab asks and the relay answers, in turn. Everything is by number here; the lab alone knows names.
"""

from __future__ import annotations

import socket
import struct

import msgspec

from mesh.lab.channel import Conditions, Counters

_LENGTH = struct.Struct("!I")


class TapSpec(msgspec.Struct, frozen=True):
    """One interface of a host."""

    host: int
    name: str
    mac: bytes
    address: str
    prefix: int
    mtu: int


class Pair(msgspec.Struct, frozen=True):
    """Two ends and the channels there and back. Ends are interfaces, or bridges for a segment's hops."""

    a: int
    b: int
    ab: int
    ba: int


class LinkSpec(msgspec.Struct, frozen=True, tag="link"):
    """Two interfaces."""

    pair: Pair
    shared: bool


class SegmentSpec(msgspec.Struct, frozen=True, tag="segment"):
    """Bridges: the interfaces behind each, and the hops between them."""

    behind: list[list[int]]
    hops: list[Pair]
    shared: bool


class EtherSpec(msgspec.Struct, frozen=True, tag="ether"):
    """Stations by interface; pairs are of places in ``taps``."""

    taps: list[int]
    pairs: list[Pair]
    shared: bool


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """The first message: everything there is. Answered with :class:`Begun`."""

    hosts: int
    taps: list[TapSpec]
    media: list[LinkSpec | SegmentSpec | EtherSpec]
    channels: list[Conditions]
    seed: int
    directory: str | None = None
    """removed when the lab ends, however it ends"""


class Begun(msgspec.Struct, frozen=True, tag="begun"):
    """The relay runs. Namespace ``i`` is ``/proc/{pid}/fd/{networks[i]}``."""

    pid: int
    networks: list[int]


class Set(msgspec.Struct, frozen=True, tag="set"):
    """Change channels' conditions, all at one moment."""

    channels: dict[int, Conditions]


class AskCounters(msgspec.Struct, frozen=True, tag="counters"):
    """Answered with :class:`Counted`."""


class Counted(msgspec.Struct, frozen=True, tag="counted"):
    """By channel; by interface how many frames the host did not take; CPU seconds of the relay so far."""

    channels: list[Counters]
    refused: list[int]
    cpu_s: float
    under_way: int


class Record(msgspec.Struct, frozen=True, tag="record"):
    """Write what arrives by these channels to a file; an empty list ends it."""

    channels: list[int]
    path: str


class Done(msgspec.Struct, frozen=True, tag="done"):
    """It is done."""


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """It is not done, and why."""

    errno: int
    text: str


Request = Begin | Set | AskCounters | Record
Answer = Begun | Counted | Done | Failed


def write(s: socket.socket, message: Request | Answer) -> None:
    """Raises :class:`OSError` where nobody reads."""
    data = msgspec.msgpack.encode(message)
    s.sendall(_LENGTH.pack(len(data)) + data)


def read_request(s: socket.socket) -> Request:
    """Raises :class:`EOFError` where nobody writes any more."""
    request: Request = msgspec.msgpack.decode(_take(s), type=Request)
    return request


def read_answer(s: socket.socket) -> Answer:
    """Raises :class:`EOFError` where nobody writes any more."""
    answer: Answer = msgspec.msgpack.decode(_take(s), type=Answer)
    return answer


def _take(s: socket.socket) -> bytes:
    (length,) = _LENGTH.unpack(_exactly(s, _LENGTH.size))
    return _exactly(s, length)


def _exactly(s: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        part = s.recv(min(size - len(data), 1 << 20))
        if not part:
            raise EOFError("the other end has gone")
        data += part
    return bytes(data)
