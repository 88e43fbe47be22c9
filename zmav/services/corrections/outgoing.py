"""What of the corrections waits for the autopilot's link, and when the next fragment may go.

The last full moment wins: one that has begun is finished, for receivers want the satellites of a moment together, and
of those that wait meanwhile each message gives way to a newer one of its number. So a line that is too slow for all has
fewer moments, each of them whole. What is too old is not begun.
"""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterator
from typing import NamedTuple

from zmav.corrections import OLDEST_S, Batch
from zmav.formats.rtcm3 import Message
from zmav.mavlink.rtcm import SEQUENCES, cut, sequences

SHARE = 0.25
"""of a line that corrections may have: of 57,600 baud 1.4 kB/s"""
LEAST, FREE = 500.0, 20_000.0
"""B/s that they may have of any line, however slow, and of one that is not known to have a limit"""
AROUND = 16
"""bytes of a frame of MAVLink 2 around the piece: header, flags, length, CRC"""
MOST_WAITING = 8_192
"""bytes of messages that wait: some seconds of a rich base on a slow line"""


class Waiting(NamedTuple):
    """A message, and the time of its moment at the source (UTC µs)."""

    message: Message
    t_us: int


class Pace:
    """Bytes a second on a link: a fragment goes when those before are paid for. ``capacity``: the link's, B/s."""

    def __init__(self, capacity: Callable[[], float | None]) -> None:
        self._capacity = capacity
        self._paid_at = 0.0

    @property
    def rate(self) -> float:
        capacity = self._capacity()
        return FREE if capacity is None else min(max(capacity * SHARE, LEAST), FREE)

    def wait(self, now: float) -> float:
        """Seconds until the next fragment may go."""
        return max(self._paid_at - now, 0.0)

    def spend(self, size: int, now: float) -> None:
        self._paid_at = max(self._paid_at, now) + size / self.rate


class Outgoing:
    """The moment that is being sent, and the newest that waits. Not thread-safe.

    ``dropped`` counts messages by reason.
    """

    def __init__(self) -> None:
        self._now: collections.deque[Waiting] = collections.deque()
        self._next: collections.deque[Waiting] = collections.deque()
        self._t_us = 0
        """of the moment that is being sent"""
        self._sequence = 0
        self.dropped: collections.Counter[str] = collections.Counter()

    def put(self, batch: Batch) -> None:
        new = [Waiting(message, batch.t_us) for message in batch.messages]
        if batch.t_us == self._t_us and self._now:
            self._now.extend(new)  # another part of it
        else:
            numbers = {message.number for message in batch.messages}
            keep = [each for each in self._next if each.t_us == batch.t_us or each.message.number not in numbers]
            self.dropped["overtaken"] += len(self._next) - len(keep)
            self._next = collections.deque(keep + new)
        size = sum(len(each.message.data) for each in (*self._now, *self._next))
        while size > MOST_WAITING:
            size -= len((self._now or self._next).popleft().message.data)
            self.dropped["full"] += 1

    def next(self, utc: float) -> Waiting | None:
        """The next message that is still worth its way; None: nothing waits."""
        while self._now or self._next:
            if not self._now:
                self._now, self._next = self._next, collections.deque()
                self._t_us = max(each.t_us for each in self._now)
            found = self._now.popleft()
            if utc - found.t_us / 1e6 <= OLDEST_S:
                return found
            self.dropped["old"] += 1
        return None

    def clear(self) -> None:
        """Another source's are not mixed with these."""
        self.dropped["overtaken"] += len(self._now) + len(self._next)
        self._now.clear()
        self._next.clear()

    def pieces(self, message: Message) -> Iterator[tuple[int, bytes]]:
        """Flags and bytes of its fragments, under the next sequence."""
        first, self._sequence = self._sequence, (self._sequence + sequences(message.data)) % SEQUENCES
        return cut(message.data, first)
