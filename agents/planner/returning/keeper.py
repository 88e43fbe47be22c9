"""Has everybody's way home ready: each segment that is put takes one along that is clear of all that anybody may do.

The conductor asks here before it commits a vehicle (nobody is sent where another's way home leads), and when it puts
something (what the vehicle does if nothing else comes). A way that is in the way of the plan gives way: another is sent
with the same segment, or none.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from agents.planner.execute.commit import Entry, Part, Stamp
from agents.planner.model.problem import Floats
from agents.planner.returning.finder import Finder, Returner, Surroundings
from agents.planner.returning.futures import Futures, StoredWay, need_of
from agents.planner.returning.ways import SHARE, Way

SAME = 0.01
"""s within which two segments end at once"""
LATER = 0.05
"""s by which one follows later, or less late, than its way home was made for, before it is sent another"""
SLACK = 0.3
"""s later than it must that a way begins: ends are rounded on the wire, and a clock is off by what is known besides"""
ASKED = 3.0
"""s for which a way that is to give way does so"""
YIELD_EVERY = 0.5
"""s between two messages that make one give way"""
PATIENT = 15.0
"""s without a way home after which that is told"""
LASTING = 200.0
"""s without a word for which clocks are reckoned with"""
LOOK, SPARSE = 1.0, 4
"""s between two looks at where plans lead; of a plan's samples every so many are looked at"""
BELOW = 1.0
"""m more than needed between what is flown and the lowest layer"""

Returners = Callable[[], Mapping[str, Returner]]
Around = Callable[[Sequence[str], float, float], Surroundings]
"""is told the vehicles of the plan, the height above which layers begin, and their spacing"""
Tell = Callable[[str, str], None]
"""is told the vehicle, and why it has no way home; empty: it has one again"""


