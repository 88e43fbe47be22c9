"""What a bearer puts before a datagram: a kind, who sends it, and which of the pair's flows it belongs to.

A probe and its echo are of one size, so that nobody can have a host send more than it was sent. Nothing here is secret
or proven: what is carried proves itself (QUIC with TLS), and a forged probe costs at most a worse choice of path.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import Union

OUT, BACK, PROBE, ECHO = 0xB1, 0xB2, 0xB3, 0xB4
"""a datagram from the side that opened the flow, one from the other side, and the two that measure a path"""
DATA_HEAD = struct.Struct("!BIH")
PROBE_HEAD = struct.Struct("!BIQI")


@dataclass(frozen=True)
class Data:
    """A flow's datagram."""

    sender: int
    flow: int
    back: bool
    """it comes from the side that did not open the flow"""
    payload: memoryview


@dataclass(frozen=True)
class Probe:
    """A question for an echo, or the echo."""

    sender: int
    nonce: int
    """64 random bits that only who was asked has seen"""
    number: int
    echo: bool


def host_tag(fleet: str, name: str) -> int:
    """32 bits that stand for a host of a fleet."""
    return int.from_bytes(hashlib.sha256(f"{fleet}/{name}".encode()).digest()[:4], "big")


def overhead(address: str) -> int:
    """Bytes of the IP and UDP headers before a datagram to ``address``."""
    return (40 if ":" in address else 20) + 8


def pack_data(sender: int, flow: int, back: bool, payload: bytes | memoryview) -> bytes:
    return DATA_HEAD.pack(BACK if back else OUT, sender, flow) + payload


def pack_probe(sender: int, nonce: int, number: int, *, echo: bool) -> bytes:
    return PROBE_HEAD.pack(ECHO if echo else PROBE, sender, nonce, number & 0xFFFFFFFF)


def unpack(data: memoryview) -> Union[Data, Probe, None]:  # noqa: UP007
    """What a datagram is; None for what no bearer sent."""
    if not data:
        return None
    kind = data[0]
    if kind in (OUT, BACK) and len(data) > DATA_HEAD.size:
        _, sender, flow = DATA_HEAD.unpack_from(data)
        return Data(sender, flow, kind == BACK, data[DATA_HEAD.size :])
    if kind in (PROBE, ECHO) and len(data) == PROBE_HEAD.size:
        _, sender, nonce, number = PROBE_HEAD.unpack_from(data)
        return Probe(sender, nonce, number, kind == ECHO)
    return None
