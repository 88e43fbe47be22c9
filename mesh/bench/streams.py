"""How datagrams of each class travel: as the fleet's own traffic of that class does."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext

from zmav import keys
from zmav.services.link.port import on_loop
from zmav.waiting import within

KEPT = 2000
"""datagrams of the must-arrive class that can be fetched again"""
Sample = Callable[[zenoh.Sample], None]


def open_sender(session: zenoh.Session, key: str, qos: keys.Qos, reliable: bool) -> Any:
    """A publisher; of the must-arrive class one with a cache, like the vehicles' events."""
    options: dict[str, Any] = {**qos.options(), "encoding": keys.RAW}
    options["reliability"] = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
    if qos is not keys.Qos.MUST_ARRIVE:
        return session.declare_publisher(key, **options)
    ext = zenoh.ext
    return ext.declare_advanced_publisher(
        session,
        key,
        **options,
        cache=ext.CacheConfig(max_samples=KEPT),
        publisher_detection=True,
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
    )


def open_receiver(session: zenoh.Session, key: str, qos: keys.Qos, take: Sample) -> Any:
    """A subscriber that calls ``take`` from a thread of its own."""
    if qos is not keys.Qos.MUST_ARRIVE:
        return session.declare_subscriber(key, take)
    recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    return zenoh.ext.declare_advanced_subscriber(session, key, take, recovery=recovery)


async def heard(session: zenoh.Session, key: str, timeout: float) -> bool:
    """Wait until somebody subscribes to ``key``; False when nobody did within ``timeout`` seconds."""
    known = asyncio.Event()
    found = on_loop(asyncio.get_running_loop(), known.set)

    def on_match(status: Any) -> None:
        if status.matching:
            found()

    publisher = session.declare_publisher(key)
    listener = publisher.declare_matching_listener(on_match)
    try:
        status: Any = publisher.matching_status
        if not status.matching:
            await within(timeout, known.wait())
    except asyncio.TimeoutError:
        return False
    finally:
        with contextlib.suppress(zenoh.ZError):  # the session may be gone before us
            listener.undeclare()
            publisher.undeclare()
    return True
