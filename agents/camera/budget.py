"""What the readers' links take, learned from their reports: the tightest one sets how fast pictures are sent.

Additive increase, multiplicative decrease (Chiu and Jain 1989) on three signs that a link is full: pictures are torn,
more chunks are lost than this link loses anyway, the delay grows. A radio loses chunks that are no sign of anything:
loss which a decrease does not change is the link's own, and is met by parity instead.
"""

from __future__ import annotations

import collections
import math

from agents.camera.settings import Settings
from zmav import keys
from zmav.wire import FrameReport

UNKNOWN_LOSS = 0.1
"""share of chunks that parity is made for while no reader reports"""
LEAST_LOSS, MOST_LOSS = 0.01, 0.45
"""bounds of what parity is made for"""
WINDOW = 5
"""reports between whose first and last chunks are counted: 2 s"""
USUAL, DELAYS = 20, 60
"""reports whose least loss is the link's own, and whose least delay is that of an empty link: 10 and 30 s"""
MORE_LOSS, MORE_DELAY = 0.12, 0.15
"""beyond those, a link is full (share; s)"""
TORN = 0.15
"""share of pictures"""
CUT, DEEPEST_CUT = 0.75, 0.5
HOLD = 1.5
"""s between two decreases: until what the last one did is seen"""
UNCHANGED = 0.75
"""of the loss before a decrease that must be left for it to be the link's own"""
OWN_LOSS = 0.5
"""share above which loss is never taken for the link's own"""
USED = 0.6
"""of the budget that must be sent for good reports to say that there is more"""
MOST_READERS = 64


class Sent:
    """Pictures that were sent lately: bytes up to each, how long we had it ourselves."""

    def __init__(self) -> None:
        self._pictures: collections.OrderedDict[int, tuple[int, float]] = collections.OrderedDict()
        self._times: collections.deque[tuple[float, int]] = collections.deque(maxlen=2000)
        self.total = 0

    def add(self, seq: int, length: int, own: float, now: float) -> None:
        """``length`` bytes in all chunks; ``own``: s from the shutter until the last one went."""
        self.total += length
        self._pictures[seq] = self.total, own
        self._times.append((now, length))
        while len(self._pictures) > 1000:
            self._pictures.popitem(last=False)

    def between(self, first: int, last: int) -> int | None:
        """Bytes of the pictures after ``first`` up to ``last``; None where one is not known."""
        if first not in self._pictures or last not in self._pictures:
            return None
        return self._pictures[last][0] - self._pictures[first][0]

    def own(self, seq: int) -> float:
        return self._pictures[seq][1] if seq in self._pictures else 0.0

    def rate(self, now: float, window: float = 2.0) -> float:
        """B/s lately."""
        return sum(length for at, length in self._times if at > now - window) / window


class Link:
    """What one reader's reports say of the way to it."""

    def __init__(self, settings: Settings, now: float) -> None:
        self.budget = settings.budget
        """B/s"""
        self.loss = UNKNOWN_LOSS
        """share of chunks that parity is to make up for: rises at once, falls slowly"""
        self.heard = now
        self.most: float | None = None
        self._settings = settings
        self._last: FrameReport | None = None
        self._window: collections.deque[tuple[int, float, int, int]] = collections.deque(maxlen=WINDOW)
        self._losses: collections.deque[float] = collections.deque(maxlen=USUAL)
        self._delays: collections.deque[float] = collections.deque(maxlen=DELAYS)
        self._cut_at = -math.inf
        self._cut_loss: float | None = None
        self._step = 0.1 * settings.budget

    def take(self, report: FrameReport, sent: Sent, now: float) -> None:
        """Judge one report; old ones, and those that say nothing, change nothing."""
        self.heard = now
        self.most = None if report.most_bytes is None else max(report.most_bytes, 500.0)
        last, self._last = self._last, report
        if last is None or not 0.0 < report.t - last.t < 60.0:
            self._window.clear()
            self._window.append((report.seq, 0.0, 0, 0))
            return
        came = max(report.rate_bytes, 0.0) * (report.t - last.t)
        self._window.append((report.seq, came, max(report.whole, 0), max(report.torn, 0)))
        loss = self._lost(report, sent, now)
        if loss is not None:
            self.loss = min(max(loss, LEAST_LOSS, self.loss + 0.15 * (loss - self.loss)), MOST_LOSS)
        if self._full(report, loss, sent):
            self._decrease(loss, now)
        elif report.whole > 0 and report.torn <= 0 and sent.rate(now) >= USED * self.budget:
            self.budget = min(self.budget + self._step, self._settings.most)

    def _lost(self, report: FrameReport, sent: Sent, now: float) -> float | None:
        """Share of what was sent that did not come; None: not known."""
        first, *rest = self._window
        between = sent.between(first[0], report.seq)
        if between:
            return min(max(1.0 - sum(came for _, came, _, _ in rest) / between, 0.0), 1.0)
        rate = sent.rate(now)
        if report.whole == 0 and report.torn > 0 and rate > 0.0:  # nothing whole to count from
            return min(max(1.0 - max(report.rate_bytes, 0.0) / rate, self.loss), 1.0)
        return None

    def _full(self, report: FrameReport, loss: float | None, sent: Sent) -> bool:
        whole, torn = (sum(each[i] for each in self._window) for i in (2, 3))
        full = report.torn > 0 and torn > TORN * (whole + torn)
        if loss is not None:
            if self._cut_loss is not None and UNCHANGED * self._cut_loss < loss < OWN_LOSS:
                self._losses.clear()  # less was sent, and as much was lost
            self._cut_loss = None
            self._losses.append(loss)
            full |= loss > min(min(self._losses) + MORE_LOSS, OWN_LOSS)
        if report.delay is not None and math.isfinite(report.delay):
            delay = report.delay - sent.own(report.seq)
            self._delays.append(delay)
            full |= delay > min(self._delays) + MORE_DELAY
        return full

    def _decrease(self, loss: float | None, now: float) -> None:
        if now - self._cut_at < HOLD:
            return
        factor = CUT if loss is None else min(max(1.0 - loss, DEEPEST_CUT), CUT)
        self.budget = max(self.budget * factor, self._settings.least)
        self._step = 0.05 * self.budget
        self._cut_at, self._cut_loss = now, loss
        seq = self._window[-1][0]
        self._window.clear()  # what is counted next was sent after this
        self._window.append((seq, 0.0, 0, 0))


class Budget:
    """Of one camera: the tightest of its readers' links."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.sent = Sent()
        self.links: dict[str, Link] = {}

    def report(self, reader: str, report: FrameReport, now: float) -> None:
        """Take a reader's word; beyond :data:`MOST_READERS` nobody new is heard."""
        if reader not in self.links:
            if len(self.links) >= MOST_READERS:
                return
            self.links[reader] = Link(self._settings, now)
        self.links[reader].take(report, self.sent, now)

    def expire(self, now: float) -> None:
        """Forget readers that are silent."""
        patience = keys.FRAME_REPORT.stale_after or 3.0
        for name in [name for name, link in self.links.items() if now - link.heard > patience]:
            del self.links[name]

    @property
    def bytes(self) -> float:
        """B/s that may be sent now."""
        links = self.links.values()
        found = min((link.budget for link in links), default=self._settings.budget)
        return min(found, *(link.most for link in links if link.most is not None), self._settings.most)

    @property
    def loss(self) -> float:
        """Share of chunks that parity is to make up for."""
        return max((link.loss for link in self.links.values()), default=UNKNOWN_LOSS)
