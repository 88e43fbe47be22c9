"""Message rates and statistics."""

from __future__ import annotations

from zmav.wire.base import Told


class MessageRate(Told, kw_only=True):
    """One kind of message from one component, heard on the vehicle's link or wanted from its autopilot."""

    name: str
    sysid: int | None = None
    compid: int | None = None
    """None: wanted, and never heard"""
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
    readers: list[str] = []
    """who wants it: ``floor`` and ``clock`` are the vehicle's own, a name with a number a token, ``subscriber`` one
    without"""
    shed: bool = False
    """sent slower than wanted, for the link is full"""
    refused: str | None = None
    """MAV_RESULT without its prefix, where the autopilot does not send it at the rate wanted"""


class RateTable(Told, kw_only=True):
    """Reply to ``rates``."""

    t: float
    capacity: float | None = None
    """bytes a second the link can carry (serial: its baud rate over ten); None: not limited by its kind"""
    used: float = 0.0
    junk: int = 0
    """tokens that name no message or no rate from above 0 to 500 Hz, left out"""
    messages: list[MessageRate] = []
