"""Message rates and statistics."""

from __future__ import annotations

from zmav.wire.base import Wire


class MessageRate(Wire, kw_only=True):
    """One kind of message on the vehicle's link."""

    name: str
    hz: float
    """received over the last seconds"""
    bytes_rate: float
    """bytes a second, framing included"""
    count: int
    age: float | None = None
    asked_hz: float | None = None
    """what the autopilot was asked for; None: it sends this by itself"""
    wanted_hz: float | None = None
    """the highest rate a reader wants"""
    shed: bool = False
    """sent slower than wanted, for the link is full"""


class RateTable(Wire, kw_only=True):
    """Reply to ``rates``."""

    t: float
    capacity: float | None = None
    """bytes a second the link can carry (serial: its baud rate over ten); None: not limited by its kind"""
    used: float = 0.0
    messages: list[MessageRate] = []
