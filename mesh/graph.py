"""The fleet as a graph: who is linked to whom, how well, and the way from here to each host.

    async with zmav.open() as z:
        graph = await mesh.graph.gather(z)
        for link in graph.links:
            print(link.a, link.b, link.state, link.rtt, link.loss(link.a), link.grade)
        print(graph.ways["quad3"].hops, graph.ways["quad3"].weakest)

It is a query and nothing else: what the routers say of their neighbours on ``link/*``, their liveliness tokens, and the
map by which Zenoh's routers pass messages on. Nobody needs to be asked twice a second; a viewer asks every few.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import zenoh

from mesh import linkstate
from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.doctor.ways import Link, Way
from zmav.errors import BadInput
from zmav.tokens import find_tokens
from zmav.trust.member import Place


@dataclass(frozen=True)
class Node:
    """A host that is present, answers, or is told of by a neighbour."""

    name: str
    zid: str | None = None
    """of its router"""
    role: str | None = None
    """as its token says: vehicle, router...; None: it has none"""
    answers: bool = False
    """it tells of its links itself"""


@dataclass(frozen=True)
class Graph:
    """What was known when it was gathered."""

    t: float
    """UTC seconds"""
    start: str | None
    """the host whose ways these are; None: it is not known"""
    nodes: dict[str, Node] = field(default_factory=dict)
    links: tuple[Link, ...] = ()
    ways: dict[str, Way] = field(default_factory=dict)
    """to every other host that is known to have a router"""
    bad: int = 0
    """answers left out because they were not what they should be"""

    def link(self, one: str, other: str) -> Link | None:
        a, b = sorted((one, other))
        return next((link for link in self.links if (link.a, link.b) == (a, b)), None)


async def gather(z: Client, timeout: float = 1.0, tries: int = 3) -> Graph:
    """Ask the fleet; hosts that do not answer are asked again, ``tries`` times in all, then shown as they are told of.

    Its ways are those of the router that ``z`` is a client of. Where ``z`` sees several fleets, names are
    ``fleet/name``.
    """
    found = Findings(several=z.fleet_name == "*")
    tokens = asyncio.create_task(_tokens(z, timeout))
    found.read(await z.ask(keys.LINK.key(z.fleet_name, "*", link="*"), timeout=timeout, channel=keys.LINK))
    found.present(await tokens)
    for _ in range(tries - 1):
        missing = found.missing()
        if not missing:
            break
        asked = [
            z.ask(keys.LINK.key(fleet, name, link="*"), timeout=timeout, channel=keys.LINK) for fleet, name in missing
        ]
        for answers in await asyncio.gather(*asked):
            found.read(answers)
    nodes, links = found.nodes(), found.links()
    root = _root(z, nodes)
    ways = await _ways(z, nodes, links, root, timeout) if root else {}
    names = {node.zid: name for name, node in nodes.items() if node.zid}
    return Graph(time.time(), names.get(root, root) if root else None, nodes, tuple(links.values()), ways, found.bad)


async def _tokens(z: Client, timeout: float) -> list[str]:
    key = keys.ALIVE.key(z.fleet_name, "*", role="*", sys="*", autopilot="*", uid="*", instance="*")

    try:
        return await asyncio.to_thread(find_tokens, z.session, key, timeout)
    except zenoh.ZError:
        return []


def _root(z: Client, nodes: dict[str, Node]) -> str | None:
    """The id of the router that the ways begin at."""
    routers = [str(zid) for zid in z.session.info.routers_zid()]
    own = str(z.session.info.zid())
    if own in {node.zid for node in nodes.values()}:
        return own  # the session is a router's itself
    return routers[0] if routers else None


async def _ways(
    z: Client, nodes: dict[str, Node], links: dict[tuple[str, str], Link], root: str, timeout: float
) -> dict[str, Way]:
    names = {node.zid: name for name, node in nodes.items() if node.zid}
    start = names.get(root, root)
    found = await linkstate.trace(z, root, timeout)
    traced = bool(found)
    if not traced:  # its admin space is not to be read: by the links that were told of
        near: dict[str, dict[str, float]] = {}
        for link in links.values():
            if link.state != "down":
                near.setdefault(link.a, {})[link.b] = near.setdefault(link.b, {})[link.a] = 1.0
        found = linkstate.ways(near, start)
    ways = {}
    for zid, name in names.items():
        if zid == root:
            continue
        hops = [names.get(hop, hop) for hop in found.get(zid if traced else name, [start])]
        over = [sorted(pair) for pair in itertools.pairwise(hops)]
        crossed = tuple(links.get((a, b)) or Link(a, b) for a, b in over)
        ways[name] = Way(tuple(hops), crossed, complete=hops[-1] == name, traced=traced)
    return ways


class Findings:
    """What the hosts of a fleet say of their links, put together: both ends of each, and who is only told of."""

    def __init__(self, several: bool) -> None:
        self._several = several
        self.bad = 0
        self._said: dict[Place, dict[str, wire.NeighbourQuality]] = {}
        self._tokens: dict[Place, str] = {}
        self._named: dict[str, Place] = {}
        """by the ids of routers"""

    def present(self, tokens: Iterable[str]) -> None:
        """Keys of liveliness tokens; of a vehicle's and its programs' tokens, that of the router counts."""
        for key in tokens:
            try:
                channel, parts = keys.match(key)
            except BadInput:
                self.bad += 1
                continue
            if channel is keys.ALIVE and parts["role"] in (keys.VEHICLE, keys.ROUTER):
                place = parts["fleet"], parts["vehicle"]
                self._tokens[place] = parts["role"]
                if linkstate.ROUTER_ID.match(parts["instance"]):
                    self._named[parts["instance"]] = place

    def read(self, answers: Iterable[Answer | Exception]) -> None:
        for answer in answers:
            if not isinstance(answer, Answer):
                continue
            try:
                channel, parts = keys.match(answer.key)
                quality = wire.decode_link(answer.payload)
            except BadInput:
                self.bad += 1
                continue
            place = parts["fleet"], parts["vehicle"]
            if channel is not keys.LINK or quality.name != parts["link"] or not keys.NAME.match(quality.name):
                self.bad += 1
            elif isinstance(quality, wire.LinkQuality):
                continue  # the vehicle's own link
            elif not (linkstate.ROUTER_ID.match(quality.router) and linkstate.ROUTER_ID.match(quality.peer)):
                self.bad += 1
            else:
                self._said.setdefault(place, {})[quality.name] = quality
                self._named.setdefault(quality.router, place)

    def missing(self) -> list[Place]:
        """Hosts that there are, and that told nothing of neighbours."""
        told = {(fleet, q.name) for (fleet, _), said in self._said.items() for q in said.values() if q.state != "down"}
        return sorted({*self._tokens, *told} - self._said.keys())

    def _label(self, place: Place) -> str:
        return "/".join(place) if self._several else place[1]

    def _neighbour(self, fleet: str, quality: wire.NeighbourQuality) -> Place:
        """The host a quality is about: by its router's id, where the neighbour did not say its name."""
        place = fleet, quality.name
        return self._named.get(quality.peer, place) if quality.name == quality.peer else place

    def nodes(self) -> dict[str, Node]:
        zids = {place: zid for zid, place in self._named.items()}
        for (fleet, _), said in self._said.items():
            for quality in said.values():
                zids.setdefault(self._neighbour(fleet, quality), quality.peer)
        places = sorted({*zids, *self._tokens, *self._said})
        return {
            self._label(place): Node(
                self._label(place),
                zids.get(place),
                self._tokens.get(place),
                place in self._said,
            )
            for place in places
        }

    def links(self) -> dict[tuple[str, str], Link]:
        ends: dict[tuple[str, str], dict[str, wire.NeighbourQuality]] = {}
        for place, said in sorted(self._said.items()):
            for quality in said.values():
                one, other = self._label(place), self._label(self._neighbour(place[0], quality))
                if one != other:
                    a, b = sorted((one, other))
                    ends.setdefault((a, b), {})[one] = quality
        return {(a, b): Link(a, b, said.get(a), said.get(b)) for (a, b), said in sorted(ends.items())}
