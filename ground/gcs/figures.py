"""What flows through a bridge, in a line for anyone who watches."""

from __future__ import annotations

import time

from ground.gcs.bridge import Bridge
from ground.gcs.client import Client


class Figures:
    """Rates since the line before."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._at, self._frames = time.monotonic(), bridge.downlink.counters.frames
        self._sent: dict[Client, tuple[int, int]] = {}

    def line(self) -> str:
        now, frames = time.monotonic(), self._bridge.downlink.counters.frames
        seconds, came = max(now - self._at, 1e-3), frames - self._frames
        self._at, self._frames = now, frames
        before, self._sent = self._sent, {}
        parts = [f"{len(self._bridge.routes.vehicles)} vehicles {came / seconds:.0f} msg/s"]
        for client in self._bridge.clients:
            sent = self._sent[client] = client.counters.sent, client.counters.sent_bytes
            was = before.get(client, (0, 0))
            parts.append(_of(client, (sent[0] - was[0]) / seconds, (sent[1] - was[1]) / seconds))
        return " | ".join(parts)


def _of(client: Client, frames: float, size: float) -> str:
    """One client: what it gets a second, what waits for it, and what it did not get or was refused so far."""
    count = client.counters
    notes = [
        f"{client.waiting} waiting" if client.waiting else "",
        f"{count.thinned + client.replaced} left out" if count.thinned + client.replaced else "",
        f"{count.dropped} dropped" if count.dropped else "",
        f"{count.refused} refused" if count.refused else "",
    ]
    return ", ".join(filter(None, [f"{client.name} {frames:.0f} msg/s {size / 1e3:.1f} kB/s", *notes]))
