"""A bad link for pictures alone: what a camera sends on board comes late and with holes to the ground as another."""

from __future__ import annotations

import heapq
import itertools
import random
import threading
import time

import zenoh

from zmav import keys
from zmav.session import SessionSettings, open_session

NEAR, FAR = "down", "far"


class BadVideo:
    """Between two routers' endpoints, until :meth:`close`. Chunks of pictures go one way, readers' reports the other,
    each ``delay`` s late, a share of ``loss`` of them never.
    """

    def __init__(
        self, board: str, ground: str, fleet: str, vehicle: str, delay: float, loss: float, seed: int = 0
    ) -> None:
        self._board, self._ground = (open_session(SessionSettings(connect=(each,))) for each in (board, ground))
        self._fleet, self._vehicle, self._delay, self._loss = fleet, vehicle, delay, loss
        self._rng, self._count = random.Random(seed), itertools.count()
        self._waiting: list[tuple[float, int, zenoh.Session, keys.Channel, str, bytes]] = []
        self._lock, self._stop = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, daemon=True)

        name, far = (self._fleet, self._vehicle), keys.FRAME.key(self._fleet, self._vehicle, camera=FAR)
        self._board.declare_subscriber(
            keys.FRAME.key(*name, camera=NEAR), lambda s: self._late(self._ground, keys.FRAME, far, s)
        )
        self._ground.declare_subscriber(keys.FRAME_REPORT.key(*name, camera=FAR, reader="*"), self._on_report)
        self._ground.declare_queryable(keys.CAMERA.key(*name, camera=FAR), self._on_asked)
        self._thread.start()

    def close(self) -> None:
        with self._lock:
            self._stop = True
            self._lock.notify()
        self._thread.join()
        self._board.close()
        self._ground.close()

    def _on_report(self, sample: zenoh.Sample) -> None:
        _, parts = keys.match(str(sample.key_expr))
        key = keys.FRAME_REPORT.key(self._fleet, self._vehicle, camera=NEAR, reader=parts["reader"])
        self._late(self._board, keys.FRAME_REPORT, key, sample)

    def _on_asked(self, query: zenoh.Query) -> None:
        for reply in self._board.get(keys.CAMERA.key(self._fleet, self._vehicle, camera=NEAR)):
            if reply.ok is not None:
                query.reply(query.key_expr, reply.ok.payload)

    def _late(self, to: zenoh.Session, channel: keys.Channel, key: str, sample: zenoh.Sample) -> None:
        if self._rng.random() < self._loss:
            return
        with self._lock:
            due = time.monotonic() + self._delay
            heapq.heappush(self._waiting, (due, next(self._count), to, channel, key, sample.payload.to_bytes()))
            self._lock.notify()

    def _run(self) -> None:
        while True:
            with self._lock:
                while not self._stop and not (self._waiting and self._waiting[0][0] <= time.monotonic()):
                    self._lock.wait(self._waiting[0][0] - time.monotonic() if self._waiting else None)
                if self._stop:
                    return
                _, _, to, channel, key, payload = heapq.heappop(self._waiting)
            to.put(key, payload, **channel.qos.options())
