"""What the readers' links take, learned from their reports: the tightest one sets how fast pictures are sent.

Additive increase, multiplicative decrease (Chiu and Jain 1989) on three signs that a link is full: pictures are torn,
more chunks are lost than this link loses anyway, the delay grows. A radio loses chunks that are no sign of anything:
loss which a decrease does not change is the link's own, and is met by parity instead.
"""

from __future__ import annotations

import collections
import math
import statistics
from typing import NamedTuple

from agents.camera.settings import CameraSettings
from zmav import keys
from zmav.wire import FrameReport

UNKNOWN_LOSS = 0.1
"""share of chunks that parity is made for while no reader reports"""
LEAST_LOSS, MOST_LOSS = 0.01, 0.45
"""bounds of what parity is made for"""
FALLS, FEW_FALL = 0.15, 0.07
"""by how much that falls with a report: of the way to what was measured, and of itself where nothing could be"""
WINDOW, RECENT = 60, 4
"""reports that are kept (30 s), and at least so many for a measurement (2 s)"""
PICTURES = 8
"""that must have been sent for a measurement: what of the last one is still on its way is to be a small part"""
SOON, ENOUGH, MANY = 15e3, 60e3, 150e3
"""bytes that must have been sent for a first guess, for a measurement, for a good one"""
DELAYS = 60
"""reports whose least delay is an empty link's: 30 s"""
SOME_LOSS, MORE_LOSS, LONG = 0.06, 0.12, 6
"""share beyond the link's own: by good measurement above the first nothing is added, and after so many reports the link
is taken to be full; above the second it is at once"""
FOLLOWS = 0.2
"""weight of a new measurement near it in the link's own loss"""
MORE_DELAY, MOST_DELAY = 0.15, 1.0
"""s beyond an empty link's at which it is full: what we take to send a picture, within these bounds"""
FALLING = 0.05
"""s by which the delay must have fallen since the last report for the link to be emptying: it is let to"""
TORN, FEW = 0.15, 2
"""share of the recent pictures, and how many at least"""
CUT, DEEPEST_CUT = 0.75, 0.5
STEP, FAST = 0.04, 0.08
"""added each half second while all is well: of the budget after the last decrease; before one, of the budget itself"""
HOLD = 1.5
"""s between two decreases: until what the last one did is seen"""
OWN_LOSS = 0.45
"""share above which loss is never taken for the link's own"""
USED = 0.6
"""of the budget that must be sent for good reports to say that there is more"""
PERIOD, MOST_PERIODS = 0.5, 4.0
"""s in which the budget grows by one step, and how many periods without a picture are made up for"""
MOST_READERS = 64


class Sent:
    """Pictures that were sent lately: bytes up to each, how long we had it ourselves. ``reported``: so many come
    between two reports, of whose delays a reader tells the median.
    """

    def __init__(self, reported: int = 1) -> None:
        self._reported = reported
        self._pictures: collections.OrderedDict[int, tuple[int, float]] = collections.OrderedDict()
        self._times: collections.deque[tuple[float, int]] = collections.deque(maxlen=2000)
        self.total = 0

    def add(self, seq: int, length: int, own: float, now: float) -> None:
        """One that is begun: ``length`` bytes in all chunks; ``own``: s from the shutter until enough of it is gone."""
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

    def took(self, seq: int, own: float) -> None:
        """It has gone out: how long we had it is known by now."""
        if seq in self._pictures:
            self._pictures[seq] = self._pictures[seq][0], own

    def own(self, seq: int) -> float:
        """s that we had those ourselves which were reported with it."""
        found = [self._pictures[each][1] for each in range(seq - self._reported + 1, seq + 1) if each in self._pictures]
        return statistics.median(found) if found else 0.0

    def rate(self, now: float, window: float = 2.0) -> float:
        """B/s lately."""
        return sum(length for at, length in self._times if at > now - window) / window


class _Heard(NamedTuple):
    """A report's numbers since the one before."""

    seq: int
    came: float
    """bytes"""
    whole: int
    torn: int


