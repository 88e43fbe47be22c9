"""A neighbour as a bearer sees it: the paths to it, the one that is taken, and the flows with its router."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mesh.bearer.flows import Local, Opened, Taken
from mesh.bearer.header import DATA_HEAD
from mesh.bearer.path import Choice, Health, Path
from mesh.bearer.port import Address, RadioPort
from mesh.bearer.shaper import Bucket

ECHOES = 4000.0
"""bytes/s of echoes to one address: about a hundred, and no probe that is answered takes more from the budget"""
LEARNED = 4
"""addresses of a neighbour beside those in the fleet file: behind a NAT they change"""
QUIC_LEAST = 1200
"""bytes of a datagram that QUIC needs (RFC 9000, section 14)"""
FORGET = 30.0
"""s of silence after which a learned address is forgotten"""


@dataclass(eq=False)
class Route:
    """One path and where it leads."""

    port: RadioPort
    to: Address
    path: Path
    echoes: Bucket
    proven: bool = True
    """somebody there has echoed what only he was asked; those of the fleet file need no proof"""
    since: float = 0.0


class RouteStatus(NamedTuple):
    """A path for people to look at."""

    address: str
    in_use: bool
    health: Health


class Peer:
    """One neighbour. Lives on the bearer's thread."""

    def __init__(self, name: str, tag: int, router: Local, *, opens: bool) -> None:
        self.name, self.tag = name, tag
        self.routes: list[Route] = []
        self.opened = Opened() if opens else None
        self.taken = Taken(router)
        self.choice = Choice()
        self.route: Route | None = None
        """where data goes now"""
        self.largest = 65535
        """bytes of the router's datagrams that every path carries: with larger ones, QUIC would take a change of paths
        for a black hole, and need a second to find out"""

    def add(self, port: RadioPort, to: Address, cost: int, now: float, *, learned: bool = False) -> Route | None:
        """A path to it; None where too many have been learned. One that was, and is not proven, makes room."""
        known = [route for route in self.routes if route.path.learned]
        if learned and len(known) >= LEARNED:
            unproven = next((route for route in known if not route.proven), None)
            if unproven is None:
                return None
            self.routes.remove(unproven)
        path = Path(port.name, cost, port.budget, learned=learned)
        route = Route(port, to, path, Bucket(ECHOES, now), not learned, now)
        self.routes.append(route)
        return route

    def find(self, port: RadioPort, source: Address) -> Route | None:
        """The path on which something came."""
        for route in self.routes:
            if route.port is port and route.to == source:
                return route
        return None

    def judge(self, now: float) -> None:
        """Choose the path again, and forget learned ones that have long been silent."""
        self.routes = [route for route in self.routes if not self._forgotten(route, now)]
        proven = {route.path: route for route in self.routes if route.proven}
        chosen = self.choice.judge(list(proven), now)
        self.route = proven[chosen] if chosen is not None else None
        least = min((route.port.largest for route in proven.values()), default=65535)
        self.largest = max(least - DATA_HEAD.size, QUIC_LEAST)

    def _forgotten(self, route: Route, now: float) -> bool:
        heard = route.path.heard or route.since
        return route.path.learned and now - heard > FORGET

    def status(self) -> list[RouteStatus]:
        return [RouteStatus(f"{r.to[0]}:{r.to[1]}", r is self.route, r.path.health) for r in self.routes if r.proven]

    def close(self) -> None:
        if self.opened is not None:
            self.opened.close()
        self.taken.close()
