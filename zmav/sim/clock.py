"""When the world's next tick is due: in real time, a multiple of it, as fast as it goes, or not at all while paused."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from zmav.errors import BadConfig

MOST_BEHIND_S = 0.25  # of wall time that is caught up with; what is more is given up
LATE_S = 0.05  # that ticks may wait for each other, where nobody notices: fewer wake-ups
MEASURED_S = 1.0  # of wall time over which the speed is told
SLOW = 0.95  # of the speed asked for: below it the world is behind
SLOWER = 0.95  # times real time: below it who listens by a real clock is told
SLOWEST, FASTEST = 1e-3, 1e6  # times real time; a slower world would hardly be seen to move


class Pacer:
    """Paces ticks of ``tick_s`` simulated seconds against ``clock`` (wall seconds). All of it is called in the world's
    thread, except what only reads.
    """

    def __init__(
        self,
        tick_s: float,
        speed: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.paused = False
        self.reached = 0.0
        """simulated seconds a second, lately"""
        self.behind = False
        """slower than asked for, lately"""
        self.given_up_s = 0.0
        """wall seconds that were lost for good because the machine was too slow, or asleep"""
        self.on_given_up: Callable[[float], None] = lambda seconds: None
        """told of some more of them"""
        self.on_slow: Callable[[], None] = lambda: None
        """called each wall second, with a tick, while time passes more slowly than real time"""
        self.tick_s = tick_s
        self._clock = clock
        self._speed = check_speed(speed)
        self._ticks_left: int | None = None
        self.restart()

    @property
    def speed(self) -> float:
        """Times real time; infinite: as fast as it goes."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """Go on at another speed; :class:`BadConfig` as :func:`check_speed`."""
        self._speed = check_speed(speed)
        self.restart()

    def restart(self) -> None:
        """Nothing is due from before now: the world begins, goes on after a pause, or changes its speed."""
        self._due = self._measured = self._clock()
        self._ticks = 0
        self.behind = False

    def pause(self) -> None:
        self.paused, self._ticks_left = True, None
        self.reached, self.behind = 0.0, False

    def resume(self) -> None:
        self.paused, self._ticks_left = False, None
        self.restart()

    def allow(self, ticks: int) -> None:
        """Go on for so many ticks, and pause then."""
        self.resume()
        self._ticks_left = ticks

    @property
    def stepping(self) -> bool:
        """Some of what :meth:`allow` allowed is still to come."""
        return self._ticks_left is not None

    def wait_s(self, late: int = 0) -> float:
        """Wall seconds until the next tick, or until ``late`` more are due; 0: now; infinite: not before somebody says
        so.
        """
        return math.inf if self.paused else max(self._due + late * self.tick_s / self._speed - self._clock(), 0.0)

    def ticked(self) -> None:
        """A tick is done."""
        now = self._clock()
        self._ticks += 1
        self._due += self.tick_s / self._speed if math.isfinite(self._speed) else 0.0
        if math.isinf(self._speed):
            self._due = now
        elif now - self._due > MOST_BEHIND_S:
            late, self._due = now - self._due, now
            self.given_up_s += late
            self.on_given_up(late)
        # Not between ticks that have waited for each other.
        if now - self._measured >= MEASURED_S and not 0.0 < now - self._due < LATE_S:
            self._measure(now)
        if self._ticks_left is not None:
            self._ticks_left -= 1
            if self._ticks_left <= 0:
                self.pause()

    def _measure(self, now: float) -> None:
        passed = now - self._measured
        self.reached = self._ticks * self.tick_s / passed
        self.behind = math.isfinite(self._speed) and self.reached < SLOW * self._speed
        self._measured, self._ticks = now, 0
        if self.reached < SLOWER:
            self.on_slow()


def check_speed(speed: float) -> float:
    """``speed`` itself; :class:`BadConfig` unless it is infinite or between :data:`SLOWEST` and :data:`FASTEST`."""
    if not (SLOWEST <= speed <= FASTEST or speed == math.inf):
        expected = f"{SLOWEST:g} to {FASTEST:g}"
        raise BadConfig.wrong("speed", speed, expected, f"speed {speed}")
    return speed
