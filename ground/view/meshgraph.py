"""What is told of the mesh between ``zmav view`` and its painters. Rerun is not needed here."""

from __future__ import annotations

import msgspec

from mesh.topology import Graph


class LinkShown(msgspec.Struct, array_like=True):
    """What is drawn of one link."""

    a: str
    b: str
    grade: str
    rtt: float | None = None
    """s"""
    loss: float | None = None
    """0 to 1, in the worse direction"""


class WayShown(msgspec.Struct, array_like=True):
    """What is plotted of the way from the viewer's router to a host."""

    rtt: float | None = None
    lost: float | None = None
    """share of best-effort messages that do not arrive here from there"""
    hops: int = 0


class GraphShown(msgspec.Struct):
    """What the painter is told of the mesh."""

    links: list[LinkShown] = []
    ways: dict[str, WayShown] = {}
    roles: dict[str, str | None] = {}


def shown(graph: Graph) -> GraphShown:
    """What of a graph is drawn."""
    links = [LinkShown(link.a, link.b, link.grade, link.rtt, link.worst_loss) for link in graph.links]
    ways = {}
    for name, way in graph.ways.items():
        arrives = way.delivery(back=True)
        ways[name] = WayShown(way.rtt, None if arrives is None else 1.0 - arrives, len(way.hops) - 1)
    return GraphShown(links, ways, {name: node.role for name, node in graph.nodes.items()})


def decode(payload: bytes) -> GraphShown:
    """What our own watcher said."""
    return msgspec.json.decode(payload, type=GraphShown)


def encode(graph: GraphShown) -> bytes:
    return msgspec.json.encode(graph)
