"""From a scenario's names to the relay's numbers, and back: which interface, which channel is whose."""

from __future__ import annotations

import ipaddress
import re
from collections import Counter
from collections.abc import Iterator

from mesh.lab.channel import Conditions
from mesh.lab.messages import Begin, Edge, Interface, MediumSpec
from mesh.lab.scenario import RadioChannel, Scenario, pairs_of
from mesh.lab.values import conditions
from zmav.errors import BadConfig


class Wiring:
    """Everything that the relay is to make, by name."""

    def __init__(self, begin: Begin) -> None:
        self.begin = begin
        self.hosts, self.interfaces, self.edges = begin.hosts, begin.interfaces, begin.edges

    def find(self, text: str) -> list[tuple[Edge, tuple[int, ...]]]:
        """The edges called ``text``, each with the channels meant; raises :class:`BadConfig` naming those there are.

        ``quad2-quad3`` or ``quad3-quad2``; ``2-3`` where one host's name ends so; ``quad2>quad3`` for one direction;
        ``wifi:quad2-quad3`` of one medium; a medium's name for all in it; ``all``.
        """
        whole = [edge for edge in self.edges if text in ("all", edge.medium)]
        if whole:
            return [(edge, (edge.ab, edge.ba)) for edge in whole]
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
        raise BadConfig.wrong("link", text, expected, f"{what} {text!r}")


def _short(name: str) -> tuple[str, ...]:
    """A name and the number at its end."""
    number = re.search(r"\d+$", name)
    return (name, number[0]) if number and number[0] != name else (name,)


def wire(scenario: Scenario) -> Wiring:
    """Number everything of a checked scenario; raises :class:`BadConfig` for ends of no pair of their medium."""
    checked = [medium for medium in scenario.media if isinstance(medium, RadioChannel)]  # all of them
    joined = Counter(frozenset(pair) for medium in checked for pair in pairs_of(medium))
    interfaces: list[Interface] = []
    channels: list[Conditions] = []
    edges: list[Edge] = []
    for number, medium in enumerate(checked):
        name = medium.name or ""
        interfaces += _interfaces(number, medium)
        known = {f"{x}{sign}{y}" for a, b in pairs_of(medium) for x, y in ((a, b), (b, a)) for sign in "->"}
        for ends in medium.ends:
            if ends not in known:
                expected = f"one of {', '.join(sorted(known))}"
                raise BadConfig.wrong(f"media.{name}.ends", ends, expected, f"media.{name}.ends has {ends!r}")
        for a, b in pairs_of(medium):
            label = f"{name}:{a}-{b}" if joined[frozenset((a, b))] > 1 else f"{a}-{b}"
            edges.append(Edge(label, name, a, b, len(channels), len(channels) + 1))
            channels += [_conditions(medium, a, b), _conditions(medium, b, a)]
    media = [MediumSpec(medium.name or "", medium.shared) for medium in scenario.media]
    return Wiring(Begin(tuple(scenario.hosts), interfaces, media, edges, channels, scenario.seed))


def _interfaces(number: int, medium: RadioChannel) -> Iterator[Interface]:
    network = ipaddress.IPv4Network(medium.network or "")
    for place, (host, address) in enumerate(zip(medium.hosts or [], network.hosts(), strict=False)):
        mac = bytes((0x02, 0x5A, number >> 8, number & 0xFF, place >> 8, place & 0xFF))
        name = medium.interface or ""
        yield Interface(host, medium.name or "", name, str(address), network.prefixlen, mac, medium.mtu)


def _conditions(medium: RadioChannel, sender: str, receiver: str) -> Conditions:
    value = conditions(Conditions(), medium, medium.name or "")
    for ends in (f"{sender}-{receiver}", f"{receiver}-{sender}", f"{sender}>{receiver}"):
        if ends in medium.ends:
            value = conditions(value, medium.ends[ends], ends)
    return value
