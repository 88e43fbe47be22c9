"""``link/{name}``: what the local link carries and loses, once a second, with the round trip by TIMESYNC."""

from __future__ import annotations

import time

from zmav import keys, wire
from zmav.mavlink.signing import SigningCounters
from zmav.services.companion import Companion
from zmav.services.link.timesync import TimeSync
from zmav.services.queries.questions import Reply
from zmav.session import is_read

LINK_NAME = "autopilot"


class Quality:
    """Counts and times the vehicle's link. Lives on the event loop."""

    def __init__(self, companion: Companion, timesync: TimeSync) -> None:
        self._port, self._identity, self._timesync = companion.port, companion.identity, timesync
        key = keys.LINK.key(companion.port.fleet, companion.port.name, link=LINK_NAME)
        self._publisher = companion.session.declare_publisher(key, **keys.LINK.publishing())
        self._before = (0, 0, 0, 0, time.monotonic())
        self.last = self.measure()
        companion.questions.declare(key, lambda query: iter([Reply(key, wire.encode(self.last), keys.LINK.encoding)]))

    def close(self) -> None:
        self._publisher.undeclare()

    def tick(self) -> None:
        """Once a second: publish."""
        self.last = self.measure()
        if is_read(self._publisher):
            self._publisher.put(wire.encode(self.last))

    def _of_vehicle(self) -> tuple[int, int]:
        """Frames heard and lost of the vehicle itself: an autopilot passes on only a part of what others send."""
        source = self._identity.source
        counters = self._port.splitter.sources.get(source) if source else None
        return (counters.frames, counters.lost) if counters else (0, 0)

    def measure(self) -> wire.LinkQuality:
        """The quality since the last call."""
        now, split, link = time.monotonic(), self._port.splitter.counters, self._port.link
        own, lost = self._of_vehicle()
        frames, own_before, lost_before, size, then = self._before
        self._before = (split.frames, own, lost, split.bytes, now)
        span, came, missed = max(now - then, 1e-3), max(own - own_before, 0), max(lost - lost_before, 0)
        heard, tx = self._port.heard, self._port.tx
        signing = self._port.signing.counters if self._port.signing else SigningCounters()
        return wire.LinkQuality(
            t=time.time(),
            name=LINK_NAME,
            url=link.url,
            state=link.state.value,
            age=now - heard if heard else None,
            rx_rate=(split.frames - frames) / span,
            rx_bytes_rate=(split.bytes - size) / span,
            loss=missed / (came + missed) if came + missed else 0.0,
            rtt=self._timesync.take_rtt(),
            rx_frames=split.frames,
            rx_bytes=split.bytes,
            lost=lost,
            bad_crc=split.bad_crc,
            bad_length=split.bad_length,
            bad_flags=split.bad_flags,
            garbage=split.garbage,
            unknown=split.unknown,
            tx_frames=tx.frames,
            tx_dropped=tx.dropped,
            tx_refused=tx.refused,
            bad_signature=signing.bad_signature + signing.old_timestamp,
            unsigned=signing.unsigned,
            rx_dropped=link.counters.rx_dropped,
            opens=link.counters.opens,
            last_error=link.counters.last_error,
        )
