"""Who is to be told what, and when: the execution of one plan, decided purely from what was heard so far.

All vehicles fly the plan by one common clock (:class:`~.track.CommonClock`). Each is sent its trajectory as far ahead
as is clear of everything that any other may be flying (:mod:`.commit`), with a stop tail along its own way, long before
the last one's tail begins. Who cannot be told in time stops by itself, and the clock waits for it. Times are ours, ENU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np

from agents.planner.execute.commit import Entry, Order, Part, Reserved, Stamp
from agents.planner.execute.rows import SAME, ahead, head_of, knot, standing
from agents.planner.execute.track import CommonClock, Profile, behind, braked, crept, knots, onward
from agents.planner.model.problem import Floats, places_at
from zmav.wire.state import Severity

if TYPE_CHECKING:
    from agents.planner.returning.keeper import ReturnKeeper
    from agents.planner.returning.ways import Way

START = 2.0
"""s from the first commit until the plan begins: for everybody to hear it"""
LEAD = 0.8
"""s before a trajectory departs from the one before, at which it is not sent any more for the first time"""
GUARD = 0.05
"""s between a deadline and the departure"""
AHEAD = 4.5
"""s: no deadline is farther away (the vehicle takes 5)"""
EXTEND = 13.0
"""s before its tail from which a vehicle is sent more"""
URGENT = 5.0
"""... and from which any progress is better than none"""
LASTING = 55.0
"""s after which a segment must end (the vehicle takes 60)"""
REACHES = (20.0, 16.0, 12.0, 9.0, 7.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.25, 0.125)
"""s of the plan by which a vehicle is sent farther, tried one after another: the first at most"""
WORTH = 2.0
"""s of progress for which it is told while there is time"""
RESEND, RESEND_SILENT, SILENT = 0.5, 1.0, 1.0
"""s after which what is not acknowledged is put again, for a link that loses much carries little; and for one that was
not heard for the last"""
RETRY = 0.25
"""s before what was refused is looked at again"""
AWAY = 1.0
"""s ahead of the common clock from which a vehicle is slowed in mid-way"""
LOST_AFTER = 5.0
"""s without a word after which a vehicle is lost"""
KEEP, KEEP_LEFT, KEEP_EVERY = 45.0, 25.0, 2.0
"""s that a resting vehicle is told to stay for, and when it is told so again"""
STUCK_AFTER, WAIT_FOR_LOST = 3.0, 10.0
"""s at rest without a way on, after which a new plan is asked for"""
REFUSES_AFTER, AT_ONCE = 30.0, 3.0
"""s for which one at rest refuses what it is sent, no farther apart than the second, until it is given up"""
SLOW, SLOWEST = 0.6, 0.35
"""paces of the common clock while somebody does not keep up, and from half-way between that and where all are stopped
at"""
USUAL = 2.0
"""times what it usually is off its way (root mean square) up to which nobody is slowed for it, but half-way to where
all are stopped at most"""
LATER = 0.05
"""s by which a vehicle follows later than was known before that is reckoned with"""
STOPPED, FARTHER = 3.0, 0.8
"""times as far off its way as it may be, but for m or for as much again, from which all come to rest"""
LEFT = 5.0
"""m off the end of its way (or twice what brings all to rest) from which a vehicle has left it: it goes on from where
it is, and not from there"""
RECOVER = 5.0
"""s of keeping up after which it is the plan's own again"""


class Send(NamedTuple):
    """Commit a vehicle to these points, to be taken by ``deadline`` (ours) or not at all."""

    part: Part
    entry: Entry
    rows: Floats
    deadline: float
    home: Way | None = None
    """what it flies by itself if nothing comes after this"""


@dataclass
class Saying:
    """What happened, and why."""

    kind: str
    severity: Severity
    text: str
    detail: dict[str, Any] = field(default_factory=dict)


Phase = Literal["flying", "paused", "halted", "stuck", "done"]


