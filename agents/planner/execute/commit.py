"""What each vehicle may be flying, and what none may be told before that is clear of it.

The rule that everything rests on: every trajectory that one vehicle may be flying is separated from every trajectory
that any other may be flying. A trajectory that was sent may be flown until the vehicle says that it flies a later one,
or says something after the deadline by which it had to take it and still flies another. So a vehicle has at most two:
the one known, and one pending, which departs from it only after its deadline. Nothing here waits, sends or reads a
clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agents.planner.execute.following import SPREAD, Following
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import Profile, Track, flown, state_at
from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.separation import least_between
from agents.planner.solve.jit import jit

GRAIN = 0.25
"""s between the moments of a plan at which the order of vehicles is looked at"""
ABREAST = 2
"""grains within which the exact check alone decides who goes first"""
TOUCH = 0.002
"""m: rounding on the wire, and what the curve does between its samples"""

TAKING = 0.3
"""s that a busy vehicle may need from the look at a deadline until its state names the trajectory"""

Stamp = tuple[int, int]
"""lease number and sequence number of a setpoint"""


@dataclass
class Entry:
    """One trajectory that a vehicle may be flying, by our clock."""

    profile: Profile
    rows: Floats
    """(K, 7): t, place, velocity: the points it is sent as"""
    departs: float
    """when it leaves the one before it; a vehicle must have taken it by then"""
    tail_at: float
    """when it begins to slow down to rest before its goal; inf: it ends at the goal"""
    sent: list[Stamp] = field(default_factory=list)
    deadline: float = -np.inf
    """after which no vehicle takes it any more, by the vehicle's clock"""
    last_sent: float = -np.inf
    taken: bool = False
    """the vehicle said that it is on it"""
    late: float = 0.0
    """s by which the vehicle is where the points have it later than they say"""

    def __post_init__(self) -> None:
        self.samples = flown(self.rows)
        self.samples[:, 0] += self.late
        low, high = self.samples[:, 1:].min(axis=0), self.samples[:, 1:].max(axis=0)
        self.box: tuple[float, ...] = (*low.tolist(), *high.tolist())

    def delay(self, late: float) -> None:
        """It is expected to be so late from now on."""
        self.samples[:, 0] += late - self.late
        self.late = late

    @property
    def stop(self) -> float:
        return self.profile.stop

    @property
    def rest_at(self) -> float:
        return self.profile.rest_at


@dataclass
class Part:
    """One vehicle's part in a plan."""

    id: str
    track: Track
    radius: float
    accel: float
    margin: float
    """m by which it may be off its trajectory, late as it is, its clock's error aside"""
    offset: Offset
    entries: list[Entry] = field(default_factory=list)
    """what it may be flying: the one known, and the one pending"""
    heard: float = -np.inf
    """when it last spoke"""
    said: float = -np.inf
    """the newest time that it stamped, by its clock"""
    kept_until: float = -np.inf
    """when the last segment that it acknowledged ends"""
    lost: bool = False
    off: str = ""
    """why it follows us no more; empty: it does"""
    strays: bool = False
    """it left our trajectory by itself: its last resort moved it aside"""
    place: Floats | None = None
    """where it was last seen, once it follows us no more"""
    error: float = 0.0
    """s by which its clock may be other than we think"""
    late: float = 0.0
    """s after the time of its points at which it is expected where they have it"""
    instance: str = ""
    """of its agent: another one counts leases and setpoints from zero again"""
    following: Following = field(default_factory=Following)
    """how it follows what it is told, as is learnt from what it says"""
    usual: float = SPREAD
    """m, root mean square, that it was usually off its way when the plan began"""
    refused: tuple[float, float] = (-np.inf, -np.inf)
    """when it first and last said that it did not take a trajectory, of those that it refused one after another"""

    def follows(self, following: Following) -> None:
        """As was learnt of it before."""
        self.following, self.late, self.usual = following, following.late, following.spread

    @property
    def known(self) -> Entry:
        return self.entries[0]

    @property
    def latest(self) -> Entry:
        return self.entries[-1]

    @property
    def pending(self) -> bool:
        return len(self.entries) > 1

    @property
    def active(self) -> bool:
        return not self.lost and not self.off

    @property
    def stop(self) -> float:
        """The moment of the plan that it comes to for certain."""
        return min(entry.stop for entry in self.entries)

    @property
    def need(self) -> float:
        """m that nothing else's may come nearer than, with its own need, to its trajectory."""
        return self.radius + self.margin + self.track.speed * self.error

    def resting(self, now: float) -> bool:
        return not self.pending and self.known.rest_at <= now

    def finished(self, now: float) -> bool:
        return self.resting(now) and self.known.stop >= self.track.end

    def acknowledge(self, stamp: Stamp | None, said: float) -> bool:
        """A state that the vehicle stamped ``said`` names the segment it is on. True: it has news of what it flies."""
        if stamp is not None and stamp in self.known.sent:
            self.known.taken = True
        if not self.pending:
            return False
        pending = self.entries[-1]
        if stamp is not None and stamp in pending.sent:
            self.entries, pending.taken = [pending], True
            return True
        if said > pending.deadline + TAKING:  # refused, or lost on the way, and too late by now
            self.entries.pop()
            return True
        return False

    def is_clear(self, now: float, clear: Callable[[Floats, Floats, float], bool]) -> bool:
        """Every straight piece of the rest of its way is, by ``clear``."""
        (s,), _ = self.known.profile.at(np.array([now]))
        pos = self.track.pos[max(int(np.searchsorted(self.track.s, s, side="right")) - 1, 0) :]
        return all(clear(p, q, self.radius) for p, q in pairwise(pos))

    def place_at(self, t: float) -> tuple[Floats, Floats]:
        """Where the known trajectory has it, and its velocity."""
        return state_at(self.known.rows, t)


