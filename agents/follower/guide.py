"""What to fly next: approach, search, track, coast, hold, descend. No clock and no network in here.

Everything is metres north, east, down about the fleet's origin, m/s and UTC seconds. Only outer-loop commands come of
it: a place, and the velocity with which that place moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from agents.follower.drift import PositionDrift
from agents.follower.tracker import TargetEstimate, Tracker
from zmav.wire import Detection, Vector

Phase = Literal["approach", "search", "track", "coast", "hold", "descend", "touch"]
COAST_AFTER = 0.4
"""s without a sight after which what is flown is a prediction, and is called so"""
ARRIVED = 1.5
"""m from where the target is told to be at which looking there begins"""
TRUST = 12.0
"""m from where the target is told to be that a first sight of it may be: two positioning errors, and what it moved"""
ANYWHERE = 4.0
"""m that a sight may be from what is predicted, for it to be looked at at all"""
BLIND, TOUCH = 0.6, 0.15
"""m above the pad below which the camera sees too little of it, and at which the vehicle is told to land"""
KNOWN = 1.0
"""s of tracking after which it is known by how much the target's own word is wrong: two receivers' errors change slowly
"""
EASE = 0.02
"""by how much less than ``begin`` is enough with each second of a search: grass looks a little like an H in picture
after picture, and a pad is seen well in one of them
"""
FRESH = 1.0
"""s for which a target's word of its speed is good enough to begin with"""
AHEAD, OLDEST = 0.3, 3.0
"""s by which a sight may be from after now, by clocks that are not one (a place, too), and from before it"""
WIDE = 6.0
"""times its height that a vehicle may see to the side"""
LEVELS = 0.3
"""weight of a new sight in how far down the pad is"""
FASTER, HARD = 2.0, 0.8
"""the factor on ``sink`` where it goes down unseen, so that it is down before a gust; and m/s to which that factor may
bring it"""
SINKS_LATE = 0.4
"""s that an autopilot takes to begin to sink, and to land at the end"""
CALLED_OFF, LOW, STOPS, AGAIN, RISEN = 1.25, 0.15, 0.6, 0.4, 0.1
"""times ``gate`` by which it would miss the pad's middle for it to rise again; m above the pad, and s of its sinking on
top of them, below which it goes on down, as it would be on the deck before it rises; m above ``BLIND`` to which it
rises, because it sees the pad there; and m below that from which it goes down again
"""
WAITS = 60.0
"""s of waiting in one landing after which it is given up: a gust is over by then, so it is the wind, or what is seen or
flown is not good enough for this pad
"""
TOUCHING = 8.0
"""s of going down unseen after which it is told to land, wherever it is"""
GAP = 0.5
"""s without a step from which on the last half metre is not gone on with: it was not flown meanwhile"""
TURN = 0.35
"""of the spiral's pitch: what is seen on one pass overlaps with the next"""
CLOSE, MOST, PULL = 1.0, 1.0, 0.6
"""m off within which the integral grows; m/s added to the target's velocity at most, and the part of it that is for the
distance: with more it swings as it arrives
"""
TOO_LATE = 0.2
"""s until a command is heard from which on nothing is added: a loop that is closed so late would swing"""


@dataclass(frozen=True)
class TargetFix:
    """Where the target says that it is, by its own positioning; old or wrong by metres, perhaps."""

    t: float
    pos: Vector
    vel: Vector | None
    """None: it does not say"""

    def at(self, t: float) -> tuple[float, float]:
        ahead, (north, east) = max(0.0, min(t - self.t, 5.0)), self.moves
        return self.pos[0] + ahead * north, self.pos[1] + ahead * east

    @property
    def moves(self) -> tuple[float, float]:
        """m/s north, east; 0 where it does not say."""
        return (0.0, 0.0) if self.vel is None else self.vel[:2]


@dataclass(frozen=True)
class FollowCommand:
    """Fly to ``pos``, which moves with ``vel``."""

    pos: Vector
    vel: Vector = (0.0, 0.0, 0.0)
    land: bool = False
    """it is a hand above the pad: land"""


