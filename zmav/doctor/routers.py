"""What ``zmav doctor`` says of routers, and of the links between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib.metadata import version

import msgspec

from zmav import wire
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.doctor.rules import loss_level
from zmav.doctor.survey import Survey

FAIR_COST, POOR_COST = 3_000, 15_000
"""as ``zmav mesh graph`` colours them: 30 and 150 ms a kilobyte, one way"""
STATES = ("up", "silent", "down")
NEARER = "look at antennas, distance, channel and power; 'zmav mesh graph --watch' shows it while you move one"


def check_routers(seen: Survey) -> Iterator[Finding]:
    if not seen.routers:
        advice = "its admin space is off: set adminspace.enabled in its Zenoh configuration"
        yield topics.ROUTER.wrong("one answers, but tells nothing about itself that can be read", advice)
    names = {v.last_state.instance: v.name for v in seen.vehicles if v.last_state}
    names |= {token["instance"]: token["vehicle"] for token in seen.tokens if token["role"] == "router"}
    ours = version("eclipse-zenoh")
    for router in seen.routers:
        links = [link["whatami"] for link in router["links"]]
        who = names.get(router["zid"], router["zid"][:8])
        found = f"linked routers: {links.count('router')}, clients: {links.count('client')}"
        if router["version"].split(".")[:2] != ours.split(".")[:2]:
            found += f", Zenoh {router['version']}, but {ours} here"
            yield topics.ROUTER.wrong(found, "install one version of Zenoh everywhere: pip install eclipse-zenoh", who)
        else:
            yield topics.ROUTER.well(f"{found}, on {' '.join(router['locators']) or 'no endpoint'}", who)


class Way(msgspec.Struct, frozen=True):
    """A link between two routers, by the worse of what its ends say; what none says is None."""

    ends: tuple[str, str]
    state: str
    loss: float | None
    rtt: float | None
    cost: int | None
    age: float | None
    """s since a probe came through, at the end that waits longer"""

    @property
    def level(self) -> int:
        """0 good, 1 fair, 2 poor or worse."""
        if self.state == "down" or (self.state == "silent" and self.age is not None):
            return 2
        loss, cost = loss_level(self.loss or 0.0), self.cost or 0
        poor, fair = loss == "bad" or cost >= POOR_COST, loss == "warn" or cost >= FAIR_COST
        return 2 if poor else 1 if fair or self.state == "silent" else 0

    @property
    def rank(self) -> tuple[int, int, float, float]:
        """The weaker, the greater."""
        return self.level, STATES.index(self.state), self.loss or 0.0, self.rtt or 0.0

    @property
    def name(self) -> str:
        return " - ".join(self.ends)

    @property
    def words(self) -> str:
        parts = [self.state]
        if self.loss is not None:
            parts.append(f"{self.loss:.0%} lost")
        if self.rtt is not None:
            parts.append(f"round trip {1e3 * self.rtt:.1f} ms")
        return ", ".join(parts)


def ways(told: Iterable[tuple[tuple[str, str], wire.NeighbourQuality]]) -> list[Way]:
    """Both ends' words on each link put together, the weakest first."""
    said: dict[tuple[str, str], list[wire.NeighbourQuality]] = {}
    for (host, neighbour), quality in told:
        a, b = sorted((host, neighbour))
        said.setdefault((a, b), []).append(quality)
    found = [
        Way(
            ends,
            max((q.state for q in both), key=STATES.index),
            _most(loss for q in both for loss in (q.loss_in, q.loss_out)),
            _most(q.rtt for q in both),
            max((q.cost for q in both if q.cost is not None), default=None),
            _most(q.age for q in both),
        )
        for ends, both in said.items()
    ]
    return sorted(found, key=lambda way: way.rank, reverse=True)


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def check_ways(seen: Survey) -> Iterator[Finding]:
    found = ways(seen.neighbours.items())
    for way in found:
        if way.state == "down":
            yield topics.WAY.wrong(f"{way.words}, within the last minute", f"is that host on? {NEARER}", way.name)
        elif way.state == "silent" and way.age is None:
            advice = "is it a 'zmav router' or a 'zmav up'?"
            yield topics.WAY.advise(f"{way.words}, nothing measured", advice, way.name)
        elif way.level == 2:
            yield topics.WAY.wrong(way.words, NEARER, way.name)
        elif way.level == 1:
            yield topics.WAY.advise(way.words, NEARER, way.name)
    if found and found[0].level == 0:
        yield topics.WEAKEST.well(f"of {len(found)}: {found[0].name}: {found[0].words}")
