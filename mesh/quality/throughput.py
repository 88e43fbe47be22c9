"""How fast a link is, from how far it spreads a train of messages that were sent at once (packet dispersion).

Sources: Keshav, *A control-theoretic approach to flow control* (1991) for two packets; Dovrolis, Ramanathan and Moore,
*Packet-dispersion techniques and a capacity-estimation methodology* (2004) for trains and what distorts them. A queue
that lets a burst through untouched shows the speed behind it, other traffic lowers the figure, and so does loss, which
slows the congestion control of ``quic/`` and ``udp/?rel=1``: it is what a short burst of bulk gets here and now.
"""

from __future__ import annotations

from collections import deque

from mesh.quality.stamp import TRAIN_SIZE, Car

OVERHEAD = 85
"""bytes on the wire beyond a train's message: Zenoh's frame and key 55, UDP and IP 28, measured"""
RESOLUTION = 1e-3
"""s below which a spread is not told from the computer's own: of a faster link only that is said"""
OVER = 2.0
"""s without a message after which a train is over"""
TRAINS = 3
"""the best of so many: what disturbs a train nearly always slows it"""


class Dispersion:
    """What comes of one neighbour's trains."""

    def __init__(self) -> None:
        self._train: int | None = None
        self._first = self._last = 0.0
        self._came = 0
        self._rates: deque[float] = deque(maxlen=TRAINS)

    def came(self, car: Car, now: float) -> None:
        """A message of a train came at ``now`` (monotonic s); the train counts when the next one begins, or it ends."""
        if car.train != self._train:
            self._close()
            self._train, self._first, self._last, self._came = car.train, now, now, 1
            return
        self._last, self._came = now, self._came + 1
        if car.index == car.count - 1:
            self._close()

    def _close(self) -> None:
        """The first message only starts the watch: its own time on the link was before."""
        if self._came >= 2:
            span = max(self._last - self._first, RESOLUTION)
            self._rates.append((self._came - 1) * (TRAIN_SIZE + OVERHEAD) / span)
        self._came = 0

    def settle(self, now: float) -> None:
        """A train whose end was lost is over when nothing more comes of it."""
        if self._came and now - self._last > OVER:
            self._close()

    @property
    def rate(self) -> float | None:
        """bytes/s on the wire, IP headers included."""
        return max(self._rates, default=None)
