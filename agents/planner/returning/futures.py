"""What each vehicle may still do when nothing reaches it any more, and whether something is clear of all of it.

A vehicle ends what it is committed to, rests there, and then flies the way home that came with it; without one, or
where it cannot fly it, it lands where it rests. What it was sent may have arrived or not, so that it may have stored
any of several ways until it says which. The rule is the executor's: whatever one may be doing is separated from
whatever any other may be doing. Nothing here waits, sends or reads a clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agents.planner.execute.commit import TAKING, Entry, Part, Stamp
from agents.planner.execute.offset import DRIFT
from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.separation import least_between
from agents.planner.returning.ways import Way

TOUCH = 0.02
"""m: what the samples of a way are off the curve that is flown"""


@dataclass(eq=False)
class StoredWay:
    """What may be aboard since something was sent: the way home, or that there is none."""

    way: Way | None
    need: float
    """m that nothing else's may come nearer than, with its own need"""
    ends: float
    """when the segment ends that it was sent with (our clock): what tells two of them apart"""
    stamps: list[Stamp] = field(default_factory=list)
    deadline: float = -np.inf
    """after which no vehicle takes it any more, by the vehicle's clock"""
    entry: Entry | None = None
    """what it was sent with; None: long ago"""


def need_of(part: Part, speed: float, lasts: float) -> float:
    """m for a vehicle at ``speed``, whose clock drifts for ``lasts`` s more without a word."""
    return part.radius + part.margin + speed * (part.error + DRIFT * max(lasts, 0.0)) + TOUCH


