"""How it stands with each message between an autopilot and its readers, and the table that shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from zmav import wire
from zmav.services.rates.meter import Kind, Measured
from zmav.services.rates.plan import Target


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
