"""``event``: what happened, in words; cached and recovered, so that a short outage loses none of it."""

from __future__ import annotations

import collections
import contextlib
import time
from typing import Any, get_args

import zenoh
import zenoh.ext

from zmav import keys, wire
from zmav.mavlink import Frame
from zmav.mavlink.statustext import Text, TextJoiner
from zmav.ratelimit import RateLimit
from zmav.trust.proof import Signer

SEVERITIES: tuple[wire.Severity, ...] = get_args(wire.Severity)
"""by MAV_SEVERITY"""
LIMITS = 256
"""names of limits that are told apart within a second"""


class Events:
    """Publishes a vehicle's events, from any thread; what reads frames lives on the event loop."""

    def __init__(self, session: zenoh.Session, fleet: str, name: str, signer: Signer | None = None) -> None:
        ext, self._signer, self._key = zenoh.ext, signer, keys.EVENT.key(fleet, name)
        self._publisher = ext.declare_advanced_publisher(
            session,
            self._key,
            encoding=keys.EVENT.encoding,
            **keys.EVENT.qos.options(),
            cache=ext.CacheConfig(max_samples=200),
            publisher_detection=True,
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
        )
        self._limits: RateLimit[str] = RateLimit(1.0, LIMITS)
        self._texts: collections.deque[tuple[float, str]] = collections.deque(maxlen=50)
        self._joiner = TextJoiner()

    def close(self) -> None:
        self._publisher.undeclare()

    def emit(self, kind: str, severity: wire.Severity, text: str, *, limit: str = "", **detail: Any) -> None:
        """Publish one event. With ``limit``: one a second of that name, and the next says how many were left out."""
        if limit:
            left_out = self._limits.take(limit)
            if left_out is None:
                return
            if left_out:
                detail["left_out"] = left_out
        event = wire.Event(t=time.time(), kind=kind, severity=severity, text=text, detail=detail)
        with contextlib.suppress(zenoh.ZError):  # a closed session hears nothing: no reason to stop watching over it
            data = wire.encode(event)
            self._publisher.put(data, attachment=self._signer.sign(self._key, data) if self._signer else None)

    def statustext(self, frame: Frame) -> None:
        """Pass on a STATUSTEXT once it is whole, and remember it as a reason for a refusal that may follow."""
        for text in self._joiner.add(frame, time.monotonic()):
            self._say(text)

    def tick(self) -> None:
        """A few times a second: say what there is of texts whose pieces do not come."""
        for text in self._joiner.flush(time.monotonic()):
            self._say(text)

    def _say(self, text: Text) -> None:
        self._texts.append((text.at, text.text))
        more: dict[str, Any] = {} if text.complete else {"incomplete": True}
        self.emit("statustext", SEVERITIES[min(text.severity, 7)], text.text, component=text.compid, **more)

    def remember(self, text: str) -> None:
        """It may be why an order is refused."""
        self._texts.append((time.monotonic(), text))

    def texts_since(self, t: float) -> list[str]:
        """The autopilot's words since monotonic time ``t``, the beginnings of texts that are not whole yet included."""
        said = [text for when, text in list(self._texts) if when >= t]
        return said + [text.text for text in self._joiner.unfinished() if text.at >= t]
