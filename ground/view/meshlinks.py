"""The mesh in the scene: lines between routers, coloured by grade and the thicker the better."""

from __future__ import annotations

from collections.abc import Mapping

import rerun as rr

from ground.view import style
from ground.view.canvas import NED, Canvas
from mesh.topology import Graph, Link
from zmav.wire import Vector

PATH = (*NED, "mesh")
LABELLED = 12
"""links at most whose figures stand beside them"""


def paint(canvas: Canvas, graph: Graph, places: Mapping[str, Vector]) -> None:
    """Draw the links between hosts whose places are known; the others (a ground station's) stand in a row at the
    origin, to the south.
    """
    ends = {name for link in graph.links for name in (link.a, link.b)}
    stations = sorted(name for name in ends if name not in places and _role(graph, name) != "vehicle")
    where = {**places, **{name: (-4.0 * (i + 1), 0.0, 0.0) for i, name in enumerate(stations)}}
    _paint_stations(canvas, {name: where[name] for name in stations})
    drawn = [link for link in graph.links if link.a in where and link.b in where]
    if not drawn:
        return canvas.clear(PATH)
    strips = rr.LineStrips3D(
        [[where[link.a], where[link.b]] for link in drawn],
        colors=[style.GRADES.get(link.grade, style.GREY) for link in drawn],
        radii=[style.points(style.WIDTHS.get(link.grade, 1.0)) for link in drawn],
        labels=[words(link) for link in drawn],
        show_labels=len(drawn) <= LABELLED,
    )
    return canvas.put(PATH, strips)


def _role(graph: Graph, name: str) -> str | None:
    node = graph.nodes.get(name)
    return node.role if node else None


def _paint_stations(canvas: Canvas, stations: Mapping[str, Vector]) -> None:
    points = rr.Points3D(
        list(stations.values()), colors=style.WHITE, radii=style.points(5.0), labels=list(stations), show_labels=True
    )
    canvas.put((*PATH, "stations"), points if stations else None)


def words(link: Link) -> str:
    """A link in words: ``12 ms 3 % lost``."""
    if link.grade == "down":
        return "down"
    parts = [] if link.rtt is None else [f"{1e3 * link.rtt:.0f} ms" if link.rtt >= 0.001 else "<1 ms"]
    if (loss := link.worst_loss) is not None and loss >= 0.005:
        parts.append(f"{loss:.0%} lost")
    return " ".join(parts) or link.grade