class Futures:
    """Of all vehicles that are under way. ``downwash``: as in plans."""

    def __init__(self, downwash: float) -> None:
        self._inverse = 1.0 / downwash
        self._downwash = downwash
        self.parts: dict[str, Part] = {}
        self.stored: dict[str, list[StoredWay]] = {}
        self.fresh: dict[str, list[Entry]] = {}
        """what is about to be sent, and is in nobody's part yet"""

    # What is heard.

    def heard(self, vehicle: str, stamp: Stamp | None, said: float) -> None:
        """It said at ``said`` (its clock) which segment it is on; None: none of ours, so that it may be on its way
        home.
        """
        ways = self.stored.get(vehicle)
        if not ways or stamp is None:
            return
        on = next((i for i, each in enumerate(ways) if stamp in each.stamps), 0)
        if kept := [each for each in ways[on:] if not _refused(each, stamp, said)]:
            self.stored[vehicle] = kept

    def forget(self, vehicle: str) -> None:
        """It is down, or somebody else has it: it flies nothing of ours."""
        self.parts.pop(vehicle, None)
        self.stored.pop(vehicle, None)
        self.fresh.pop(vehicle, None)

    def unsent(self) -> None:
        """Forget what was made and not sent after all."""
        self.fresh.clear()
        for vehicle, ways in self.stored.items():
            self.stored[vehicle] = [each for each in ways if each.stamps]

    # What is asked.

    def of(self, vehicle: str) -> Iterator[StoredWay]:
        return iter(self.stored.get(vehicle, ()))

    def entries(self, vehicle: str) -> Iterator[Entry]:
        """All that it may be committed to."""
        part = self.parts.get(vehicle)
        if part is not None:
            yield from part.entries
        yield from self.fresh.get(vehicle, ())

    def below(self, vehicle: str, way: Way, need: float) -> str | None:
        """Whose column it would come into, whenever it is flown: where another rests, and would land, or lands at the
        end of a way home; or who would come into its own.
        """
        for other, part in self.parts.items():
            if other == vehicle:
                continue
            for entry in self.entries(other):
                if self._below(way, entry.samples[-1, 1:], need + part.need):
                    return other
            if part.off and part.place is not None:  # somebody else has it: where it was seen last, at any height
                sky = np.array([*part.place[:2], np.inf])
                if self._below(way, sky, need + part.need):
                    return other
        end = way.corners[-1]
        for other, home, needs in self._others(vehicle):
            both = need + needs
            if self._below(way, home.corners[-1], both) or self._below(home, end, both):
                return other
        return None

    def in_the_way_of(self, vehicle: str, way: Way, need: float, movers: Sequence[MovingObstacle] = ()) -> str | None:
        """Who may come too near to ``vehicle`` on that way home; None: together with :meth:`below` it is clear of all
        that anybody may do.
        """
        since, motion = way.begins, way.motion
        for other, part in self.parts.items():
            if other == vehicle:
                continue
            for entry in self.entries(other):
                both = need + part.need
                if self._near(way.boxes, entry.box, both) and self._meet(motion, entry.samples, both, since):
                    return other
        for other, home, needs in self._others(vehicle):
            both, boxes = need + needs, home.boxes.tolist()
            near = any(self._near(way.boxes, tuple(box), both) for box in boxes)
            if near and self._meet(motion, home.motion, both, since):
                return other
        for mover in movers:
            if mover.id not in self.parts and self._meet(motion, mover.motion, need + mover.radius, since):
                return mover.id
        return None

    def blocker(self, part: Part, entry: Entry, since: float) -> str | None:
        """Whose way home would come too near to ``part`` on ``entry``, or to where it would land at its end."""
        for other, home, needs in self._others(part.id):
            need, begins = part.need + needs, max(since, home.begins)
            if self._below(home, entry.samples[-1, 1:], need):
                return other
            if self._near(home.boxes, entry.box, need) and self._meet(home.motion, entry.samples, need, begins):
                return other
        return None

    def movers(self, vehicles: Iterable[str]) -> list[MovingObstacle]:
        """The ways home of these, on our clock."""
        return [
            MovingObstacle(name, each.way.motion, each.need)
            for name in vehicles
            for each in self.stored.get(name, ())
            if each.way is not None
        ]

    # How it is done.

    def _others(self, vehicle: str) -> Iterator[tuple[str, Way, float]]:
        """Every way home that another may have stored, with its need."""
        for other, ways in self.stored.items():
            if other != vehicle:
                yield from ((other, each.way, each.need) for each in ways if each.way is not None)

    def _meet(self, one: Floats, other: Floats, need: float, since: float) -> bool:
        distance, _ = least_between(one, other, self._inverse, False, False, since)
        return bool(distance < need)

    def _near(self, boxes: Floats, box: tuple[float, ...], need: float) -> bool:
        """One of the ``boxes`` (L, 6) comes so near to the other one."""
        return bool(np.any(_gaps(boxes, box, need, self._downwash)))

    def _below(self, way: Way, place: Floats, need: float) -> bool:
        """Some of the way is beside or below ``place``, so near that who lands there would meet it."""
        top = float(place[2]) + need * self._downwash
        column = (float(place[0]), float(place[1]), -np.inf, float(place[0]), float(place[1]), float(place[2]))
        for k in np.flatnonzero(_gaps(way.boxes, column, need, self._downwash)):
            a, b = way.corners[k], way.corners[k + 1]
            along, off = b[:2] - a[:2], place[:2] - a[:2]
            square = float(along @ along)
            share = min(1.0, max(0.0, float(off @ along) / square)) if square > 0.0 else 0.0
            flat = float(np.hypot(*(off - share * along)))
            if flat < need:
                reach = self._downwash * float(np.sqrt(need * need - flat * flat))
                if min(a[2], b[2]) < min(top, float(place[2]) + reach):
                    return True
        return False


def _refused(each: StoredWay, stamp: Stamp, said: float) -> bool:
    """It flies another one, and takes this one no more."""
    return bool(each.stamps) and stamp not in each.stamps and said > each.deadline + TAKING


def _gaps(boxes: Floats, box: tuple[float, ...], need: float, downwash: float) -> NDArray[np.bool_]:
    room = np.array([need, need, need * downwash])
    near: NDArray[np.bool_] = np.all((boxes[:, :3] - room < box[3:]) & (boxes[:, 3:] + room > box[:3]), axis=1)
    return near
