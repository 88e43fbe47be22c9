"""What the hosts of a fleet say of their links, put together: both ends of each, and who is only told of."""

from __future__ import annotations

from collections.abc import Iterable

from mesh.linkstate import ROUTER_ID
from mesh.topology import Link, Node
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadInput
from zmav.trust.member import Place


class Findings:
    """What came in, before it is put together."""

    def __init__(self, several: bool) -> None:
        self._several = several
        self.bad = 0
        self._said: dict[Place, dict[str, wire.NeighbourQuality]] = {}
        self._autopilots: dict[Place, wire.LinkQuality] = {}
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
                if ROUTER_ID.match(parts["instance"]):
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
                self._autopilots[place] = quality
            elif not (ROUTER_ID.match(quality.router) and ROUTER_ID.match(quality.peer)):
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
        places = sorted({*zids, *self._tokens, *self._autopilots, *self._said})
        return {
            self._label(place): Node(
                self._label(place),
                zids.get(place),
                self._tokens.get(place),
                place in self._said,
                self._autopilots.get(place),
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
