"""One ground control station: what it says, and its way out, paced and bounded, which nobody else waits for."""

from __future__ import annotations

import collections
import threading
import time
from typing import NamedTuple, Protocol

import msgspec

from ground.gcs.kinds import Kind, Numbering, Place, renumbered, sequence_of
from ground.gcs.options import Options
from mesh.bearer.shaper import Bucket
from zmav.mavlink import Dialect, Frame, Splitter
from zmav.mavlink.frame import MAGIC_V2

MOST_IDS = 16
"""systems and components one client may speak as: a GCS has one or two, a repeater of them a few more"""
AT_ONCE = 64
"""frames written before others may"""
FULL = -1.0
MOST_URGENT = 512
"""frames that must arrive and wait; their sender is told when there is no room"""
MOST_LISTED = 16
"""such frames beyond which a list of parameters waits"""
MOST_FRESH = 4096
"""messages of which the newest waits"""


class Sink(Protocol):
    """Where a client's bytes go."""

    stream: bool
    """it may take a part of a frame, and the rest later"""

    def write(self, data: bytes) -> int:
        """Bytes taken, at once; 0: none now. Raises OSError once nothing will be taken any more."""

    def wait(self, seconds: float) -> None:
        """Until it takes more, for so long at most."""

    def close(self) -> None: ...


class Counters(msgspec.Struct):
    """Frames to and from one client."""

    dropped: int = 0
    """not sent for want of room on its way"""
    refused: int = 0
    """said by it, and given to no vehicle"""


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
        return self._urgent[0] if self._urgent else next(iter((self._beats or self._fresh).values()), None)

    def pop(self) -> None:
        """Take out what :meth:`first` gave."""
        if self._urgent:
            self._urgent.popleft()
        else:
            waiting = self._beats or self._fresh
            del waiting[next(iter(waiting))]


