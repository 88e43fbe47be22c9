"""A fleet's hosts, the links between their routers, and the ways over them, as :func:`mesh.graph.gather` finds them."""

from __future__ import annotations

from dataclasses import dataclass, field

from zmav.doctor.ways import FAIR_COST, POOR_COST, Grade, Link, Way

__all__ = ["FAIR_COST", "POOR_COST", "Grade", "Graph", "Link", "Node", "Way"]


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
