"""The mesh in the scene: lines between routers, coloured by grade and the thicker the better."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import rerun as rr

from ground.view import style
from ground.view.canvas import NED, Canvas
from mesh.topology import Graph
from zmav.wire import Vector

PATH = (*NED, "mesh")
LABELLED = 12
"""links at most whose figures stand beside them"""


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


def paint(canvas: Canvas, graph: GraphShown, places: Mapping[str, Vector]) -> None:
    """Draw the links between hosts whose places are known; the others (a ground station's) stand in a row at the
    origin, to the south.
    """
    ends = {name for link in graph.links for name in (link.a, link.b)}
    stations = sorted(name for name in ends if name not in places and graph.roles.get(name) != "vehicle")
    where = {**places, **{name: (-4.0 * (i + 1), 0.0, 0.0) for i, name in enumerate(stations)}}
    _paint_stations(canvas, {name: where[name] for name in stations})
    drawn = [link for link in graph.links if link.a in where and link.b in where]
    if not drawn:
        canvas.clear(PATH)
        return
    strips = rr.LineStrips3D(
        [[where[link.a], where[link.b]] for link in drawn],
        colors=[style.GRADES.get(link.grade, style.GREY) for link in drawn],
        radii=[style.points(style.WIDTHS.get(link.grade, 1.0)) for link in drawn],
        labels=[words(link) for link in drawn],
        show_labels=len(drawn) <= LABELLED,
    )
    canvas.put(PATH, strips)


def _paint_stations(canvas: Canvas, stations: Mapping[str, Vector]) -> None:
    path = (*PATH, "stations")
    if not stations:
        canvas.clear(path)
        return
    points = rr.Points3D(list(stations.values()), colors=style.WHITE, radii=style.points(5.0), labels=list(stations),
                         show_labels=True)  # fmt: skip
    canvas.put(path, points)


def words(link: LinkShown) -> str:
    """A link in words: ``12 ms 3 % lost``."""
    if link.grade == "down":
        return "down"
    parts = [] if link.rtt is None else [f"{1e3 * link.rtt:.0f} ms" if link.rtt >= 0.001 else "<1 ms"]
    if link.loss is not None and link.loss >= 0.005:
        parts.append(f"{link.loss:.0%} lost")
    return " ".join(parts) or link.grade


def decode(payload: bytes) -> GraphShown:
    """What our own watcher said."""
    return msgspec.json.decode(payload, type=GraphShown)


def encode(graph: dict[str, Any] | GraphShown) -> bytes:
    return msgspec.json.encode(graph)
