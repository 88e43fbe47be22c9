"""Puts a source's corrections on ``@fleet/rtcm``, once for all vehicles, while no other source is in charge.

``zmav rtk`` has one, and ``zmav gcs`` where a station injects corrections.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import functools
import random
import time
from collections.abc import Callable

import zenoh

import zmav
from ground.program import hear_proven
from zmav import keys
from zmav.corrections import MOST, MOST_NAME, OLDEST_S, PATIENCE_S, Batch, Charge, batches, unpack
from zmav.errors import BadConfig, BadMessage, Forbidden
from zmav.formats.rtcm3 import Cutter, Ecef, Message
from zmav.waiting import on_loop

GATHER_S = 0.05, 0.3
"""``gather`` of a :class:`Publisher`: a base's line may be slow"""
LISTEN_S = 1.5
"""s for which a source that has just begun listens whether another is in charge; most bases speak once a second"""
MOST_RATE, BURST = 4_000.0, 12_000.0
"""bytes a second of a source, and at once: three times what a base with four systems sends"""
MOST_OTHERS = 16
"""batches of others that wait to be looked at, the newest"""
RATE_S = 10.0
"""s over which rates are taken"""


class Publisher:
    """``with Publisher(z, "gs", say): ...``; lives on the event loop. ``gather``: s without a message after which a
    moment is over, and s that it lasts at most.

    Raises :class:`BadConfig` where no fleet is named, and :class:`Forbidden` where our role may not.
    """

    def __init__(
        self,
        z: zmav.Client,
        name: str,
        say: Callable[[str], None] = lambda line: None,
        priority: int = 0,
        patience: float = PATIENCE_S,
        listen: float = LISTEN_S,
        gather: tuple[float, float] = GATHER_S,
    ) -> None:
        self._z, self._say, self._priority, self._patience = z, say, priority, patience
        self._speaks_at, self._gather = time.monotonic() + listen, gather
        self.name = name[:MOST_NAME]
        self._key = key_of(z)
        self._instance = random.getrandbits(32)
        self._cutter, self._charge = Cutter(), Charge[Batch](patience)
        self._gathered: list[Message] = []
        self._flush: asyncio.TimerHandle | None = None
        self._began = self._began_utc = 0.0
        """monotonic and UTC seconds of the first message of the moment"""
        self._since_us: int | None = None
        self._sequence, self._sent_at = 0, 0.0
        self._room, self._room_at = BURST, 0.0
        self._sizes: collections.deque[tuple[float, int]] = collections.deque()
        self.heard = 0.0
        """monotonic seconds of the last message of the source; 0: none yet"""
        self.numbers: collections.Counter[int] = collections.Counter()
        """messages of the source by number"""
        self.flooded = 0
        """messages that were too many"""
        self.station: int | None = None
        self.base: Ecef | None = None
        self.stands_by_for = ""
        """which other source is in charge; empty: none"""

    def __enter__(self) -> Publisher:
        self._publisher = self._z.session.declare_publisher(self._key, **keys.RTCM.publishing())
        hear = on_loop(asyncio.get_running_loop(), self._hear)

        def read(payload: bytes) -> Batch:
            batch = unpack(payload)
            if batch.instance == self._instance:
                raise BadMessage("it is our own")
            return batch

        take = functools.partial(hear_proven, self._z, self._key, read, lambda _, batch: hear(batch))
        self._others = take(largest=MOST, most=MOST_OTHERS)
        return self

    def __exit__(self, *_: object) -> None:
        if self._flush is not None:
            self._flush.cancel()
        self._others.close()
        self._publisher.undeclare()

    def _hear(self, batch: Batch) -> None:
        """Vehicles drop what is not of now: one whose clock is wrong has charge of nobody, and keeps none away."""
        if abs(time.time() - batch.t) <= OLDEST_S:
            self._charge.hear(batch, time.monotonic())

    # From the source.

    def feed(self, data: bytes) -> list[Message]:
        """Bytes of the source, whatever is between the messages; those that are whole by now."""
        found = self._cutter.feed(data)
        self.put(found)
        return found

    def put(self, messages: list[Message]) -> None:
        """Messages of the source; those with less than the pause of ``gather`` between them are of one moment."""
        now = time.monotonic()
        self._forget(now)
        for message in messages:
            self.heard = now
            if len(self.numbers) < 200 or message.number in self.numbers:
                self.numbers[message.number] += 1
            self.station = self.station if message.station is None else message.station
            self.base = message.place or self.base
            if not self._has_room(len(message.data), now):
                self.flooded += 1
                continue
            self._gathered.append(message)
            self._sizes.append((now, len(message.data)))
        if self._flush is None:
            self._began, self._began_utc = now, time.time()
        else:
            self._flush.cancel()
        if self._gathered:
            pause, most = self._gather
            left = min(pause, self._began + most - now)
            self._flush = asyncio.get_running_loop().call_later(left, self._send, self._began_utc)

    def _has_room(self, size: int, now: float) -> bool:
        self._room = min(self._room + (now - self._room_at) * MOST_RATE, BURST)
        self._room_at = now
        if self._room < size:
            return False
        self._room -= size
        return True

    def _forget(self, now: float) -> None:
        while self._sizes and now - self._sizes[0][0] > RATE_S:
            self._sizes.popleft()

    @property
    def rate(self) -> float:
        """Bytes a second of the source."""
        self._forget(time.monotonic())
        return sum(size for _, size in self._sizes) / RATE_S

    @property
    def age(self) -> float | None:
        """s since the source's last message; None: none came yet."""
        return time.monotonic() - self.heard if self.heard else None

    @property
    def in_charge(self) -> bool:
        return self._since_us is not None and bool(self.age is not None and self.age <= self._patience)

    # To the fleet.

    def _send(self, t: float) -> None:
        """What came of the moment that began at ``t`` (UTC s)."""
        self._flush = None
        messages, self._gathered = self._gathered, []
        now, t_us = time.monotonic(), round(t * 1e6)
        if self._sequence and now - self._sent_at > self._patience:
            self._since_us = None  # another may have taken our place meanwhile: who has been away is the younger one
        since_us = t_us if self._since_us is None else self._since_us
        parts = [
            Batch(self._priority, self._instance, since_us, t_us, (self._sequence + i) % (1 << 32), self.name, part)
            for i, part in enumerate(batches(messages))
        ]
        other = self._charge.of(now)
        if other is not None and other.rank > parts[0].rank:
            if not self.stands_by_for:
                self._say(f"stands by: {other.source} is in charge")
            self._since_us, self.stands_by_for = None, other.source
            return
        if now < self._speaks_at:
            return
        if self._since_us is None:
            self._say(f"in charge: corrections go to the fleet as {self.name}")
        self._since_us, self.stands_by_for, self._sent_at = since_us, "", now
        self._sequence += len(parts)
        with contextlib.suppress(zenoh.ZError):  # the session is closed
            for part in parts:
                self._z.put(keys.RTCM, self._key, part.pack(), publisher=self._publisher)


def key_of(z: zmav.Client) -> str:
    """The fleet's key; raises :class:`BadConfig` where no fleet is named, and :class:`Forbidden` where our role may not
    put there.
    """
    if z.fleet_name == "*" or keys.is_replay(z.fleet_name):
        text = f"corrections go to the vehicles of one fleet, not to {z.fleet_name!r}: name it with --fleet"
        raise BadConfig(text, field="fleet", value=z.fleet_name, expected="one fleet")
    key = keys.RTCM.key(z.fleet_name)
    if z.member is not None:
        z.member.check_role(key)
    return key


def may_publish(z: zmav.Client) -> bool:
    """Whether :class:`Publisher` would be allowed to."""
    try:
        key_of(z)
    except (BadConfig, Forbidden):
        return False
    return True
