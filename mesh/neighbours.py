"""Whom a router is to be linked with by name, and through which radios each can be reached."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from mesh.profiles import PROFILES, Rules
from mesh.radios import FoundRadio, stand
from zmav.config import FleetConfig, Host, Radio, StationConfig, VehicleConfig
from zmav.errors import BadConfig

FULL = 8
"""hosts of which each may call each. Among more, each is linked with a few: see :func:`few`"""


@dataclass(frozen=True)
class Way:
    """One way to a neighbour: out of our radio, to its address."""

    radio: Radio
    address: str
    port: int


@dataclass(frozen=True)
class Neighbour:
    """A host that our router is to be linked with by name."""

    name: str
    ways: tuple[Way, ...]
    """the cheapest first"""
    endpoints: tuple[str, ...] = ()
    """where else it listens, as the fleet file has it under its ``listen``"""
    calls: bool = True
    """we call it; False: it calls us. Two that call each other keep two connections, at twice the cost"""


def neighbours(
    file: FleetConfig, name: str, host: Host, radios: Sequence[FoundRadio], rules: Rules
) -> tuple[Neighbour, ...]:
    """Those that ``host`` names, or those on its radios' networks where the profile calls all: a few of a large fleet.

    Raises :class:`BadConfig` for one that the file names and no radio of ours reaches.
    """
    if host.neighbours is None:
        return tuple(_some(file, name, radios)) if rules.calls_all else ()
    return tuple(_named(file, name, each, radios) for each in host.neighbours if "/" not in each)


def _some(file: FleetConfig, name: str, radios: Sequence[FoundRadio]) -> Iterator[Neighbour]:
    seen = {each.name: each for each in _all(file, name, radios)}
    for other in few(seen, name):
        # It calls us if its own file, which is ours, tells it so; its radios are taken to be as they are written.
        theirs = [stand(radio, {}) for radio in file.host(other).mesh.radios]
        told = [each.name for each in _all(file, other, theirs)]
        waits = not seen[other].calls and name in few(told, other)
        yield replace(seen[other], calls=not waits)


def few(others: Collection[str], name: str) -> list[str]:
    """Which of many hosts on one network ``name`` is linked with, so that all are joined and any few may be away.

    The hosts stand in a ring by name, and each is linked with those 1, 3, 9, ... places before and behind it: the
    steps of Chord (Stoica et al. 2001) with 3 for 2. Zenoh's routers flood their link
    states over every link: 30 of them on two cores formed 90 such links in 1.1 s with 2.5 MB, and kept 59 kB/s when
    idle; the 435 of a full mesh took 8.7 s and 36 MB, and came and went from then on, with 1.6 MB/s.
    """
    if len(others) < FULL:
        return list(others)
    ring = sorted({*others, name})
    place, size, step = ring.index(name), len(ring), 1
    linked: set[str] = set()
    while 2 * step <= size:
        linked |= {ring[(place + step) % size], ring[(place - step) % size]}
        step *= 3
    return [other for other in others if other in linked]


def _named(file: FleetConfig, name: str, other: str, radios: Sequence[FoundRadio]) -> Neighbour:
    table = file.host(other)
    ways = _ways(file, table, radios)
    waiting = [radio.name for radio in radios if radio.address is None]
    if not ways and not table.listen and not waiting:
        theirs = [radio.address for radio in table.mesh.radios if radio.address]
        ours = ", ".join(str(radio.address.network) for radio in radios if radio.address) or "none"
        where = f"its addresses ({', '.join(theirs)}) are" if theirs else "it has no address that is"
        text = (
            f"{name} cannot reach its neighbour {other}: {where} in none of {name}'s networks ({ours}). Give both an "
            f'address with the network\'s size (address = "10.77.0.1/16"), or name an endpoint instead'
        )
        raise BadConfig(text, field="neighbours", value=other, expected=f"an address in {ours}")
    return Neighbour(other, ways, tuple(table.listen), calls=name < other or not _calls(file, other, name))


def _all(file: FleetConfig, name: str, radios: Sequence[FoundRadio]) -> Iterator[Neighbour]:
    for place, table in file.hosts().items():
        other = place.partition(".")[2]
        if other == name:
            continue
        wanted = table.mesh.neighbours
        if (wanted is not None and name not in wanted) or not PROFILES[file.profile_of(table.mesh)].listens:
            continue  # it has said whom it wants, or cannot be called
        ways = _ways(file, table, radios)
        if ways:
            yield Neighbour(other, ways, calls=name < other or not _calls(file, other, name))


def _calls(file: FleetConfig, name: str, other: str) -> bool:
    """Whether the host ``name`` takes ``other`` for a neighbour that it can call, as far as the file says."""
    table, far = file.host(name), file.host(other)
    wanted, rules = table.mesh.neighbours, PROFILES[file.profile_of(table.mesh)]
    if other not in wanted if wanted is not None else not rules.calls_all:
        return False
    theirs, ours = ([radio.ip() for radio in each.mesh.radios] for each in (table, far))
    return bool(far.listen and not any(ours)) or any(a and b and b.ip in a.network for a in theirs for b in ours)


def _ways(file: FleetConfig, table: VehicleConfig | StationConfig, radios: Sequence[FoundRadio]) -> tuple[Way, ...]:
    found = []
    for mine in radios:
        for theirs in table.mesh.radios:
            address = theirs.ip()
            if mine.address and address and address.ip in mine.address.network:
                cost = mine.radio.way_cost() + theirs.way_cost()
                found.append((cost, Way(mine.radio, str(address.ip), theirs.port or file.mesh.port)))
    return tuple(way for _, way in sorted(found, key=lambda each: each[0]))
