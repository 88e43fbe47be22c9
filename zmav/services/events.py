"""``event``: what happened, in words; cached and recovered, so that a short outage loses none of it."""

from __future__ import annotations

import collections
import threading
import time
from typing import Any

import zenoh
import zenoh.ext

from zmav import keys, wire
from zmav.mavlink import Dialect, Frame, decode

SEVERITIES: tuple[wire.Severity, ...] = (
    "emergency",
    "alert",
    "critical",
    "error",
    "warning",
    "notice",
    "info",
    "debug",
)


class Events:
    """Publishes a vehicle's events, from any thread."""

    def __init__(self, session: zenoh.Session, fleet: str, name: str) -> None:
        ext = zenoh.ext
        self._publisher = ext.declare_advanced_publisher(
            session,
            keys.EVENT.key(fleet, name),
            encoding=keys.EVENT.encoding,
            **keys.EVENT.qos.options(),
            cache=ext.CacheConfig(max_samples=200),
            publisher_detection=True,
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
        )
        self._lock = threading.Lock()
        self._limits: dict[str, tuple[float, int]] = {}
        self._texts: collections.deque[tuple[float, str]] = collections.deque(maxlen=50)

    def close(self) -> None:
        self._publisher.undeclare()

    def emit(self, kind: str, severity: wire.Severity, text: str, *, limit: str = "", **detail: Any) -> None:
        """Publish one event. With ``limit``: one a second of that name, and the next says how many were left out."""
        if limit:
            left_out = self._admit(limit)
            if left_out is None:
                return
            if left_out:
                detail["left_out"] = left_out
        event = wire.Event(t=time.time(), kind=kind, severity=severity, text=text, detail=detail)
        self._publisher.put(wire.encode(event))

    def _admit(self, limit: str) -> int | None:
        now = time.monotonic()
        with self._lock:
            last, left_out = self._limits.get(limit, (-1.0, 0))
            if now - last < 1.0 and last >= 0.0:
                self._limits[limit] = (last, left_out + 1)
                return None
            self._limits[limit] = (now, 0)
            return left_out

    def statustext(self, frame: Frame, dialect: Dialect) -> None:
        """Pass on a STATUSTEXT, and remember it as a reason for a refusal that may follow."""
        fields = decode(frame, dialect)
        text, severity = str(fields["text"]), int(fields["severity"])
        self._texts.append((time.monotonic(), text))
        self.emit("statustext", SEVERITIES[min(severity, 7)], text, component=frame.compid)

    def texts_since(self, t: float) -> list[str]:
        """The autopilot's words since monotonic time ``t``."""
        return [text for when, text in list(self._texts) if when >= t]
