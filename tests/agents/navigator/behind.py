"""How far a busy computer lets simulated time fall behind the real clock, by which a route is flown."""

from __future__ import annotations

import asyncio
import collections
import time

from tests.waiting import Watcher
from zmav.sim import World

CAUGHT_UP_S = 3.0
"""after which a vehicle has caught up with a course that went on without it"""


class Behind(Watcher):
    """``async with Behind(world) as behind``. A vehicle is where it should be but for ``most`` seconds of its way."""

    def __init__(self, world: World) -> None:
        self._pacer = world.pacer
        self._begun = self._pacer.given_up_s
        self.most = 0.0
        """s of simulated time that were given up within :data:`CAUGHT_UP_S`, at most"""

    @property
    def whole(self) -> float:
        """s of simulated time that were given up since it was entered."""
        return self._pacer.given_up_s - self._begun

    async def _look(self) -> None:
        rows = collections.deque[tuple[float, float]]()
        while True:
            rows.append((time.monotonic(), self._pacer.given_up_s))
            while rows[0][0] < rows[-1][0] - CAUGHT_UP_S:
                rows.popleft()
            self.most = max(self.most, rows[-1][1] - rows[0][1])
            await asyncio.sleep(0.1)
