"""A fleet's graph in the DOT language, for Graphviz: ``zmav mesh graph --dot | dot -Tsvg > fleet.svg``."""

from __future__ import annotations

from mesh.topology import Graph, Link
from mesh.words import milliseconds, percent

COLOURS = {"good": "forestgreen", "fair": "goldenrod", "poor": "orangered", "down": "red", "unknown": "gray50"}


def dot(graph: Graph) -> str:
    """Nodes that do not answer are dashed, links coloured by their grade; what is down is dotted."""
    lines = ["graph fleet {", '  node [shape=box, style=rounded, fontname="sans-serif"];', "  edge [fontsize=10];"]
    for name, node in graph.nodes.items():
        words = [name] if node.role is None else [name, node.role]
        style = "rounded" if node.answers else "rounded,dashed"
        if name == graph.start:
            style += ",bold"
        lines.append(f"  {quoted(name)} [label={quoted(*words)}, style={quoted(style)}];")
    for link in graph.links:
        style = "dotted" if link.grade == "down" else "solid"
        said = quoted(*label(link))
        colour = quoted(COLOURS[link.grade])
        lines.append(f"  {quoted(link.a)} -- {quoted(link.b)} [label={said}, color={colour}, style={quoted(style)}];")
    return "\n".join([*lines, "}"]) + "\n"


def label(link: Link) -> list[str]:
    """What stands at a link: its state where it is not up, round trip, and loss in both directions."""
    words = [] if link.state == "up" else [link.state]
    if link.rtt is not None:
        words.append(f"{milliseconds(link.rtt)} ms")
    losses = [link.loss(end) for end in (link.a, link.b)]
    if any(loss is not None for loss in losses):
        words.append(f"{percent(losses[0])} / {percent(losses[1])}")
    return words


def quoted(*lines: str) -> str:
    """A DOT string of so many lines."""
    return '"' + "\\n".join(line.replace("\\", "\\\\").replace('"', '\\"') for line in lines) + '"'
