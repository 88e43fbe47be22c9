"""What each message should flow at: the floor, the readers, what the link has room for; and how it stands with it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from zmav import wire
from zmav.mavlink import Dialect
from zmav.services.rates.demand import Demand
from zmav.services.rates.meter import Kind, Measured

FULL, ROOM = 0.9, 0.8
"""of the link's capacity: more than the first is too much, and below the second what was slowed comes back"""
PATIENCE = 3.0
"""s of too much, or of room again, before anything changes; who comes new is judged at once"""
ENOUGH = 0.8
"""of a rate: this much counts as having it"""


TRICKLE_HZ = 0.5
"""what every reader keeps, where even that fits or not: a value that is two seconds old beats none"""


@dataclass
class Target:
    """One message somebody wants."""

    name: str
    floor: float = 0.0
    """Hz that are never shed"""
    hz: float = 0.0
    """what is wanted"""
    granted: float = 0.0
    """what is asked for"""
    readers: list[str] = field(default_factory=list)
    explicit: bool = False

    @property
    def shed(self) -> bool:
        return self.granted < 0.99 * self.hz


def wanted(floor: Mapping[str, float], own: Mapping[str, float], demands: Mapping[str, list[Demand]]) -> list[Target]:
    """Everything wanted, the floor first; ``own`` is what the companion's clock wants."""
    targets: dict[str, Target] = {}
    for reader, rates in (("floor", floor), ("clock", own)):
        for name, hz in rates.items():
            target = targets.setdefault(name, Target(name))
            target.floor = target.hz = max(target.hz, hz)
            target.readers.append(reader)
    for name, readers in demands.items():
        target = targets.setdefault(name, Target(name))
        target.hz = max(target.hz, *(reader.hz for reader in readers))
        target.readers += sorted({reader.reader for reader in readers})
        target.explicit = any(reader.explicit for reader in readers)
    for target in targets.values():
        target.granted = target.hz
    return list(targets.values())


class Shedder:
    """Slows what is least wanted while the link is full, and lets it come back when there is room again."""

    def __init__(self, dialect: Dialect, now: Callable[[], float] = time.monotonic) -> None:
        self._dialect, self._now = dialect, now
        self._granted: dict[str, float] = {}
        self._wanted: dict[str, float] = {}
        self._since: float | None = None

    def apply(
        self, targets: list[Target], flows: Mapping[str, Measured], used: float, ours: set[str], capacity: float | None
    ) -> None:
        """Set what each target is granted.

        ``flows`` is what comes from the autopilot now, ``used`` all bytes a second on the link, ``ours`` the messages
        that were asked for: those will flow as granted, all else as it does.
        """
        if capacity is None:
            self._granted.clear()
            return
        counted = [t for t in targets if t.name in ours or _lacks(t, flows)]
        other = used - sum(flows[t.name].bytes_rate for t in counted if t.name in flows)
        fixed = max(other, 0.0) + sum(t.floor * self._size(t.name, flows) for t in counted)
        wants = [
            Want(t.name, t.hz - t.floor, self._size(t.name, flows), len(t.readers), t.explicit)
            for t in counted
            if t.hz > t.floor
        ]
        new = self._changed({want.name: want.hz for want in wants})
        granted = self._judge(wants, fixed, capacity, new)
        for target in targets:
            if target.name in granted:
                target.granted = target.floor + granted[target.name]

    def _changed(self, now: dict[str, float]) -> bool:
        before, self._wanted = self._wanted, now
        return before != now

    def _judge(self, wants: list[Want], fixed: float, capacity: float, new: bool) -> dict[str, float]:
        current = {want.name: min(self._granted.get(want.name, want.hz), want.hz) for want in wants}
        if new:  # a reader who left may have been what was slowed
            current = {want.name: want.hz for want in wants}
        cost = fixed + sum(current[want.name] * want.size for want in wants)
        slowed = any(current[want.name] < 0.99 * want.hz for want in wants)
        better = share(wants, ROOM * capacity - fixed)
        if cost > FULL * capacity:
            if new or self._lasts():
                current = share(wants, FULL * capacity - fixed)
        elif slowed and _sum(wants, better) > 1.05 * _sum(wants, current):
            if self._lasts():
                current = better
        else:
            self._since = None
        self._granted = current
        return current

    def _lasts(self) -> bool:
        """It has been so for long enough; asked again from then on."""
        now = self._now()
        if self._since is None:
            self._since = now
        if now - self._since < PATIENCE:
            return False
        self._since = None
        return True

    def _size(self, name: str, flows: Mapping[str, Measured]) -> float:
        """Mean bytes a frame; before any came, those of a whole one."""
        if name in flows:
            return flows[name].size
        message = self._dialect.by_name.get(name)
        return 12.0 + (message.base_length if message else 64)


