"""Measuring the network between two hosts: the order each of them gets, and what each reports.

Times within a run are seconds since its first datagram; spreads are seconds. Nothing here is UTC but ``Pong.t``.
"""

from __future__ import annotations

from typing import Literal

from zmav.wire.base import Told, Wire

BenchRole = Literal["send", "receive", "query"]
BenchQos = Literal["realtime", "must-arrive", "latest-wins", "bulk"]
BenchState = Literal["waiting", "running", "done", "stopped", "failed"]


class BenchOrder(Wire, kw_only=True):
    """``bench/order/start``: one host's part of a run. The same order sent again is the same run."""

    run: str
    role: BenchRole
    """``send`` and ``receive`` are the two ends of a stream; ``query`` asks ``peer`` for an answer"""
    peer: str
    seconds: float
    hz: float
    """datagrams or queries a second"""
    size: int
    """bytes of payload"""
    qos: BenchQos
    gap: float = 0.5
    """s without a datagram that make an outage"""
    guard: float = 0.0
    """Hz of small queries in the realtime class beside the stream; 0: none"""
    patience: float = 5.0
    """s without a word from the asker after which it ends"""
    asker: str = ""


class BenchStop(Wire, kw_only=True):
    """``bench/order/stop``: end a run, if it is the one."""

    run: str


class BenchQuery(Wire, kw_only=True):
    """``bench/report/{run}``: what there is to tell from these indices on."""

    since: int = 0
    """index of the first interval wanted"""
    outages: int = 0
    """index of the first outage wanted"""


class Spread(Told, kw_only=True):
    """Some durations."""

    count: int
    min: float
    median: float
    p95: float
    p99: float
    max: float


class BenchInterval(Told, kw_only=True):
    """What the receiver saw in one second, or in the whole run."""

    start: float
    end: float
    bytes: int
    """of payload"""
    received: int
    expected: int
    """datagrams, by the numbers they carry"""
    jitter: float
    """s, at its end: the smoothed difference of transit times of RFC 3550, section 6.4.1"""
    transit: Spread | None = None
    """the receiver's clock less the sender's: :attr:`BenchClock.offset` makes it a delay"""

    @property
    def lost(self) -> int:
        return max(self.expected - self.received, 0)


class BenchOutage(Told, kw_only=True):
    """A silence longer than the order's ``gap``."""

    start: float
    length: float
    lost: int
    """datagrams that had not come when it ended; some may have come late"""


class BenchClock(Told, kw_only=True):
    """The peer's clock less ours, by the exchange of the shortest round trip, as NTP does (RFC 5905, section 8)."""

    offset: float
    """s between the monotonic clocks, which nobody sets while we measure"""
    within: float
    """s by which that may be wrong: half the round trip, and 50 ppm of what has passed since"""
    utc_offset: float
    """s between the clocks of the day"""


class BenchTrip(Told, kw_only=True):
    """Round trips to one host, by query."""

    peer: str
    sent: int
    lost: int
    """without an answer in time"""
    rtt: Spread | None = None


class BenchReport(Told, kw_only=True):
    """One host's view of a run, so far or in the end."""

    run: str
    host: str
    role: BenchRole
    state: BenchState
    why: str = ""
    sent: int = 0
    send_seconds: float = 0.0
    """from the first datagram's time to the end of the last one's"""
    skipped: int = 0
    """datagrams whose time had passed before the sender came to them"""
    lateness: Spread | None = None
    """of the sender's own datagrams after their time"""
    total: BenchInterval | None = None
    intervals: list[BenchInterval] = []
    outages: list[BenchOutage] = []
    clock: BenchClock | None = None
    trips: list[BenchTrip] = []
    """of a stream with a guard: before it, and beside it"""


class Pong(Told, kw_only=True):
    """``bench/ping``: who answers, with its clocks."""

    host: str
    zid: str
    came_ns: int
    """monotonic"""
    left_ns: int
    t: float
    """UTC seconds when it left"""
    busy: str = ""
    """who measures there now, in words"""