class Reserved:
    """The ways that are taken. ``parts`` share one plan; ``movers`` are flown by others, on our clock."""

    def __init__(self, parts: Sequence[Part], downwash: float) -> None:
        self.parts, self.movers, self.ghosts = list(parts), list[MovingObstacle](), list[Part]()
        """ghosts: vehicles of an earlier plan that follow us no more"""
        self.fresh: dict[str, Entry] = {}
        """by vehicle: what is about to be sent, and is in nobody's part yet"""
        self._inverse = 1.0 / downwash

    def blocker(self, part: Part, entry: Entry, since: float) -> str | None:
        """Who could come too near to ``part`` on ``entry`` from ``since`` on; None: it is clear of everybody."""
        return self._vehicle(part, entry, since) or self._mover(part, entry, since)

    def is_better(self, part: Part, entry: Entry, since: float) -> bool:
        """It is clear of all vehicles of the plan and nearer to nothing that moves by itself than that allows, but to
        what comes too near to what ``part`` flies now, too, and from each of that it is farther: where neither is
        clear, to come to rest is better than to go on.
        """
        if self._vehicle(part, entry, since) is not None:
            return False
        for mover in self.movers:
            distance = self._away(entry, mover, since)
            if distance < part.need + mover.radius and distance <= self._away(part.known, mover, since):
                return False
        return True

    def _vehicle(self, part: Part, entry: Entry, since: float) -> str | None:
        everybody: list[Part] = [*self.parts, *self.ghosts]
        for other in everybody:
            if other is part:
                continue
            need = part.need + other.need - TOUCH
            inverse = self._inverse if other.active else 0.0  # it may land or climb: the whole column is taken
            fresh = self.fresh.get(other.id)
            entries = other.entries if fresh is None else [*other.entries, fresh]
            if any(self._meet(entry, each, need, inverse, since) for each in entries):
                return other.id
            if other.place is not None and _near(entry.samples, other.place, need, since):
                return other.id
        return None

    def blocked_by_mover(self, part: Part, now: float) -> str | None:
        """Who, of what moves by itself, comes too near to what ``part`` may be flying."""
        for entry in part.entries:
            if who := self._mover(part, entry, now):
                return who
        return None

    def _mover(self, part: Part, entry: Entry, since: float) -> str | None:
        for mover in self.movers:
            if self._away(entry, mover, since) < part.need + mover.radius:
                return mover.id
        return None

    def _away(self, entry: Entry, mover: MovingObstacle, since: float) -> float:
        """m between their centres, at least, from ``since`` on."""
        distance, _ = least_between(entry.samples, mover.motion, self._inverse, False, mover.leaves, since)
        return float(distance)

    def _meet(self, one: Entry, other: Entry, need: float, inverse: float, since: float) -> bool:
        a, b = one.box, other.box
        if max(a[0] - b[3], b[0] - a[3], a[1] - b[4], b[1] - a[4]) > need:
            return False
        if max(a[2] - b[5], b[2] - a[5]) * inverse > need:
            return False
        distance, _ = least_between(one.samples, other.samples, inverse, False, False, since)
        return bool(distance < need)