class Source(Protocol):
    """Where motion comes from that is not a plan's: short trajectories again and again, each at rest in the end."""

    def next(self, part: Part, now: float) -> Send | None:
        """What it is to be told now; None: nothing yet."""

    def told(self, part: Part, now: float) -> None:
        """It was put."""


class Conductor:
    """One plan's, or one ``source``'s. Call :meth:`heard` for each state, then :meth:`decide` a few times a second; put
    what it returns and tell :meth:`sent`.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        downwash: float,
        now: float,
        source: Source | None = None,
        homes: ReturnKeeper | None = None,
    ) -> None:
        self.parts = list(parts)
        self._source, self._homes = source, homes
        self.reserved = Reserved(self.parts, downwash)
        self.said: list[Saying] = []
        self.blocked: dict[str, str] = {}
        """who waits for whom"""
        self.line = CommonClock(now + START, 0.0)
        self._order = Order(self.parts, downwash)
        self._slope = 1.0 / max([1.0, *(part.track.speed / (0.6 * part.accel) for part in self.parts)])
        self._tried: dict[str, float] = {}
        self._retimed: dict[str, float] = {}
        self._paused = False
        self.halting = ""
        """why everybody is brought to rest"""
        self._moved = now
        self._slow_until = -np.inf
        for part in self.parts:
            if not part.entries:
                part.entries = [standing(part.track.at(np.zeros(1))[0][0], now)]

    # What is heard.

    def heard(
        self, part: Part, now: float, said: float, stamp: Stamp | None, ends: float | None, instance: str
    ) -> None:
        """A state that the vehicle stamped ``said`` (its clock): the segment it is on and until when (its clock), and
        the ``instance`` of its agent.
        """
        part.heard = max(part.heard, now)
        if instance != part.instance:
            self.gone(part, "its agent was restarted")
            return
        if said <= part.said:
            return  # overtaken on the way: a later word is known
        part.said = said
        if self._homes is not None:
            self._homes.heard(part, stamp, said)
        if part.lost:
            part.lost = False
            self._say("found", "notice", f"{part.id} is heard again", vehicle=part.id)
        before = part.known
        if part.acknowledge(stamp, said):
            self._tried.clear()
            self._moved = now
            if part.known is before:
                first, last = part.refused
                part.refused = (first if now - last < AT_ONCE else now, now)
            else:
                part.refused = (now, -np.inf)
        if part.known.taken and not any(stamp in entry.sent for entry in part.entries):
            self.gone(part, "it flies no trajectory of ours any more", strays=True)
        elif ends is not None and stamp in part.known.sent:
            part.kept_until = max(part.kept_until, part.offset.ours(ends))

    def delay(self, part: Part, late: float, now: float) -> None:
        """It follows so late, as is known now: who may then come too near to somebody has all come to rest."""
        part.late = late
        for entry in part.entries:
            entry.delay(late)
            if self._homes is not None:
                self._homes.blocker(part, entry, now)  # whose way home that meets now is sent another
        if not part.active or self.halting:
            return
        for entry in part.entries:
            if other := self.reserved.blocker(part, entry, now - 0.5):
                self.halt(f"{part.id} follows {late:.1f} s late, too near to {other}", vehicle=part.id, other=other)
                return

    def strayed(self, part: Part, now: float, at: float, place: Floats) -> float:
        """It was at ``place`` at our time ``at``: m off what it may be flying, late as it is. Slows the common clock,
        or halts. Where it was before what it is known to fly began says nothing.
        """
        if at <= part.known.samples[0, 0]:
            return 0.0
        if not part.pending or at < part.latest.departs:  # else it may be on the later one
            part.following.heard(part.place_at, at, place)
            if self._source is None and abs(part.following.late - part.late) > LATER:
                self.delay(part, part.following.late, now)
        meant = [np.linalg.norm(place - places_at(entry.samples, at)) for entry in part.entries]
        off = float(min(meant))
        allowed = part.margin + part.track.speed * part.error
        if self._source is not None:
            return off  # it is led to where it shall be anyhow
        limit = min(STOPPED * max(allowed, 0.2), allowed + max(FARTHER, allowed))
        slows = max(allowed, min(USUAL * part.usual, 0.5 * (allowed + limit)), 0.1)
        if off > max(LEFT, 2.0 * limit) and part.resting(now):
            self.gone(part, f"it is {off:.1f} m off its trajectory", strays=True)
        elif off > limit:
            self.halt(f"{part.id} is {off:.1f} m off its trajectory", vehicle=part.id, metres=off)
        elif off > slows and not part.resting(now):
            pace = SLOW if off < 0.5 * (slows + limit) else SLOWEST
            if self.line.pace > pace:
                text = f"{part.id} is {off:.2f} m off its trajectory: the common clock is slowed"
                self._say("slow", "warning", text, vehicle=part.id, metres=off)
                self._pace(pace, now)
            self._slow_until = now + RECOVER
        return off

    def gone(self, part: Part, why: str, place: Floats | None = None, *, strays: bool = False) -> None:
        """It follows us no more (a pilot, another commander, its own failsafe): nobody fights for it. ``strays``: it
        left by itself, and may be led on from where it holds.
        """
        if place is not None:
            part.place = place
        if not part.off:
            part.off, part.strays = why, strays
            self.halt(f"{part.id}: {why}", vehicle=part.id)

    # What is wanted.

    def pause(self) -> None:
        if not self._paused:
            self._paused = True
            self._say("pause", "notice", "paused: everybody comes to rest on its way")

    def resume(self) -> None:
        if self._paused:
            self._paused = False
            self._say("resume", "notice", "resumed")

    def halt(self, why: str, **detail: Any) -> None:
        """Bring everybody to rest, for good: a new plan goes on from there."""
        if not self.halting:
            self.halting = why
            self._say("halt", "warning", f"{why}: everybody comes to rest", **detail)

    def phase(self, now: float) -> Phase:
        active = [part for part in self.parts if part.active]
        if all(part.finished(now) for part in active) and not any(part.lost or part.off for part in self.parts):
            return "done"
        if all(part.resting(now) for part in active):
            if self.halting:
                return "halted"
            if self._paused:
                return "paused"
            if now - self._moved > (WAIT_FOR_LOST if any(part.lost for part in self.parts) else STUCK_AFTER):
                return "stuck"
        return "flying"

    def progress(self, now: float) -> float:
        """0 to 1: how much of the plan is flown."""
        whole = sum(part.track.end for part in self.parts)
        flown = sum(float(part.known.profile.at(np.array([now]))[0][0]) for part in self.parts)
        return 1.0 if whole <= 0.0 else min(1.0, flown / whole)

    # What is to be done.

    def decide(self, now: float, most: int = 1000) -> list[Send]:
        """What is to be put now. ``most``: trajectories that are made in one call; the rest is for the next."""
        self._notice(now)
        self.reserved.fresh.clear()
        if self._homes is not None:
            self._homes.begin(self.parts, now)
        sends: list[Send] = []
        stopping = self._paused or bool(self.halting)
        if stopping:
            self._moved = now
        elif self._source is None:
            self._follow(now)
        stops = np.array([part.stop if part.stop < part.track.end else np.inf for part in self.parts])
        for index in sorted(range(len(self.parts)), key=lambda i: (self.parts[i].latest.tail_at, i)):
            part = self.parts[index]
            if not part.active or most <= 0:
                continue
            if part.pending:
                send = self._again(part, now)
            elif self._source is not None:  # what it has is at rest soon
                send = None if stopping else self._source.next(part, now)
            elif stopping:
                send = self._brake(part, now)
            else:
                send = self._extend(index, part, now, stops) or self._retime(part, now)
            if send is None and not part.pending:
                send = self._keep(part, now)
            if send is not None:
                if self._homes is not None:
                    send = send._replace(home=self._homes.home(part, send.entry, float(send.rows[-1, 0]), now))
                self.reserved.fresh[part.id] = send.entry
                sends.append(send)
                most -= 1
        return sends

    def sent(self, send: Send, stamp: Stamp, deadline: float, now: float) -> None:
        """It was put, with a ``deadline`` by the vehicle's clock."""
        entry = send.entry
        entry.sent.append(stamp)
        if self._homes is not None:
            self._homes.sent(send.part, stamp, deadline)
        entry.deadline, entry.last_sent = max(entry.deadline, deadline), now
        self.reserved.fresh.pop(send.part.id, None)
        if not any(entry is each for each in send.part.entries):
            send.part.entries.append(entry)
            self._moved = now
            if self._source is not None:
                self._source.told(send.part, now)

    def _notice(self, now: float) -> None:
        for part in self.parts:
            if not part.lost and not part.off and now - part.heard > LOST_AFTER:
                part.lost = True
                text = f"{part.id} is not heard: its way and the column at its end stay reserved"
                self._say("lost", "warning", text, vehicle=part.id)
            if part.active and part.known.rest_at < now and part.refused[1] - part.refused[0] > REFUSES_AFTER:
                self.gone(part, f"it is heard, and has taken no trajectory for {REFUSES_AFTER:g} s")
        if self.line.pace < 1.0 and now > self._slow_until:
            self._pace(1.0, now)
            self._say("pace", "notice", "everybody keeps up: the common clock goes at the plan's pace again")
        if any(part.active and part.known.rest_at > now for part in self.parts):
            self._moved = now

    def _pace(self, pace: float, now: float) -> None:
        self.line = CommonClock(now, self.line.at(now), pace)

    def _follow(self, now: float) -> None:
        """The common clock waits for the one who is farthest behind."""
        most = 0.0
        for part in self.parts:
            entry = part.latest
            if not part.active or entry.stop >= part.track.end:
                continue
            d = max(entry.tail_at, now + LEAD) if entry.tail_at < np.inf else now + LEAD
            (s,), (rate,) = entry.profile.at(np.array([d]))
            most = max(most, behind(d, float(s), float(rate), self.line, self._slope))
        if most > 0.02:
            self.line = CommonClock(self.line.t, self.line.s - most, self.line.pace)

    def _extend(self, index: int, part: Part, now: float, stops: Floats) -> Send | None:
        """Farther along its way. ``stops``: the moments that all are sure to come to."""
        entry, end = part.known, part.track.end
        left = entry.tail_at - now
        if entry.stop >= end or left > EXTEND or now < self._tried.get(part.id, -np.inf):
            return None
        d = self._departure(entry, now)
        (s,), _ = entry.profile.at(np.array([d]))
        for reach in REACHES:
            grid = 2.0 if reach >= 5.0 else min(reach, 0.5)
            stop = end if s + reach >= end else np.floor((s + reach) / grid) * grid
            if stop <= entry.stop or (stop < end and stop - entry.stop < (WORTH if left > URGENT else 0.1)):
                continue
            first = self._order.allows(index, stop, stops)
            if first is not None:
                self.blocked[part.id] = self.parts[first].id
                continue
            profile = onward(entry.profile, d, self.line, stop, end, self._slope)
            if profile is None:  # no room to get going: inch on, where others must follow before it can go farther
                profile = crept(entry.profile, d, stop, self._slope)
            if profile is None:
                continue
            made = self._made(part, profile, d, now, stop >= end)
            if made is not None:
                self.blocked.pop(part.id, None)
                return made
        self._tried[part.id] = now + RETRY
        return None

    def _retime(self, part: Part, now: float) -> Send | None:
        """Slow down one who is ahead of the common clock, where that is clear; not who is on its last way: its goal is
        nobody's way, and the clock may be standing.
        """
        entry = part.known
        if entry.stop >= part.track.end or entry.rest_at < now + 2.0 * LEAD:
            return None
        if now < self._retimed.get(part.id, -np.inf):
            return None
        d = knot(entry, now + LEAD)
        (s,), (rate,) = entry.profile.at(np.array([d]))
        if s - self.line.at(d) < AWAY or (s <= 0.0 and rate == 0.0 and d < entry.profile.t[0]):
            return None
        self._retimed[part.id] = now + 1.5
        profile = onward(entry.profile, d, self.line, entry.stop, part.track.end, self._slope)
        if profile is None:
            return None
        return self._made(part, profile, d, now, False)

    def _brake(self, part: Part, now: float) -> Send | None:
        entry = part.known
        if now < self._tried.get(part.id, -np.inf) or entry.rest_at < now + 1.5:
            return None
        d = knot(entry, now + LEAD)
        profile = braked(entry.profile, d, self._slope)
        if profile.rest_at > entry.rest_at - 1.0:
            return None
        made = self._made(part, profile, d, now, False)
        self._tried[part.id] = now + RETRY
        return made

    def _keep(self, part: Part, now: float) -> Send | None:
        """A vehicle at rest is told to stay, before its own failsafe acts: its place is what it holds in any case. One
        whose way home is in the way is told what it flies again, with another.
        """
        entry, yields = part.known, self._homes is not None and self._homes.yields(part, now)
        if yields and not part.resting(now):
            return Send(part, entry, ahead(entry.rows, now), now + 2.0)
        kept = now - entry.last_sent < KEEP_EVERY or part.kept_until - now > KEEP_LEFT
        if not part.resting(now) or (kept and not yields):
            return None
        row = entry.rows[-1].copy()
        row[4:] = 0.0
        rows = np.array([row] * int(KEEP / 2.5 + 1))
        rows[:, 0] = np.round(now - 0.2 + 2.5 * np.arange(len(rows)), 6)
        return Send(part, entry, rows, now + 2.0)

    def _again(self, part: Part, now: float) -> Send | None:
        """What was sent is sent again until it is acknowledged or too late."""
        entry = part.latest
        deadline = self._deadline(part, entry, now)
        wait = RESEND if now - part.heard < SILENT else RESEND_SILENT
        if now - entry.last_sent < wait or deadline < now + 0.1:
            return None
        return Send(part, entry, ahead(entry.rows, now), deadline)

    def _departure(self, entry: Entry, now: float) -> float:
        """Where a longer one leaves: at its tail, or in it as soon as can be, or from rest."""
        if entry.tail_at >= now + LEAD:
            return entry.tail_at
        return knot(entry, now + LEAD)

    def _made(self, part: Part, profile: Profile, d: float, now: float, whole: bool) -> Send | None:
        """The trajectory by this profile from ``d`` on, where it is clear of everybody."""
        before = part.known
        if profile.rest_at - now > LASTING:
            return None
        onto = knots(part.track, profile, d)
        head = head_of(before, d, now - part.late)
        joined = abs(float(head[-1, 0]) - d) < SAME
        rows = np.vstack((head, onto[1:] if joined else onto))
        entry = Entry(profile, rows, d, np.inf if whole else float(profile.t[-2]), late=part.late)
        blocker = self.reserved.blocker(part, entry, now - 0.5)
        if blocker is not None and self.halting and self.reserved.is_better(part, entry, now - 0.5):
            blocker = None
        if blocker is None and self._homes is not None:
            blocker = self._homes.blocker(part, entry, now)
        if blocker is not None:
            self.blocked[part.id] = blocker
            return None
        return Send(part, entry, ahead(entry.rows, now), self._deadline(part, entry, now))

    def _deadline(self, part: Part, entry: Entry, now: float) -> float:
        return min(entry.departs - GUARD - part.error, now + AHEAD)

    def _say(self, kind: str, severity: Severity, text: str, **detail: Any) -> None:
        self.said.append(Saying(kind, severity, text, detail))