class Client:
    """Thread-safe, all of it."""

    silence = 30.0
    """s after which a client that cannot hang up is taken to be gone"""

    def __init__(
        self, name: str, sink: Sink, options: Options, dialect: Dialect, *, connected: bool = False, stays: bool = False
    ) -> None:
        self.name, self.options, self._sink = name, options, sink
        self.splitter = Splitter(dialect)
        self.counters = Counters()
        self.kind_of_station = ""
        """MAV_TYPE of its HEARTBEAT, without the prefix"""
        self.heard = 0.0
        """monotonic s; 0: never"""
        self.addressed: dict[Place, float] = {}
        """when it last spoke to a vehicle"""
        self.told: set[str] = set()
        """what it was told, and is not told again"""
        self.gone = False
        self.stays = stays
        """it is sent to whether it is there or not"""
        self._connected = connected
        self.ids: frozenset[tuple[int, int]] = frozenset()
        self.systems: frozenset[int] = frozenset()
        self._ready = threading.Condition()
        self._bucket = Bucket(options.rate, time.monotonic()) if options.rate else None
        self._last: dict[int, int] = {}
        """by component: the number of its last frame, as long as all of its frames passed untouched"""
        self._numbers: dict[int, Numbering] = {}
        """by component: from the first frame on that was left out or added"""
        self._outbox = Outbox()
        self._rest = b""
        if sink.stream or self._bucket is not None:
            threading.Thread(target=self._write_on, name=f"gcs {name}", daemon=True).start()

    def __repr__(self) -> str:
        return f"<Client {self.name} {sorted(self.ids)}>"

    @property
    def read_only(self) -> bool:
        return self.options.read_only

    @property
    def present(self) -> bool:
        """Somebody is there: connected, or heard not long ago."""
        recently = self.heard > 0.0 and time.monotonic() - self.heard < self.silence
        return not self.gone and (self._connected or recently)

    @property
    def waiting(self) -> int:
        """Frames that wait to be sent."""
        return len(self._outbox)

    @property
    def replaced(self) -> int:
        """Frames that a newer one took the place of while they waited."""
        return self._outbox.replaced

    def add_id(self, place: tuple[int, int]) -> bool:
        """False: it speaks as too many already."""
        if len(self.ids) >= MOST_IDS:
            return False
        self.ids |= {place}
        self.systems = frozenset(system for system, _ in self.ids)
        return True

    def forget(self) -> None:
        """Anyone who was there is not any more; who comes next may be somebody else."""
        self.ids, self.systems, self.kind_of_station = frozenset(), frozenset(), ""
        self.told = set()

    def feed(self, data: bytes) -> list[Frame]:
        """The frames in what came from it. On its endpoint's thread."""
        frames = self.splitter.feed(data)
        if frames:
            self.heard = time.monotonic()
        return frames

    def close(self) -> None:
        with self._ready:
            self.gone = True
            self._ready.notify_all()
        self._sink.close()

    # Out.

    def deliver(self, kind: Kind, data: bytes) -> None:
        """A vehicle's frame, which it gets, now or later."""
        source, seq = kind.source, sequence_of(data)
        with self._ready:
            if self._is_free(len(data)):
                numbers = self._numbers.get(source)
                if numbers is None:
                    self._last[source] = seq
                else:
                    numbers.came(seq)
                self._emit(source, data)
            else:
                self._came(source, seq)
                item = Item(source, data)
                if not kind.must:
                    self._outbox.put_fresh(kind.about(data), item, kind.beat)
                elif not self._outbox.put_urgent(item):
                    self.counters.dropped += 1
                self._ready.notify()

    def leave_out(self, kind: Kind, data: bytes) -> None:
        """A vehicle's frame, which it does not get."""
        with self._ready:
            self._came(kind.source, sequence_of(data))

    def send(self, data: bytes) -> bool:
        """Give it a frame in a vehicle's name; its sequence number is set here. What is given so must arrive: it goes
        before telemetry. False: too much waits already, try later.
        """
        source = data[5] << 8 | data[6] if data[0] == MAGIC_V2 else data[3] << 8 | data[4]
        with self._ready:
            if self.gone:
                return False
            self._numbering(source, -1)
            if self._is_free(len(data)):
                return self._emit(source, data)
            self._ready.notify()
            return self._outbox.has_room and self._outbox.put_urgent(Item(source, data))

    def _came(self, source: int, seq: int) -> None:
        """A frame that does not go out at once: from now on this component's frames are numbered again."""
        self._numbering(source, (seq - 1) & 0xFF).came(seq)

    def _numbering(self, source: int, before: int) -> Numbering:
        """Of a component, from now on if not before; ``before``: its last number, where no frame of it came yet."""
        if source not in self._numbers:
            before = self._last.get(source, before)
            self._numbers[source] = Numbering(before, before)
        return self._numbers[source]

    def _is_free(self, size: int) -> bool:
        """Nothing waits, and there is room for so many bytes, which are taken to be sent."""
        if self._rest or self._outbox:
            return False
        return self._bucket is None or self._bucket.take(size, time.monotonic())

    def _emit(self, source: int, data: bytes) -> bool:
        numbers = self._numbers.get(source)
        if numbers is not None:
            data = renumbered(data, numbers.next())
        counters = self.counters
        try:
            taken = self._sink.write(data)
        except OSError:
            counters.dropped += 1
            return False
        if taken < len(data):
            if not self._sink.stream:
                counters.dropped += 1
                return False
            self._rest = data[taken:]
            self._ready.notify()
        return True

    # The thread of a client that may have to wait.

    def _write_on(self) -> None:
        while True:
            with self._ready:
                while not (self._rest or self._outbox or self.gone):
                    self._ready.wait()
                if self.gone:
                    return
                pause = self._flush()
            if pause == FULL:
                self._sink.wait(0.25)
            elif pause > 0.0:
                time.sleep(min(pause, 0.25))

    def _flush(self) -> float:
        """Write what there is room for; then seconds to wait, or :data:`FULL`."""
        for _ in range(AT_ONCE):
            if self._rest:
                try:
                    self._rest = self._rest[self._sink.write(self._rest) :]
                except OSError:
                    self._rest = b""  # its endpoint will find that it is gone
                    return 0.25
                if self._rest:
                    return FULL
            item = self._outbox.first()
            if item is None:
                return 0.0
            if self._bucket is not None and not self._bucket.take(len(item.data), now := time.monotonic()):
                return max(self._bucket.wait(len(item.data), now), 0.001)
            self._outbox.pop()
            self._emit(item.source, item.data)
        return 0.0
