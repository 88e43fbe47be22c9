"""From a scenario's names to the relay's numbers, and back: which interface, which channel is whose."""

from __future__ import annotations

import ipaddress
import itertools
import re
from dataclasses import dataclass, field

from mesh.lab.channel import Conditions
from mesh.lab.messages import Begin, EtherSpec, LinkSpec, Pair, SegmentSpec, TapSpec
from mesh.lab.scenario import AnyMedium, Link, RadioChannel, Range, Scenario, Wds, members
from mesh.lab.values import conditions
from zmav.errors import BadConfig


@dataclass(frozen=True)
class Interface:
    """One host's interface on a medium."""

    host: str
    medium: str
    name: str
    address: str


@dataclass(frozen=True)
class Edge:
    """Two that hear each other, with a channel each way: two hosts, or two bridges of a segment."""

    name: str
    """``a-b``, or ``medium:a-b`` where several media join the two"""
    medium: str
    a: str
    b: str
    ab: int
    ba: int
    range: Range | None = None


@dataclass
class Wiring:
    """Everything that the relay is to make."""

    begin: Begin
    hosts: tuple[str, ...]
    interfaces: list[Interface]
    edges: list[Edge]
    media: dict[str, list[Edge]] = field(default_factory=dict)

    def find(self, text: str) -> list[tuple[Edge, tuple[int, ...]]]:
        """The edges called ``text``, each with the channels meant; raises :class:`BadConfig` naming those there are.

        ``quad2-quad3`` or ``quad3-quad2``; ``2-3`` where one host's name ends so; ``quad2>quad3`` for one direction;
        ``wifi:quad2-quad3`` of one medium; a medium's name for all in it; ``all``.
        """
        if text == "all":
            return [(edge, (edge.ab, edge.ba)) for edge in self.edges]
        if text in self.media:
            return [(edge, (edge.ab, edge.ba)) for edge in self.media[text]]
        medium, colon, ends = text.rpartition(":")
        found: list[tuple[Edge, tuple[int, ...]]] = []
        for edge in self.edges:
            if colon and edge.medium != medium:
                continue
            for a, b, ab, ba in ((edge.a, edge.b, edge.ab, edge.ba), (edge.b, edge.a, edge.ba, edge.ab)):
                one_way = any(ends == f"{x}>{y}" for x in _short(a) for y in _short(b))
                if one_way or any(ends == f"{x}-{y}" for x in _short(a) for y in _short(b)):
                    found.append((edge, (ab,) if one_way else (ab, ba)))
                    break
        if len(found) == 1:
            return found
        exact = [(edge, channels) for edge, channels in found if edge.name == text]
        if len(exact) == 1:
            return exact
        names = ", ".join(edge.name for edge, _ in found) if found else ", ".join(edge.name for edge in self.edges)
        what = "several links are called" if found else "no link"
        expected = f"one of {names or 'none'}"
        raise BadConfig(f"{what} {text!r}; expected {expected}", field="link", value=text, expected=expected)


def _short(name: str) -> tuple[str, ...]:
    """A name and the number at its end."""
    number = re.search(r"\d+$", name)
    return (name, number[0]) if number and number[0] != name else (name,)


class _Maker:
    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.hosts = tuple(scenario.hosts)
        self.taps: list[TapSpec] = []
        self.interfaces: list[Interface] = []
        self.channels: list[Conditions] = []
        self.edges: list[Edge] = []
        self.media: list[LinkSpec | SegmentSpec | EtherSpec] = []
        joined = [frozenset(ends) for medium in scenario.media for ends in _ends(medium)]
        self._twice = {ends for ends in joined if joined.count(ends) > 1}

    def add(self, number: int, medium: AnyMedium) -> None:
        addresses = ipaddress.IPv4Network(medium.network or "").hosts()
        length = ipaddress.IPv4Network(medium.network or "").prefixlen
        first = len(self.taps)
        for place, (host, address) in enumerate(zip(members(medium), addresses, strict=False)):
            interface = Interface(host, medium.name or "", medium.interface or "", str(address))
            mac = bytes((0x02, 0x5A, number >> 8, number & 0xFF, place >> 8, place & 0xFF))
            at = self.hosts.index(host)
            self.interfaces.append(interface)
            self.taps.append(TapSpec(at, interface.name, mac, interface.address, length, medium.mtu))
        if isinstance(medium, Link):
            self.media.append(LinkSpec(self._pair(medium, *medium.between, first, first + 1), medium.shared))
        elif isinstance(medium, Wds):
            places = {name: at for at, name in enumerate(medium.bridges)}
            taps = itertools.count(first)
            behind = [[next(taps) for _ in hosts] for hosts in medium.bridges.values()]
            hops = [self._pair(medium, a, b, places[a], places[b]) for a, b in medium.hops]
            self.media.append(SegmentSpec(behind, hops, medium.shared))
        else:
            places = {name: at for at, name in enumerate(members(medium))}
            pairs = [self._pair(medium, a, b, places[a], places[b]) for a, b in _ends(medium)]
            self.media.append(EtherSpec([first + at for at in places.values()], pairs, medium.shared))

    def _pair(self, medium: AnyMedium, a: str, b: str, one: int, other: int) -> Pair:
        base = conditions(Conditions(), medium, medium.name or "")
        ways = []
        for x, y in ((a, b), (b, a)):
            value = base
            for ends in (f"{a}-{b}", f"{b}-{a}", f"{x}>{y}"):
                if ends in medium.ends:
                    value = conditions(value, medium.ends[ends], ends)
            ways.append(len(self.channels))
            self.channels.append(value)
        name = medium.name or "" if isinstance(medium, Link) else f"{a}-{b}"
        if frozenset((a, b)) in self._twice:
            name = f"{medium.name}:{a}-{b}"
        self.edges.append(Edge(name, medium.name or "", a, b, ways[0], ways[1], medium.range))
        return Pair(one, other, ways[0], ways[1])


def _ends(medium: AnyMedium) -> list[tuple[str, str]]:
    if isinstance(medium, Link):
        return [medium.between]
    if isinstance(medium, Wds):
        return medium.hops
    assert isinstance(medium, RadioChannel)
    return medium.pairs if medium.pairs is not None else list(itertools.combinations(members(medium), 2))


def wire(scenario: Scenario, directory: str | None = None) -> Wiring:
    """Number everything of a checked scenario; raises :class:`BadConfig` for ends of no pair of their medium."""
    maker = _Maker(scenario)
    for number, medium in enumerate(scenario.media):
        maker.add(number, medium)
        known = {f"{x}{sign}{y}" for a, b in _ends(medium) for x, y in ((a, b), (b, a)) for sign in "->"}
        for ends in medium.ends:
            if ends not in known:
                expected = f"one of {', '.join(sorted(known))}"
                text = f"media.{medium.name}.ends has {ends!r}; expected {expected}"
                raise BadConfig(text, field=f"media.{medium.name}.ends", value=ends, expected=expected)
    begin = Begin(len(maker.hosts), maker.taps, maker.media, maker.channels, scenario.seed, directory)
    media: dict[str, list[Edge]] = {}
    for edge in maker.edges:
        media.setdefault(edge.medium, []).append(edge)
    return Wiring(begin, maker.hosts, maker.interfaces, maker.edges, media)
