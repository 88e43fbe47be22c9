"""One direction of a link, or what one radio hears of another: a frame's way from its sender to its receiver.

A frame waits for its turn on the :class:`Air` (a rate and a queue), is lost or not, and arrives after the delay. There
is no queue as such: because the rate is known, so is the moment at which a frame has left, and frames on their way lie
in one heap for all channels, by the moment at which they arrive (:class:`Agenda`).
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable

import msgspec

Deliver = Callable[[bytes, float], None]
"""takes a frame and the time (:func:`time.monotonic`)"""


class Conditions(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """How a channel treats frames."""

    up: bool = True
    delay: float = 0.0
    """s"""
    jitter: float = 0.0
    """s more or less than the delay, every value as likely as any other"""
    ordered: bool = True
    """with jitter: a frame never overtakes another"""
    loss: float = 0.0
    """share of the frames that is lost, from 0 to 1"""
    burst: float = 1.0
    """frames in a row that are lost, on average: Gilbert's model with a state in which all are; 1: each by itself"""
    rate: float | None = None
    """bit/s, of Ethernet frames; None: no limit"""
    queue: int = 64_000
    """bytes that may wait for their turn; what comes then is dropped"""


class Counters(msgspec.Struct):
    """What became of the frames given to a channel."""

    frames: int = 0
    bytes: int = 0
    arrived: int = 0
    arrived_bytes: int = 0
    lost: int = 0
    """by chance"""
    down: int = 0
    """while the channel was down, or on their way when it went down"""
    queue_full: int = 0


class Agenda:
    """Frames on their way."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Channel, int, bytes]] = []
        self._number = 0

    def add(self, due: float, channel: Channel, frame: bytes) -> None:
        """Have ``frame`` arrive at ``due``; of frames due at one moment the first added is the first to arrive."""
        self._number += 1
        heapq.heappush(self._heap, (due, self._number, channel, channel.epoch, frame))

    def retime(self, channel: Channel, due: Callable[[float], float]) -> float:
        """Let what is under way in a channel arrive at ``due(old)`` instead; gives the latest of them, or 0."""
        latest = 0.0
        for i, (old, number, owner, epoch, frame) in enumerate(self._heap):
            if owner is channel and epoch == channel.epoch:
                self._heap[i] = (due(old), number, owner, epoch, frame)
                latest = max(latest, self._heap[i][0])
        heapq.heapify(self._heap)
        return latest

    def dues(self) -> list[float]:
        """When each is due, in order."""
        return sorted(due for due, *_ in self._heap)

    def next(self) -> float | None:
        """When the next one is due."""
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)

    def run(self, now: float) -> None:
        """Let arrive what is due."""
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= now:
            _, _, channel, epoch, frame = pop(heap)
            if epoch == channel.epoch:
                channel.arrive(frame, now)
            else:
                channel.counters.down += 1


class Air:
    """What frames take turns on: a wire's one direction, or a radio channel that several share."""

    __slots__ = ("_retimed_at", "free_at")

    def __init__(self) -> None:
        self.free_at = 0.0
        self._retimed_at = 0.0

    def stretch(self, times: float, now: float) -> None:
        """The rate has changed: what waits takes ``times`` as long. Once a moment, however many channels share it."""
        if self._retimed_at < now < self.free_at:
            self._retimed_at, self.free_at = now, now + (self.free_at - now) * times

    def admit(self, size: int, rate: float | None, c: Conditions, now: float) -> float | None:
        """When a frame that comes now has left; None if it finds the queue full."""
        if rate is None:
            return now
        begin = self.free_at if self.free_at > now else now
        if (begin - now) * rate > 8.0 * c.queue:
            return None
        self.free_at = begin + 8.0 * size / rate
        return self.free_at


class Channel:
    """From one sender to one receiver."""

    def __init__(self, conditions: Conditions, air: Air, agenda: Agenda, deliver: Deliver, seed: int) -> None:
        self.conditions, self.air, self.counters = conditions, air, Counters()
        self.epoch = 0
        """counts outages: what was under way before one does not arrive"""
        self._agenda, self._deliver = agenda, deliver
        self._random = random.Random(seed).random
        self._in_burst = False
        self._last_due = 0.0

    def set(self, conditions: Conditions, now: float) -> None:
        """Change the conditions. What waits for its turn keeps its place, at the new rate and with the new delay."""
        old, self.conditions = self.conditions, conditions
        if not conditions.up:
            self.epoch += old.up
            self._last_due = 0.0
        elif (old.rate, old.delay) != (conditions.rate, conditions.delay):
            times = old.rate / conditions.rate if old.rate and conditions.rate else 1.0 if old.rate is None else 0.0

            def due(at: float) -> float:
                left = at - old.delay
                return (now + (left - now) * times if left > now else left) + conditions.delay

            self._last_due = self._agenda.retime(self, due)
            self.air.stretch(times, now)

    def send(self, frame: bytes, now: float) -> None:
        """Take a frame that has the air to itself: of a link, or to one receiver."""
        size = len(frame)
        self.counters.frames += 1
        self.counters.bytes += size
        c = self.conditions
        if not c.up:
            self.counters.down += 1
            return
        left = self.air.admit(size, c.rate, c, now)
        if left is None:
            self.counters.queue_full += 1
            return
        self.carry(frame, left, now)

    def carry(self, frame: bytes, left: float, now: float) -> None:
        """Take a frame that has left the sender, or will have at ``left``, to the receiver, unless it is lost."""
        c = self.conditions
        if c.loss and self._is_lost(c):
            self.counters.lost += 1
            return
        due = left + c.delay
        if c.jitter:
            due += c.jitter * (2.0 * self._random() - 1.0)
        behind = c.ordered and due <= self._last_due  # that one may still be under way
        if behind:
            due = self._last_due
        self._last_due = max(due, self._last_due)
        if due <= now and not behind:
            self.arrive(frame, now)
        else:
            self._agenda.add(due, self, frame)

    def arrive(self, frame: bytes, now: float) -> None:
        """Give a frame to the receiver."""
        self.counters.arrived += 1
        self.counters.arrived_bytes += len(frame)
        self._deliver(frame, now)

    def _is_lost(self, c: Conditions) -> bool:
        """Gilbert's two states: bursts of ``burst`` frames on average, so rare that ``loss`` of all frames is lost."""
        if c.burst <= 1.0 or c.loss >= 1.0:
            return self._random() < c.loss
        if self._in_burst:
            self._in_burst = self._random() >= 1.0 / c.burst
        else:
            self._in_burst = self._random() < c.loss / (c.burst * (1.0 - c.loss))
        return self._in_burst