def _lacks(target: Target, flows: Mapping[str, Measured]) -> bool:
    """It does not flow by itself as fast as wanted."""
    return target.name not in flows or flows[target.name].hz < ENOUGH * target.hz


def _sum(wants: list[Want], rates: Mapping[str, float]) -> float:
    return sum(rates[want.name] * want.size for want in wants)


class Want(NamedTuple):
    """One message that may be slowed."""

    name: str
    hz: float
    size: float
    """mean bytes a frame"""
    readers: int
    explicit: bool
    """somebody said the rate; False: it is only taken to be wanted at it"""

    @property
    def trickle(self) -> float:
        return min(self.hz, TRICKLE_HZ)


def share(wants: list[Want], room: float) -> dict[str, float]:
    """Rates in Hz that fit into ``room`` bytes a second.

    First everything gets its trickle, then the most wanted get what they want as long as it lasts: those with a rate of
    their own before others, those with more readers first, and of equals the cheaper, so that more of them stay whole.
    """
    left = room - sum(want.trickle * want.size for want in wants)
    rates = {}
    for want in sorted(wants, key=lambda w: (not w.explicit, -w.readers, w.hz * w.size, w.name)):
        more = min(want.hz - want.trickle, max(left, 0.0) / want.size)
        rates[want.name] = want.trickle + more
        left -= more * want.size
    return rates


@dataclass
class RequestedRate:
    """How it stands with one message between us and the autopilot."""

    asked: float | None = None
    """Hz"""
    refused: str | None = None
    final: bool = False
    """refused for good"""
    ceiling: float = math.inf
    """Hz; more was denied"""
    not_before: float = 0.0
    """monotonic seconds"""
    pause: float = 1.0
    since: float = 0.0
    """when it was asked for last"""
    forgotten: bool = False
    """the autopilot has restarted since it was asked"""
    tries: int = 0
    """to leave it to the autopilot again"""

    def rate(self, target: Target) -> float:
        """What to ask for, in Hz."""
        return min(target.granted, self.ceiling)


def rows(
    measured: Mapping[Kind, Measured],
    autopilot: tuple[int, int] | None,
    targets: Sequence[Target],
    standings: Mapping[str, RequestedRate],
) -> list[wire.MessageRate]:
    """Everything heard, by name and source, then what is wanted from the autopilot and was never heard."""
    wanted = {target.name: target for target in targets}
    found, seen = [], set()
    for (name, sysid, compid), m in sorted(measured.items()):
        row = wire.MessageRate(
            name=name, sysid=sysid, compid=compid, hz=m.hz, bytes_rate=m.bytes_rate, count=m.total, age=m.age
        )
        if (sysid, compid) == autopilot:
            seen.add(name)
            _add_wish(row, wanted.get(name), standings.get(name))
        found.append(row)
    for name, target in sorted(wanted.items()):
        if name not in seen:
            row = wire.MessageRate(name=name, hz=0.0, bytes_rate=0.0, count=0)
            _add_wish(row, target, standings.get(name))
            found.append(row)
    return found


def _add_wish(row: wire.MessageRate, target: Target | None, standing: RequestedRate | None) -> None:
    if standing is not None:
        row.asked_hz, row.refused = standing.asked, standing.refused
    if target is not None:
        row.wanted_hz, row.readers, row.shed = target.hz, target.readers, target.shed
