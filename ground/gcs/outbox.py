"""What waits for a client that cannot take everything at once: answers in order, of telemetry only the newest."""

from __future__ import annotations

import collections
from typing import NamedTuple

MOST_URGENT = 512
"""frames that must arrive and wait; their sender is told when there is no room"""
MOST_LISTED = 16
"""such frames beyond which a list of parameters waits"""
MOST_FRESH = 4096
"""messages of which the newest waits"""


class Item(NamedTuple):
    source: int
    """system and component, as one number"""
    data: bytes


class Outbox:
    """First what must arrive, in the order in which it came; then HEARTBEATs; then the rest, in turn, of each message
    of each component the newest. Not thread-safe.
    """

    def __init__(self) -> None:
        self._urgent: collections.deque[Item] = collections.deque()
        self._beats: dict[object, Item] = {}
        self._fresh: dict[object, Item] = {}
        self.replaced = 0
        """frames that a newer one took the place of"""

    def __len__(self) -> int:
        return len(self._urgent) + len(self._beats) + len(self._fresh)

    @property
    def has_room(self) -> bool:
        """For the lists that answerers send: a short answer is not to wait behind a thousand parameters."""
        return len(self._urgent) < MOST_LISTED

    def put_urgent(self, item: Item) -> bool:
        if len(self._urgent) >= MOST_URGENT:
            return False
        self._urgent.append(item)
        return True

    def put_fresh(self, name: object, item: Item, beat: bool) -> None:
        """``name``: what the frame is, so that a newer one of it takes its place, and its turn."""
        waiting = self._beats if beat else self._fresh
        if name in waiting:
            self.replaced += 1
        elif len(waiting) >= MOST_FRESH:
            return
        waiting[name] = item

    def first(self) -> Item | None:
        """What goes next; None: nothing waits."""
        if self._urgent:
            return self._urgent[0]
        for waiting in (self._beats, self._fresh):
            for item in waiting.values():
                return item
        return None

    def pop(self) -> None:
        """Take out what :meth:`first` gave."""
        if self._urgent:
            self._urgent.popleft()
            return
        for waiting in (self._beats, self._fresh):
            for name in waiting:
                del waiting[name]
                return
