"""What the lab and its relay say to each other, over a connection of :mod:`multiprocessing`.

The lab asks and the relay answers, in turn. Channels are by number.
"""

from __future__ import annotations

import msgspec

from mesh.lab.channel import Conditions, Counters


class Interface(msgspec.Struct, frozen=True):
    """One host's interface on a medium."""

    host: str
    medium: str
    name: str
    address: str
    prefix: int
    mac: bytes
    mtu: int


class Edge(msgspec.Struct, frozen=True):
    """Two hosts that may hear each other, with a channel each way."""

    name: str
    """``a-b``, or ``medium:a-b`` where several media join the two"""
    medium: str
    a: str
    b: str
    ab: int
    ba: int


class MediumSpec(msgspec.Struct, frozen=True):
    """How a medium is made."""

    name: str
    shared: bool


class Begin(msgspec.Struct, frozen=True):
    """The first message: everything there is. Answered with :class:`Begun`."""

    hosts: tuple[str, ...]
    interfaces: list[Interface]
    media: list[MediumSpec]
    edges: list[Edge]
    channels: list[Conditions]
    seed: int
    directories: list[str] = []
    """removed when the lab ends, however it ends"""


class Begun(msgspec.Struct, frozen=True):
    """The relay runs. Namespace ``i`` is ``/proc/{pid}/fd/{networks[i]}``."""

    pid: int
    networks: list[int]


class Set(msgspec.Struct, frozen=True):
    """Change channels' conditions, all at one moment; none, and it only asks."""

    channels: dict[int, Conditions] = {}


class Counted(msgspec.Struct, frozen=True):
    """What every later message is answered with. By channel; CPU seconds of the relay so far, and frames under way."""

    channels: list[Counters]
    cpu_s: float
    under_way: int


Request = Begin | Set
Answer = Begun | Counted | OSError
"""an error: it is not done, and why"""