def _near(samples: Floats, place: Floats, need: float, since: float) -> bool:
    """The way comes within ``need`` of the column through ``place``."""
    still = np.array([[since, *place]])
    distance, _ = least_between(samples, still, 0.0, False, False, since)
    return bool(distance < need)


class Order:
    """Who passes a place before whom, by the plan: no vehicle goes where another is to pass first and has not.

    Executions that keep this order come to their end however unevenly they go on, for no two wait for each other
    (action dependency graphs: Hönig et al. 2019, "Persistent and Robust Execution of MAPF Schedules in Warehouses").
    """

    def __init__(self, parts: Sequence[Part], downwash: float) -> None:
        end = max((part.track.end for part in parts), default=0.0)
        self.count = int(np.ceil(end / GRAIN)) + 1
        moments = np.arange(self.count, dtype=np.float64) * GRAIN
        places = np.zeros((len(parts), self.count, 3))
        for i, part in enumerate(parts):
            places[i] = part.track.at(moments)[0]
        places[:, :, 2] /= downwash
        needs = np.array([part.radius + part.margin for part in parts])
        steps = np.linalg.norm(np.diff(places, axis=1), axis=2)
        ways = np.zeros((len(parts), self.count))
        ways[:, 1:] = np.cumsum(steps, axis=1)
        longest = steps.max(axis=1, initial=1e-3)
        # 2 bytes as long as they will do: 500 vehicles for 390 s take 0.8 GB of the agent's process.
        kind = np.int16 if self.count <= np.iinfo(np.int16).max else np.int32
        self.first = np.empty((len(parts), len(parts), self.count), dtype=kind)
        """(N, N, M): the last moment at which another is where one is at some later moment up to this one; -1: never"""
        for k in range(len(parts)):
            self.first[k] = _dependencies(places, ways, longest, needs, k, ABREAST)

    def allows(self, who: int, stop: float, stops: Floats) -> int | None:
        """The index of one who must pass before ``who`` goes on to ``stop``; None: it may. ``stops``: how far each is
        sure to come.
        """
        grain = min(int(np.ceil(stop / GRAIN - 1e-9)), self.count - 1)
        row = self.first[who, :, grain]
        late = np.flatnonzero((row >= 0) & ((row + 1) * GRAIN > stops + 1e-6))
        return int(late[0]) if len(late) else None


@jit
def _dependencies(
    places: Floats, ways: Floats, longest: Floats, needs: Floats, k: int, abreast: int
) -> NDArray[np.int32]:
    """(N, M): the last moment at which another is where ``k`` is at some later moment up to this one; -1: never.

    ``longest``: (N,) m that each goes from moment to moment at most, so that those far apart need few looks. ``ways``:
    (N, M) m that each has gone by each moment, so that those at rest do.
    """
    n, count = places.shape[0], places.shape[1]
    found = np.full((n, count), -1, dtype=np.int32)
    for i in range(n):
        if i == k:
            continue
        need, last = needs[k] + needs[i], -1
        for b in range(count):
            x, y, z = places[k, b, 0], places[k, b, 1], places[k, b, 2]
            a = b - abreast
            while a > last:
                dx, dy, dz = places[i, a, 0] - x, places[i, a, 1] - y, places[i, a, 2] - z
                gap = np.sqrt(dx * dx + dy * dy + dz * dz) - need
                if gap < 0.0:
                    last = a
                    continue
                before = a - max(1, int(min(gap / longest[i], 1e6)))
                if before > last and ways[i, a] - ways[i, before] <= 0.5 * gap:
                    # It hardly moved: to the last moment from which its way up to here is longer than the gap.
                    before = np.searchsorted(ways[i, :a], ways[i, a] - gap) - 1
                a = before
            found[i, b] = last
    return found
