"""A recording that is played as somebody at a timeline wants it: paused, faster, from elsewhere, again."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Sequence
from typing import NamedTuple

from ground.record.replay import LONGEST_STEP_S, Deliver, Player, stage
from ground.record.sources import Source
from zmav.client import Client
from zmav.onboard import OnboardSettings
from zmav.waiting import in_thread

LEAD_S = 2.0
"""before the place that was asked for, played at once: the states of that time are known, also while it is paused"""


class Playing(NamedTuple):
    """``begin``, ``end``, ``at``: UTC seconds of the recording."""

    begin: float
    end: float
    at: float
    speed: float
    paused: bool


class SteeredPlayer(Player):
    """Plays until it is closed; at its end it is paused. :meth:`steer` and :attr:`playing` are for any thread."""

    def __init__(self, parts: Sequence[tuple[Source, Deliver]]) -> None:
        super().__init__(parts)
        self._turn = threading.Condition()
        self._rate, self._paused = 1.0, False
        self._to: float | None = 0.0
        self._begin = self._end = self._at = 0
        self._ahead = 0.0
        """s of the recording that are played already beyond the last record"""

    @property
    def playing(self) -> Playing:
        with self._turn:
            times = (self._begin / 1e9, self._end / 1e9, self._at / 1e9)
            return Playing(*times, self._rate, self._paused)

    def steer(self, paused: bool | None = None, speed: float | None = None, to: float | None = None) -> None:
        """``to``: s after the beginning. From the end it goes on at the beginning."""
        with self._turn:
            if speed is not None:
                self._rate = speed
            if to is not None:
                self._to = min(max(0.0, to), (self._end - self._begin) / 1e9)
            elif paused is False and self._paused and self._at >= self._end:
                self._to = 0.0
            if paused is not None:
                self._paused = paused
            self._turn.notify_all()

    def stop(self) -> None:
        super().stop()
        with self._turn:
            self._turn.notify_all()

    def close(self) -> None:
        self.stop()
        super().close()

    def _play(self) -> bool:
        begins = [first for source, _ in self._parts if (first := source.first()) is not None]
        ends = [last for source, _ in self._parts if (last := source.last()) is not None]
        if not begins:
            return False
        self._begin, self._end = min(begins), max(ends)
        while not self._stop.is_set():
            with self._turn:
                while self._to is None and not self._stop.is_set():
                    self._turn.wait(0.5)
                to, self._to = self._to, None
            if to is not None:
                self._from(self._begin + int(to * 1e9))
        return False

    def _from(self, at: int) -> None:
        """From there to the end, or until somebody wants it elsewhere."""
        last, self._ahead = at, 0.0
        for record, deliver in self._merged(max(self._begin, at - int(LEAD_S * 1e9))):
            step = (record.at - last) / 1e9
            if 0.0 < step <= LONGEST_STEP_S and not self._let_pass(step):
                return
            if self._stop.is_set() or self._to is not None:
                return
            last = max(last, record.at)
            with self._turn:
                self._at = last
            deliver(record)
            self.played += 1
        with self._turn:
            self._at = self._end
            self._paused = True

    def _let_pass(self, step: float) -> bool:
        """Wait for so many seconds of the recording; False: it is to end, or to go on elsewhere."""
        left = step - self._ahead
        with self._turn:
            while not self._stop.is_set() and self._to is None:
                if left <= 0.0 and not self._paused:
                    self._ahead = -left
                    return True
                before, rate, paused = self._now(), self._rate, self._paused
                self._turn.wait(0.5 if paused else min(0.5, left / rate))
                if not paused:
                    left -= (self._now() - before) * rate
        return False


@contextlib.asynccontextmanager
async def steered(z: Client, sources: Sequence[Source], base: OnboardSettings) -> AsyncIterator[SteeredPlayer]:
    """Plays the sources in the fleet of ``z``. Raises what :func:`ground.record.replay.stage` does."""
    async with stage(z, sources, None, base) as on:
        player = SteeredPlayer(on.parts)
        player.start()
        try:
            yield player
        finally:
            for link in on.links:
                link.close()
            await in_thread(player.close)
            await asyncio.sleep(0)
