"""What comes on a key expression, bounded before Python is touched.

Zenoh's own callbacks press back on the link they come by where nobody keeps up with them, and orders may be behind them
there. Here a ring in Zenoh keeps the newest and lets the oldest go, whatever Python does meanwhile.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

logger = logging.getLogger(__name__)
FREE, WINDOW = 100, 0.1
"""so many in so many s are taken as they come: a controller's setpoints at 500 Hz, and a ground station's bursts"""
NAP = 0.005
"""s between two batches of what is more than that, or as long as the work of the last one took: a flood is looked at in
batches of the ring's size, and leaves the event loop its share of the interpreter
"""
TIMER_SLACK, TOGETHER_NS = 29, 10_000_000
"""PR_SET_TIMERSLACK (linux/prctl.h); waiting on a ring, Zenoh's Python looks up ten times a second, and one vehicle has
sixteen: so late they may, and the kernel has many look at once. What comes ends a wait at once all the same, but who
waits for the interpreter asks for it after 5 ms and the slack: an order must not come 0.1 s late where a thread is busy
"""
_PRCTL = ctypes.PyDLL(None).prctl if sys.platform == "linux" else None
"""keeps the interpreter's lock: it is called for each batch"""


class Intake:
    """Declares ``key`` and hands each that comes to ``take``, in a thread of its own. What ``take`` raises is logged,
    and a query dropped then: an order may be behind it.

    ``declare``: a session's ``declare_queryable`` or ``declare_subscriber``. ``most``: kept between two batches.
    """

    def __init__(self, declare: Callable[..., Any], key: str, take: Callable[[Any], object], most: int) -> None:
        self._take, self._most, self._closed = take, most, threading.Event()
        self._declared = declare(key, RingChannel(most))
        threading.Thread(target=self._run, name=f"intake {key}", daemon=True).start()

    def close(self) -> None:
        self._closed.set()
        with contextlib.suppress(zenoh.ZError):  # the session is closed, and this with it
            self._declared.undeclare()

    def _run(self) -> None:
        ring, since, count = self._declared.handler, 0.0, 0
        with contextlib.suppress(zenoh.ZError):  # undeclared
            while not self._closed.is_set():
                _set_slack(TOGETHER_NS)
                batch = [ring.recv()]
                _set_slack(0)
                while len(batch) < self._most and (more := ring.try_recv()) is not None:
                    batch.append(more)
                began = time.thread_time()
                for each in batch:
                    self._take_one(each)
                now = time.monotonic()
                since, count = (now, len(batch)) if now - since > WINDOW else (since, count + len(batch))
                del batch, each
                if count > FREE:
                    self._closed.wait(max(NAP, time.thread_time() - began))

    def _take_one(self, what: zenoh.Query | zenoh.Sample) -> None:
        try:
            self._take(what)
        except Exception:
            logger.exception("not taken")
            if isinstance(what, zenoh.Query):
                what.drop()


def _set_slack(nanoseconds: int) -> None:
    """By how much this thread's waits may be longer than asked for; 0: the system's usual."""
    if _PRCTL is not None:
        _PRCTL(TIMER_SLACK, ctypes.c_ulong(nanoseconds), 0, 0, 0)
