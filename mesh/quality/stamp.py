"""The probes between neighbours, as they travel.

A stamp is what RTCP's reports are to RTP (RFC 3550, 6.4): numbered, it says when it was sent and, of the last stamp
that came from the other side, when that was sent and how long it has been held. So each side learns the round trip and
the loss of both directions from one small message in each, nothing is answered, and the clocks need not agree.
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
_STAMP = struct.Struct("!BH8sIIIIH")
_A_STAMP = 0x53
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

    def pack(self) -> bytes:
        loss = _UNKNOWN if self.loss is None else min(round(self.loss * 10_000), 10_000)
        held = _NOTHING if self.held is None else min(self.held, _NOTHING - 1)
        period = min(round(self.period * 1e3), 0xFFFF)
        return _STAMP.pack(_A_STAMP, period, self.source, self.number, self.sent, self.echo, held, loss)

    def rtt(self, now: int) -> float | None:
        """s there and back, where this stamp came at ``now`` of our clock; None: it does not tell."""
        if self.held is None:
            return None
        span = (now - self.echo - self.held) % CLOCK / 1e6
        return span if span < MOST_RTT else None


def unpack(data: bytes) -> Stamp:
    """What a probe says; raises :class:`BadInput` for what is none."""
    if len(data) == _STAMP.size and data[0] == _A_STAMP:
        _, period, source, number, sent, echo, held, loss = _STAMP.unpack(data)
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
        )
    raise BadInput(f"{len(data)} bytes that are no probe", field="probe", expected=f"{_STAMP.size}")


def clock(seconds: float) -> int:
    """Monotonic seconds on a stamp's clock."""
    return int(seconds * 1e6) % CLOCK