class ReaderLink:
    """What one reader's reports say of the way to it."""

    def __init__(self, settings: CameraSettings, now: float) -> None:
        self.budget = settings.budget
        """B/s"""
        self.loss = UNKNOWN_LOSS
        """share of chunks that parity is to make up for: rises at once, falls slowly"""
        self.heard = now
        self.most: float | None = None
        self._settings = settings
        self._last: FrameReport | None = None
        self._window: collections.deque[_Heard] = collections.deque(maxlen=WINDOW)
        self._own_loss = 0.0
        self._above = 0  # reports in turn with more than that
        self._delays: collections.deque[float] = collections.deque(maxlen=DELAYS)
        self._cut_at = -math.inf
        self._limited = False  # a decrease has once done good
        self._good_at = now
        self._cut_loss: float | None = None
        """what must be lost after the last decrease for it to be the link's own; None: it is judged already"""
        self._step: float | None = None
        """B/s added each half second; None: there was no sign of a full link yet, and it grows by a share of itself"""

    @property
    def limited(self) -> bool:
        """There was a sign of a full link, or the reader knows what it has."""
        return self._step is not None or self._limited or self.most is not None

    def take(self, report: FrameReport, sent: Sent, now: float) -> None:
        """Judge one report; old ones, and those that say nothing, change nothing."""
        self.heard = now
        self.most = None if report.most_bytes is None else max(report.most_bytes, 500.0)
        last, self._last = self._last, report
        if last is None or not 0.0 < report.t - last.t < 60.0:
            self._window.clear()
            self._window.append(_Heard(report.seq, 0.0, 0, 0))
            return
        came = max(report.rate_bytes, 0.0) * (report.t - last.t)
        self._window.append(_Heard(report.seq, came, max(report.whole, 0), max(report.torn, 0)))
        loss = self._loss(report, sent, now)
        if loss is not None:
            self.loss = min(max(loss, LEAST_LOSS, self.loss + FALLS * (loss - self.loss)), MOST_LOSS)
        elif report.whole > 0 and report.torn <= 0:  # few pictures, but good ones
            self.loss = max((1.0 - FEW_FALL) * self.loss, LEAST_LOSS)
        if self._lossy(sent) or self._torn(report) or self._late(report, sent):
            self._decrease(loss, now)
        elif self._cut_loss is None and self._above == 0 and sent.rate(now) >= USED * self.budget:
            periods = min((now - self._good_at) / PERIOD, MOST_PERIODS)
            step = FAST * self.budget if self._step is None else self._step
            self.budget = min(self.budget + periods * step, self._settings.most)
        if report.whole > 0:
            self._good_at = now

    def _share(self, sent: Sent, enough: float, guess: bool = False) -> float | None:
        """Share of chunks that were lost, counted back over ``enough`` bytes; None: too few for more than a guess."""
        came, reports = 0.0, list(self._window)
        least, pictures = (1, 1) if guess else (RECENT, PICTURES)
        for i in range(1, len(reports)):
            came += reports[-i].came
            between = sent.between(reports[-i - 1].seq, reports[-1].seq)
            many = reports[-1].seq - reports[-i - 1].seq >= pictures
            # What of a picture comes after it was whole is counted late, at both ends alike: many pictures even it out.
            if between and many and between >= enough and i >= least:
                return min(max(1.0 - came / between, 0.0), 1.0)
        return None

    def _loss(self, report: FrameReport, sent: Sent, now: float) -> float | None:
        """What parity is to make up for; a guess where pictures are torn, for it is needed soon."""
        if report.whole <= 0 and report.torn <= 0:
            return None
        found = self._share(sent, ENOUGH)
        if found is None and report.torn > 0:
            found = self._share(sent, SOON, guess=True)
        rate = sent.rate(now)
        if found is None and report.whole <= 0 and rate > 0.0:  # nothing whole to count from
            found = min(max(1.0 - max(report.rate_bytes, 0.0) / rate, self.loss), 1.0)
        return found

    def _lossy(self, sent: Sent) -> bool:
        """Whether more is lost than the link loses anyway."""
        soon, sure = self._share(sent, ENOUGH), self._share(sent, MANY)
        if soon is None:
            return False
        if self._cut_loss is not None:
            if self._cut_loss < soon < OWN_LOSS:
                self._own_loss = soon  # less was sent, and as much was lost
                self._step = self._step if self._limited else None
            else:
                self._limited = True
            self._cut_loss = None
        if sure is not None:
            more = sure - self._own_loss
            self._above = self._above + 1 if more >= SOME_LOSS else 0
            if more < SOME_LOSS:
                self._own_loss += FOLLOWS * more
        return soon > self._own_loss + MORE_LOSS or self._above >= LONG

    def _torn(self, report: FrameReport) -> bool:
        recent = list(self._window)[-2 * RECENT :]
        whole, torn = sum(each.whole for each in recent), sum(each.torn for each in recent)
        return report.torn > 0 and torn >= FEW and torn > TORN * (whole + torn)

    def _late(self, report: FrameReport, sent: Sent) -> bool:
        """Whether something waits on the way, and more and more."""
        if report.delay is None or not math.isfinite(report.delay):
            return False
        own = sent.own(report.seq)
        delay, before = report.delay - own, self._delays[-1] if self._delays else math.inf
        self._delays.append(delay)
        more = min(max(MORE_DELAY, own), MOST_DELAY)
        return delay > min(self._delays) + more and delay > before - FALLING

    def _decrease(self, loss: float | None, now: float) -> None:
        if now - self._cut_at < HOLD:
            return
        before, lost = self.budget, loss or 0.0
        factor = CUT if loss is None else min(max(1.0 - lost, DEEPEST_CUT), CUT)
        self.budget = max(before * factor, self._settings.least)
        self._step = STEP * self.budget
        # A full link would now lose what is still too much, a bad one as much as before: the middle tells them apart.
        if_full = max(1.0 - (1.0 - lost) * before / self.budget, 0.0)
        self._cut_at, self._cut_loss, self._above = now, 0.5 * (lost + if_full), 0
        seq = self._window[-1].seq
        self._window.clear()  # what is counted next was sent after this
        self._window.append(_Heard(seq, 0.0, 0, 0))


class Budget:
    """Of one camera: the tightest of its readers' links."""

    def __init__(self, settings: CameraSettings, reported: int = 1) -> None:
        self._settings = settings
        self.sent = Sent(reported)
        self.links: dict[str, ReaderLink] = {}

    def report(self, reader: str, report: FrameReport, now: float) -> None:
        """Take a reader's word; beyond :data:`MOST_READERS` nobody new is heard."""
        if reader not in self.links:
            if len(self.links) >= MOST_READERS:
                return
            self.links[reader] = ReaderLink(self._settings, now)
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
    def searched(self) -> bool:
        """Every reader's link was once full, or is known: before that the budget says little of it."""
        return all(link.limited for link in self.links.values())

    @property
    def loss(self) -> float:
        """Share of chunks that parity is to make up for."""
        return max((link.loss for link in self.links.values()), default=UNKNOWN_LOSS)
