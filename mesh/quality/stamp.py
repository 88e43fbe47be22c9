"""The two kinds of probes between neighbours, as they travel.

A stamp is what RTCP's reports are to RTP (RFC 3550, 6.4): numbered, it says when it was sent and, of the last stamp
that came from the other side, when that was sent and how long it has been held. So each side learns round trip, loss
and jitter of both directions from one small message in each, nothing is answered, and the clocks need not agree. A
train is a few messages as large as a best-effort datagram, sent at once: the slowest part of the way spreads them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from zmav.errors import BadInput

SOURCE = 8
"""bytes of a router's id that tell it from others of its name"""
CLOCK = 1 << 32
"""µs after which a stamp's clock begins again: 71 minutes"""
MOST_RTT = 60.0
TRAIN_SIZE = 1000
"""bytes: with Zenoh's and QUIC's headers it still is one datagram of Zenoh's best-effort links (1150 bytes)"""
_STAMP = struct.Struct("!BH8sIIIIHI")
_CAR = struct.Struct("!B8sHBB")
_A_STAMP, _A_CAR = 0x51, 0x52
_NOTHING = 0xFFFF_FFFF
_UNKNOWN = 0xFFFF


@dataclass(frozen=True)
class Stamp:
    """One stamp. Times are µs of the sender's own monotonic clock, modulo ``CLOCK``."""

    source: bytes
    """of the router that sent it: ``SOURCE`` bytes"""
    period: float
    """s until the next one"""
    number: int
    """modulo 2^32"""
    sent: int
    echo: int = 0
    """when the last stamp that came was sent, by its sender's clock"""
    held: int | None = None
    """µs since that one came; None: none came yet"""
    loss: float | None = None
    """share of the other side's stamps that did not come, 0 to 1"""
    throughput: float | None = None
    """bytes/s that the other side's last train came at"""

    def pack(self) -> bytes:
        loss = _UNKNOWN if self.loss is None else min(round(self.loss * 10_000), 10_000)
        rate = 0 if self.throughput is None else min(round(self.throughput), _NOTHING)
        held = _NOTHING if self.held is None else min(self.held, _NOTHING - 1)
        period = min(round(self.period * 1e3), 0xFFFF)
        return _STAMP.pack(_A_STAMP, period, self.source, self.number, self.sent, self.echo, held, loss, rate)

    def rtt(self, now: int) -> float | None:
        """s there and back, where this stamp came at ``now`` of our clock; None: it does not tell."""
        if self.held is None:
            return None
        span = (now - self.echo - self.held) % CLOCK / 1e6
        return span if span < MOST_RTT else None


@dataclass(frozen=True)
class Car:
    """One message of a train."""

    source: bytes
    train: int
    """which train, modulo 2^16"""
    index: int
    count: int

    def pack(self) -> bytes:
        return _CAR.pack(_A_CAR, self.source, self.train, self.index, self.count).ljust(TRAIN_SIZE, b"\0")


def unpack(data: bytes) -> Stamp | Car:
    """What a probe says; raises :class:`BadInput` for what is none."""
    if len(data) == _STAMP.size and data[0] == _A_STAMP:
        _, period, source, number, sent, echo, held, loss, rate = _STAMP.unpack(data)
        if period == 0 or (loss > 10_000 and loss != _UNKNOWN):
            raise BadInput(f"a stamp with period {period} and loss {loss}", field="probe", expected="numbers there are")
        return Stamp(
            source,
            period / 1e3,
            number,
            sent,
            echo,
            held=None if held == _NOTHING else held,
            loss=None if loss == _UNKNOWN else loss / 10_000,
            throughput=rate or None,
        )
    if len(data) == TRAIN_SIZE and data[0] == _A_CAR:
        _, source, train, index, count = _CAR.unpack_from(data)
        if index >= count:
            raise BadInput(f"message {index} of a train of {count}", field="probe", expected="less than its count")
        return Car(source, train, index, count)
    raise BadInput(f"{len(data)} bytes that are no probe", field="probe", expected=f"{_STAMP.size} or {TRAIN_SIZE}")


def clock(seconds: float) -> int:
    """Monotonic seconds on a stamp's clock."""
    return int(seconds * 1e6) % CLOCK