class ReturnKeeper:
    """One for all that a planner flies. ``returners``: who flies home by itself (``return = "together"``), with what is
    known of it; ``around``: what else there is.
    """

    def __init__(self, downwash: float, returners: Returners, around: Around, tell: Tell) -> None:
        self.futures = Futures(downwash)
        self._downwash, self._returners, self._around, self._tell = downwash, returners, around, tell
        self._room: Surroundings | None = None
        self._who: Mapping[str, Returner] | None = None
        self._wishes: dict[str, tuple[Part, Entry, float]] = {}
        """by the vehicle whose way is in the way: who would go where, since when"""
        self._yielded: dict[str, float] = {}
        self.last: dict[str, Way] = {}
        """the newest way of each"""
        self._missing: dict[str, float] = {}
        """since when each has none; those of whom that was told"""
        self._told: set[str] = set()
        self._layers: dict[str, int] = {}
        """which layer each has, counted from the lowest"""
        self._busy: dict[str, Floats] = {}
        self._looked = -np.inf
        self.found = self.none = 0
        """how often there was a way, and how often none"""

    # What the conductor asks: :meth:`begin`, then the others for each vehicle, then :meth:`sent` for what was put.

    def begin(self, parts: Sequence[Part], now: float) -> None:
        """What follows is decided at ``now``, for these."""
        self.futures.unsent()
        for part in parts:
            self.futures.parts[part.id] = part
        self._who = self._room = None
        self._wishes = {who: wish for who, wish in self._wishes.items() if now - wish[2] < ASKED}

    def blocker(self, part: Part, entry: Entry, now: float) -> str | None:
        who = self.futures.blocker(part, entry, now)
        if who is not None:
            self._wishes[who] = (part, entry, now)
        return who

    def yields(self, part: Part, now: float) -> bool:
        """Its way home is in the way of another's plan: it is to be sent something else."""
        wish = self._wishes.get(part.id)
        if wish is None or now - self._yielded.get(part.id, -np.inf) < YIELD_EVERY:
            return False
        return self._hinders(part, *wish[:2])

    def home(self, part: Part, entry: Entry, ends: float, now: float) -> Way | None:
        """The way home to go along with what is put now, which is ``entry``, ends at ``ends`` and rests there."""
        futures = self.futures
        if not any(entry is each for each in futures.entries(part.id)):
            futures.fresh.setdefault(part.id, []).append(entry)
        ways = futures.stored.setdefault(part.id, [])
        last = ways[-1] if ways else None
        wish = self._wishes.get(part.id)
        yields = wish is not None and self._hinders(part, *wish[:2])
        if last is None or last.entry is not entry or abs(last.ends - ends) > SAME or yields or _other(last, part):
            if yields:
                self._yielded[part.id] = now
            last = self._made(part, entry, ends, now)
            ways.append(last)
        return last.way

    def sent(self, part: Part, stamp: Stamp, deadline: float) -> None:
        """What :meth:`home` was asked for last was put."""
        last = self.futures.stored[part.id][-1]
        last.stamps.append(stamp)
        last.deadline = max(last.deadline, deadline)

    def heard(self, part: Part, stamp: Stamp | None, said: float) -> None:
        self.futures.heard(part.id, stamp, said)

    # What becomes of vehicles.

    def forget(self, vehicle: str) -> None:
        """It is down, or somebody else has it: it flies nothing of ours. Its layer is free for another."""
        self.futures.forget(vehicle)
        self._layers.pop(vehicle, None)
        self._yielded.pop(vehicle, None)
        self.idle(vehicle)

    def drop(self, vehicle: str) -> None:
        """As :meth:`forget`, and it is gone for good: nothing is known of it any more."""
        self.forget(vehicle)
        self.last.pop(vehicle, None)

    def idle(self, vehicle: str) -> None:
        """Its plan goes on, and it rests: it has no way home until it flies on, and that is not missed."""
        self.futures.stored.pop(vehicle, None)
        self._missing.pop(vehicle, None)
        self._told.discard(vehicle)

    # How it is done.

    def _hinders(self, part: Part, other: Part, wanted: Entry) -> bool:
        """Its newest way would meet the other one there."""
        ways = self.futures.stored.get(part.id)
        if not ways or ways[-1].way is None:
            return False
        before, self.futures.stored = self.futures.stored, {part.id: ways[-1:]}
        try:
            return self.futures.blocker(other, wanted, -np.inf) is not None
        finally:
            self.futures.stored = before

    def _made(self, part: Part, entry: Entry, ends: float, now: float) -> StoredWay:
        who = self._who = self._returners() if self._who is None else self._who
        one = who.get(part.id)
        if one is None:
            return StoredWay(None, part.need, ends, entry=entry)
        need = need_of(part, SHARE * one.pace.speed, LASTING)
        before = self.last[part.id].corners[-1] if part.id in self.last else None
        added = [(who.id, wanted) for who, wanted, _ in self._wishes.values() if who.id != part.id]
        for other, wanted in added:  # where others want to go counts as if they were about to
            self.futures.fresh.setdefault(other, []).append(wanted)
        try:
            others = [each.home for name, each in who.items() if name != part.id]
            room, busy = self._around_all(need), self._busy_for(part.id, now)
            finder = Finder(part.id, one, room, self.futures, need, others=others, busy=busy, late=part.late)
            ready = ends + one.after + part.error + SLACK
            way = finder.find(entry.rows[-1, 1:4], ready, now, self._layer(part.id), before)
        finally:
            for other, wanted in added:
                self.futures.fresh[other] = [each for each in self.futures.fresh[other] if each is not wanted]
        self._count(part.id, way, finder.why, now)
        return StoredWay(way, need, ends, entry=entry)

    def _count(self, vehicle: str, way: Way | None, why: str, now: float) -> None:
        """Who has none for long is told of: as vehicles set off side by side that is usual for seconds."""
        if way is not None:
            self.found += 1
            self.last[vehicle] = way
            self._missing.pop(vehicle, None)
            if vehicle in self._told:
                self._told.discard(vehicle)
                self._tell(vehicle, "")
            return
        self.none += 1
        since = self._missing.setdefault(vehicle, now)
        if vehicle not in self._told and now - since >= PATIENT:
            self._told.add(vehicle)
            self._tell(vehicle, why)

    def _layer(self, vehicle: str) -> int:
        if vehicle not in self._layers:
            taken = set(self._layers.values())
            self._layers[vehicle] = next(layer for layer in itertools.count() if layer not in taken)
        return self._layers[vehicle]

    def _busy_for(self, vehicle: str, now: float) -> Floats:
        """(K, 2): where the plans of the others lead from now on."""
        if not 0.0 <= now - self._looked < LOOK:
            self._looked = now
            self._busy = {}
            for name, part in self.futures.parts.items():
                (s,), _ = part.known.profile.at(np.array([now]))
                ahead = part.track.pos[part.track.s >= s]
                moves = len(ahead) > 1 and bool(np.ptp(ahead[:, :2], axis=0).max() > SAME)
                self._busy[name] = ahead[::SPARSE, :2] if moves else np.empty((0, 2))
        found = [each for name, each in self._busy.items() if name != vehicle]
        return np.vstack(found) if found else np.empty((0, 2))

    def _around_all(self, need: float) -> Surroundings:
        """Layers begin above all that is or will be flown."""
        if self._room is None:
            parts = self.futures.parts.values()
            widest = max([need, *(part.need for part in parts)])
            spacing = 2.0 * widest * self._downwash
            top = max(float(part.track.pos[:, 2].max()) for part in parts)
            self._room = self._around(list(self.futures.parts), top + spacing + BELOW, spacing)
        return self._room


def _other(stored: StoredWay, part: Part) -> bool:
    """It follows the way that it has otherwise than was known when that was made."""
    return stored.way is not None and abs(stored.way.late - part.late) > LATER