@dataclass
class Guide:
    """One flight above one target. ``height``: m above the pad to stay at; ``tuned``: the agent's parameters."""

    tuned: Callable[[str], float]
    height: float
    tracker: Tracker = field(default_factory=Tracker)
    """in a frame that moves with :attr:`drift`"""
    drift: PositionDrift = field(default_factory=PositionDrift)
    phase: Phase = "approach"
    wanted: Literal["follow", "hold", "land"] = "follow"
    lost: int = 0
    """how often the target was lost after it had been tracked"""
    called_off: int = 0
    """how often it has risen again from the last half metre, in this landing or the last one"""
    why: str = ""
    """why it gave up what was wanted, and wants something else by itself"""
    seen_plane: float | None = None
    """m down of the pad, by the sights: their size has its say in it"""
    _since: float = 0.0
    _told_off: tuple[float, float] | None = None
    """m north, east from where the target said that it is to where it was seen; without our own drift, which goes on
    while it is looked for
    """
    _looked: float = 0.0
    """s of searching since it had a target"""
    _held: Vector | None = None
    _angle: float = 0.0
    _level: float | None = None
    """m above the pad that is flown at now while descending or climbing"""
    _rises: bool = False
    """after a landing was called off, until it is back up at that level"""
    _waited: float = 0.0
    """s of this landing in which it did not go lower"""
    _unseen: float = 0.0
    """s of them for which the pad was not seen"""
    _before: float = 0.0
    _begun: tuple[float, float] | None = None
    _seen_at: tuple[float, float] | None = None
    """m north, east: where it was lost; without our own drift, as :attr:`_told_off`"""
    _trim: tuple[float, float] = (0.0, 0.0)
    """m/s north, east: the integral of how far off it has been, against a steady wind"""

    def land(self) -> None:
        """Have it go down onto the pad. Where it waited too long for a calm moment it wants to follow again, and where
        it looked for the pad too long, to hold; :attr:`why` says that.
        """
        if self.wanted != "land":
            self.called_off, self._waited, self._unseen = 0, 0.0, 0.0
        self.wanted, self.why = "land", ""

    # What is seen.

    def see(
        self, now: float, t: float, found: Sequence[Detection], me: Vector, told: TargetFix | None, least: float
    ) -> bool:
        """A picture of ``t`` was looked at; whether something in it was believed. Of several pads the one counts that
        is nearest to what is predicted, or to where the target says that it is; none that is far from that counts.
        """
        if not now - OLDEST < t < now + AHEAD:
            return False
        aim, within = self._about(t, told)
        begin = max(least, self.tuned("begin") - EASE * self._looked)
        if self.tracker.t is None or t - self.tracker.t > COAST_AFTER:
            least = begin
        vel = None
        if told is not None and told.vel is not None and abs(t - told.t) < FRESH:
            vel = told.moves if math.hypot(*told.moves) <= self.tuned("speed") else None
        places = [each for each in found if each.score >= least and self._may_be(each, t, me, told)]
        if aim is not None:
            places = [each for each in places if _away(each, aim) <= within]
            places.sort(key=lambda each: _away(each, aim))
        for each in places[:1]:
            assert each.pos is not None
            north, east = self.drift.at(t)
            place = each.pos[0] - north, each.pos[1] - east
            if self.tracker.see(t, place, each.covariance, vel, may_be_another=each.score >= begin):
                before = each.pos[2] if self.seen_plane is None else self.seen_plane
                self.seen_plane = before + LEVELS * (each.pos[2] - before)
                if told is not None and self.phase == "track" and now - self._since > KNOWN:
                    said = told.at(t)
                    self._told_off = place[0] - said[0], place[1] - said[1]
                return True
        return False

    def _may_be(self, each: Detection, t: float, me: Vector, told: TargetFix | None) -> bool:
        if each.pos is None or not all(map(math.isfinite, each.pos)):
            return False
        if _away(each, (me[0], me[1])) > WIDE * max(each.pos[2] - me[2], 1.0):
            return False
        return told is None or _away(each, told.at(t)) <= TRUST

    def _about(self, t: float, told: TargetFix | None) -> tuple[tuple[float, float] | None, float]:
        """Where a sight may be, None for anywhere, and within how many metres."""
        estimate = self.target(t)
        if estimate is not None and self.phase not in ("approach", "search"):
            return (float(estimate.pos[0]), float(estimate.pos[1])), ANYWHERE + 3.0 * estimate.sigma
        return (None if told is None else told.at(t)), TRUST

    def target(self, t: float) -> TargetEstimate | None:
        """Where the target is at ``t``, as the vehicle's own position is told then; None where it is not known."""
        if (estimate := self.tracker.at(t)) is None:
            return None
        return replace(estimate, pos=estimate.pos + self.drift.at(t))

    # What is flown.

    def step(
        self,
        now: float,
        me: Vector,
        told: TargetFix | None,
        plane: float,
        late: float = 0.0,
        vel: Vector = (0.0, 0.0, 0.0),
        old: float = 0.0,
    ) -> FollowCommand:
        """``me``: where the vehicle is; ``vel``: how it moves; ``plane``: how far down the pad is; ``late``: s until it
        hears the command; ``old``: s by which what is known of ``me`` came late.
        """
        if self._before and now - self._before > GAP and self.phase == "touch":
            self.phase, self._since, self._level = "descend", now, None
        dt, self._before = (min(max(now - self._before, 0.0), 0.5) if self._before else 0.0), now
        if self.tracker.t is not None and self.tracker.t > now + AHEAD:  # the clock was set back
            self.tracker.forget()
            self._since = now
        if self.seen_plane is not None and self.phase not in ("approach", "search"):
            plane = self.seen_plane
        self._turn(now, me, told, late)
        if self.phase == "search":
            self._looked += dt
        elif self.tracker.t is not None:
            self._looked = 0.0
        if self.phase == "hold":
            self._held = self._held or me
            return FollowCommand(self._held)
        self._held = None
        if self.phase in ("approach", "search"):
            return self._look(now, dt, me, told, plane)
        estimate = self.target(now + self.tuned("lead") + late)
        assert estimate is not None
        return self._above(estimate, dt, me, now, plane, late, vel, old)

    def _turn(self, now: float, me: Vector, told: TargetFix | None, late: float) -> None:
        """To the phase that follows from what is known now; a sight comes as late as everything else."""
        before = self.phase
        if self.wanted == "land" and self._waited > WAITS and before != "touch":
            self.wanted = "follow"
            self.why = f"it waited {self._waited:.0f} s over the pad, rose again {self.called_off} times, and " + (
                f"did not see the pad in {self._unseen:.0f} s of them"
                if self._unseen > 0.5 * self._waited
                else "was never near and calm enough to land: wait for less wind, or give it a wider gate"
            )
        if self.wanted == "hold":
            self.phase = "hold"
        else:
            seen = self.tracker.t
            unseen = math.inf if seen is None else now - seen
            blind = {"touch": math.inf, "descend": self.tuned("coast")}.get(before, 0.0)
            if self.wanted == "land" and unseen < blind:
                pass  # so near above it nothing is seen any more
            elif unseen - late < COAST_AFTER:
                self.phase = "descend" if self.wanted == "land" else "track"
            elif unseen < self.tuned("coast"):
                self.phase = "coast"
            elif before != "search":
                self.lost += before in ("track", "coast", "descend", "touch")
                self.phase = "approach"
                if seen is not None and (estimate := self.tracker.at(seen + self.tuned("coast"))) is not None:
                    # Its own word, or two new sights, are better than a velocity that led to nothing.
                    self._seen_at = (float(estimate.pos[0]), float(estimate.pos[1]))
                    self.tracker.forget()
            elif now - self._since > self.tuned("search_seconds"):
                self.wanted, self.phase = "hold", "hold"
                self.why = f"it looked for the pad for {now - self._since:.0f} s and did not find it"
            if self.phase == "approach":
                place = self._place(now, told)
                if place is None or math.hypot(place[0] - me[0], place[1] - me[1]) < ARRIVED:
                    self.phase = "search"
        if self.phase != before:
            self._since, self._angle = now, 0.0
            if self.phase not in ("descend", "touch"):
                self._level = None
            if self.phase not in ("track", "coast", "descend", "touch"):
                self._trim = (0.0, 0.0)

    def _place(self, now: float, told: TargetFix | None) -> tuple[float, float] | None:
        """Where to look: where it says that it is, by what that was wrong when it was seen; else where it was seen."""
        drift = self.drift.at(now)
        if told is None:
            return None if self._seen_at is None else (self._seen_at[0] + drift[0], self._seen_at[1] + drift[1])
        north, east = told.at(now)
        if self._told_off is None:
            return north, east
        return north + self._told_off[0] + drift[0], east + self._told_off[1] + drift[1]

    def _look(self, now: float, dt: float, me: Vector, told: TargetFix | None, plane: float) -> FollowCommand:
        """On the way there, or in a growing spiral about it, rising for a wider view."""
        place = self._place(now, told) or self._held_place(me)
        top = max(self.height, self.tuned("search_top"))
        vel = (0.0, 0.0, 0.0) if told is None else (*told.moves, 0.0)
        if self.phase == "approach":
            return FollowCommand((place[0], place[1], plane - self.height), vel)
        height = min(top, self.height + self.tuned("search_climb") * max(0.0, now - self._since))
        pitch = TURN * 2.0 * 0.46 * height  # the narrower half of a view of 63 by 49 degrees is 0.46 of the height
        radius = pitch * self._angle / math.tau
        if radius > self.tuned("search_radius"):
            self._angle, radius = 0.0, 0.0
        self._angle += self.tuned("search_speed") * dt / math.hypot(radius, pitch / math.tau + 0.3)
        north, east = radius * math.cos(self._angle), radius * math.sin(self._angle)
        return FollowCommand((place[0] + north, place[1] + east, plane - height), vel)

    def _held_place(self, me: Vector) -> tuple[float, float]:
        """Nothing was ever said or seen: where the search began."""
        if self._begun is None:
            self._begun = (me[0], me[1])
        return self._begun

    def _above(
        self,
        estimate: TargetEstimate,
        dt: float,
        me: Vector,
        now: float,
        plane: float,
        late: float,
        vel: Vector,
        old: float,
    ) -> FollowCommand:
        """Over the target, going with it; lower and lower where it is to be landed on and is below us."""
        (north, east), (u, v) = map(float, estimate.pos), map(float, estimate.vel)
        here = self.target(now)
        assert here is not None
        behind = (float(here.pos[0]) - me[0], float(here.pos[1]) - me[1])
        u, v = _bounded((u, v), self.tuned("speed"))
        slower = (u - vel[0], v - vel[1])
        level, down = self.height, 0.0
        if self.phase in ("descend", "touch"):
            level, down = self._go_down(behind, slower, dt, plane - me[2], vel[2], now, late)
            self._waited += dt if down == 0.0 else 0.0
        more = self._against(behind, slower, dt, max(late, old))
        land = self.phase == "touch" and (
            (plane - me[2] < TOUCH + 0.1 and level < TOUCH) or now - self._since > TOUCHING
        )
        return FollowCommand((north, east, plane - level), (u + more[0], v + more[1], down), land)

    def _go_down(
        self,
        behind: tuple[float, float],
        slower: tuple[float, float],
        dt: float,
        above: float,
        sinks: float,
        now: float,
        late: float,
    ) -> tuple[float, float]:
        """m above the pad to fly at, and m/s down; ``above``: m that it is above it now, ``sinks``: m/s."""
        if self._level is None:
            self._level = max(above, 0.0)
        gate, sink = self.tuned("gate"), self.tuned("sink")
        fall = max(sink, min(FASTER * sink, HARD))
        # A gust carries it on while it goes down: an autopilot takes longer to stop that than to be on the deck.
        takes = SINKS_LATE + max(above, 0.0) / fall
        off = math.hypot(*behind)
        misses = math.hypot(behind[0] + takes * slower[0], behind[1] + takes * slower[1])
        fresh = self.tracker.t is not None and now - self.tracker.t - late < COAST_AFTER
        if self.phase == "descend" and fresh and self._level <= BLIND and max(off, misses) < gate:
            self.phase, self._since = "touch", now
        elif self.phase == "touch" and above > LOW + STOPS * sinks and misses > CALLED_OFF * gate:
            self.phase, self._since, self._rises = "descend", now, True
            self._level = min(BLIND + AGAIN, max(self.height, BLIND))
            self.called_off += 1
        if self.phase == "descend" and not fresh:  # from higher up it sees more
            self._unseen += dt
            self._level = max(self._level, min(self._level + sink * dt, self.height))
            return self._level, 0.0
        self._rises = self._rises and above < self._level - RISEN
        if self._rises:
            return self._level, 0.0
        if self.phase == "descend" and off >= max(gate, 0.12 * self._level):
            return self._level, 0.0
        down, floor = (fall, 0.0) if self.phase == "touch" else (sink, BLIND)
        self._level = max(floor, self._level - down * dt)
        return self._level, down if self._level > floor else 0.0

    def _against(
        self, behind: tuple[float, float], slower: tuple[float, float], dt: float, late: float
    ) -> tuple[float, float]:
        """m/s north, east that are added to the velocity against gusts. An autopilot takes about a second over a
        metre; shares of how far off it is and of how much ``slower`` it is than the target, and the integral of the
        distance, make that stiffer. All end where they are heard late, or of a place that is: ``late``.
        """
        share = max(0.0, 1.0 - late / TOO_LATE)
        if math.hypot(*behind) < CLOSE:
            gain = share * self.tuned("trim") * dt
            self._trim = _bounded((self._trim[0] + gain * behind[0], self._trim[1] + gain * behind[1]), MOST)
        stiff, damp = self.tuned("stiff"), self.tuned("damp")
        pull = _bounded((stiff * behind[0] + damp * slower[0], stiff * behind[1] + damp * slower[1]), PULL)
        return _bounded((share * (self._trim[0] + pull[0]), share * (self._trim[1] + pull[1])), MOST)


def _bounded(vector: tuple[float, float], most: float) -> tuple[float, float]:
    size = math.hypot(*vector)
    return vector if size <= most else (vector[0] * most / size, vector[1] * most / size)


def _away(found: Detection, place: tuple[float, float]) -> float:
    assert found.pos is not None
    return math.hypot(found.pos[0] - place[0], found.pos[1] - place[1])
