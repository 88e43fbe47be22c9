"""When the autopilot's boot time was, in UTC: what TIMESYNC answers say, and how sure that is.

Every answer proves something: the autopilot stamped it (``tc1``) between our question and its arrival, so that the
offset between its clock and ours lies in an interval as long as the round trip. :class:`AutopilotClock` keeps the
intersection of all those intervals, each widened by how far the clocks may have drifted apart since; the narrowest
round trips decide, and a delay that is all on one way cannot mislead, only say less. As NTP's clock filter, which
prefers samples of least delay (RFC 5905, section 10), but with bounds instead of weights. Protocol:
https://mavlink.io/en/services/timesync.html

A simulation may run at four times real time, or at a half: answers that contradict the last ones, but keep step with
each other, are believed at the pace they show, and less surely.
"""

from __future__ import annotations

import collections
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

import msgspec

MAX_DRIFT = 200e-6
"""s a second two clocks may drift apart before anything is known of them: quartzes are within 100e-6 of the truth"""
JUMP = 0.1
"""s that two offsets must contradict each other by to be a restart or a step, and not an unsteady clock"""
UNSTEADY = 0.1
"""of its pace by which a simulation may be wrong at any time"""
SIMULATED = 0.05
"""of a pace beside ours from which it is no real clock's"""
SLOWEST = 0.02
"""of real time; a simulation that is slower stands still for us"""
SETTLED = 5
"""answers after which the offset is believed"""
WRAP_MS = 1 << 32
"""``time_boot_ms`` begins again after 49.7 days"""

Verdict = Literal["good", "restarted", "behind", "stepped"]
"""of an answer that contradicts those before: its time went back; it fell behind ours over a silence; any other step"""


class Stamp(NamedTuple):
    """A moment in UTC seconds, and how far from the truth it can be."""

    utc: float
    error: float


class Offset(msgspec.Struct, frozen=True):
    """Ours minus the autopilot's clock lies between ``low`` and ``high`` at our time ``at``; all in seconds."""

    at: float
    low: float
    high: float
    slope: float = 0.0
    """s a second by which it changes"""
    wander: float = MAX_DRIFT
    """... and by how much that may be wrong"""

    def later(self, at: float) -> tuple[float, float]:
        """The bounds at another time."""
        change, spread = self.slope * (at - self.at), self.wander * abs(at - self.at)
        return self.low + change - spread, self.high + change + spread


class AutopilotClock:
    """The autopilot's clock against ours. Fed on one thread; asked on any.

    Our time is ``time.monotonic()``, so that a step of the companion's UTC disturbs nothing; ``utc_ahead()`` says how
    far UTC is ahead of it at present.
    """

    silence = 5.0
    """s without an answer, after which a time that fell behind may be that of an autopilot that has restarted"""

    def __init__(
        self,
        utc_ahead: Callable[[], float] = lambda: time.time() - time.monotonic(),
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._utc_ahead, self._now = utc_ahead, now
        self._offset: Offset | None = None
        self._boot = 0.0
        self._count = 0
        self._last: tuple[float, float] | None = None  # our time and the autopilot's, at its last answer
        self._paces: collections.deque[float] = collections.deque(maxlen=2)

    @property
    def settled(self) -> bool:
        return self._count >= SETTLED

    @property
    def boot(self) -> float:
        """The autopilot's time at its last answer, in seconds."""
        return self._boot

    @property
    def drift(self) -> float:
        """s a second by which a simulation's clock falls behind ours."""
        return self._offset.slope if self._offset else 0.0

    @property
    def simulated(self) -> bool:
        """It keeps a pace that no real clock has."""
        return self._offset is not None and self._offset.wander > MAX_DRIFT

    def forget(self) -> None:
        """Another autopilot, or none: begin again."""
        self._last = None
        self._paces.clear()
        self._start_over()

    def _start_over(self) -> None:
        self._offset, self._boot, self._count = None, 0.0, 0

    def sample(self, sent: float, received: float, boot: float) -> Verdict:
        """One answer: asked and received at these of our seconds, stamped ``boot`` seconds after the boot."""
        before, gone_back = self._offset, boot < self._boot
        # Stamped as early as it was asked, the clocks have drifted apart since.
        found = Offset(received, sent - boot - MAX_DRIFT * (received - sent), received - boot)
        self._boot = boot
        self._note_pace((sent + received) / 2, boot)
        if before is None:
            return self._begin(found, "good")
        low, high = before.later(received)
        meet = max(low, found.low), min(high, found.high)
        if meet[0] > meet[1] and not gone_back and (pace := self._pace()) is not None:
            self._count += 1
            self._offset = Offset(received, found.low, found.high, 1.0 - pace, UNSTEADY * max(pace, 1.0))
            return "good"
        if found.low - high > JUMP and (gone_back or received - before.at > self.silence):
            return self._begin(found, "restarted" if gone_back else "behind")
        if found.low - high > JUMP or low - found.high > JUMP:
            return self._begin(found, "stepped")
        if meet[0] > meet[1]:  # an unsteady clock, or one that stamps early: both may be true
            meet = min(low, found.low), max(high, found.high)
        self._count += 1
        self._offset = Offset(received, *meet, before.slope, before.wander)
        return "good"

    def _note_pace(self, ours: float, boot: float) -> None:
        """How far the autopilot's clock went in a second of ours, since its last answer."""
        last, self._last = self._last, (ours, boot)
        if last is None or ours - last[0] < JUMP:
            return
        self._paces.append((boot - last[1]) / (ours - last[0]))

    def _pace(self) -> float | None:
        """The pace that the last answers keep; None while they agree on none."""
        if len(self._paces) < 2:
            return None
        first, second = self._paces
        steady = abs(first - second) < UNSTEADY * max(first, second)
        odd = min(abs(first - 1.0), abs(second - 1.0)) > SIMULATED
        return second if steady and odd and min(first, second) > SLOWEST else None

    def _begin(self, found: Offset, verdict: Verdict) -> Verdict:
        self._start_over()
        self._offset, self._count = found, 1
        self._boot = found.at - found.high  # received - (received - boot)
        return verdict

    def at(self, boot: float, error: float = 0.0) -> Stamp | None:
        """UTC of ``boot`` seconds after the boot, known to ``error``; None before the clock has settled, and for a
        time that is still to come (it is of an earlier boot).
        """
        offset, settled = self._offset, self.settled
        if offset is None or not settled:
            return None
        # Where the boot time and the offset, as it changes, meet.
        middle, pace = (offset.low + offset.high) / 2, 1.0 - offset.slope
        ours = offset.at + (boot + middle - offset.at) / pace
        low, high = offset.later(ours)
        half = ((high - low) / 2 + error) / min(pace, 1.0)
        if ours > self._now() + half + JUMP:
            return None
        return Stamp(ours + self._utc_ahead(), half)

    def utc(self, time_boot_ms: int) -> Stamp | None:
        """UTC of a ``time_boot_ms``, which is cut to whole milliseconds; as :meth:`at`."""
        turns = round((self._boot * 1e3 - time_boot_ms) / WRAP_MS)
        return self.at((time_boot_ms + max(turns, 0) * WRAP_MS + 0.5) / 1e3, 0.5e-3)
