"""``zmav mesh graph``: who is linked to whom, how well, and the way to each vehicle with its weakest hop."""

from __future__ import annotations

from typing import Any

import click
import msgspec
from rich.console import Group
from rich.table import Table
from rich.text import Text

from mesh.graph import Graph, gather
from mesh.units import duration, milliseconds, percent
from zmav.cli.common import Between, Work, connected, console, dump, json_option, table
from zmav.client import Client
from zmav.doctor.ways import Link, Way

STYLES = {"good": "green", "fair": "yellow", "poor": "red", "down": "bold red", "unknown": "dim"}


@click.command("graph")
@click.option("--timeout", type=Between(0.1, 60.0), default=1.0, show_default=True, help="Seconds for answers.")
@json_option
@connected
def command(timeout: float, as_json: bool) -> Work:
    """Show the fleet's links with their quality, and for each vehicle the way to it and its weakest hop.

    Colours: green below 5 % loss and 30 ms a kilobyte, red from 20 % and 150 ms. Figures with two values are from the
    first host to the second, and back. The weakest hop is one that is down; else that of most loss, the longest round
    trip, in this order.
    """

    async def show(z: Client) -> None:
        graph = await gather(z, timeout)
        if as_json:
            click.echo(dump(document(graph)))
        else:
            console().print(view(graph))

    return show


# For a person.


def view(graph: Graph) -> Group:
    """Links, then ways to vehicles, then who says nothing."""
    parts: list[Any] = [_links(graph)] if graph.links else [Text("no links between routers are known")]
    if ways := _ways(graph):
        parts += [Text(), ways]
    parts += [Text(words, style="yellow") for words in notes(graph)]
    return Group(*parts)


def notes(graph: Graph) -> list[str]:
    """What the tables cannot show."""
    found = []
    linked = {end for link in graph.links for end in (link.a, link.b)}
    for name, node in graph.nodes.items():
        if not node.answers and (name in linked or len(graph.nodes) > 1):
            found.append(f"{name} tells nothing of its links" + ("" if node.role else " and has no token"))
    if any(not way.traced for way in graph.ways.values()):
        found.append("* by the fewest hops: the routers' own map did not answer")
    if graph.bad:
        found.append(f"{graph.bad} answers were not what they should be, and are left out")
    return found


def _links(graph: Graph) -> Table:
    columns = ("link", "state", "RTT ms", "loss", "signal", "cost", "heard", "over")
    found = table(columns, right=("RTT ms", "cost", "heard"))
    for link in graph.links:
        said = link.by_a or link.by_b
        found.add_row(
            f"{link.a} - {link.b}",
            link.state,
            milliseconds(link.rtt),
            _both(percent(link.loss(link.a)), percent(link.loss(link.b))),
            _both(*("-" if (dbm := link.signal(end)) is None else f"{dbm:.0f} dBm" for end in (link.a, link.b))),
            "-" if link.cost is None else str(link.cost),
            duration(link.age),
            said.url.partition("?")[0] if said else "",
            style=STYLES[link.grade],
        )
    return found


def _ways(graph: Graph) -> Table | None:
    """To vehicles, and where there are none to whatever there is."""
    vehicles = {n for n, node in graph.nodes.items() if node.role == "vehicle"} or set(graph.nodes)
    shown = sorted(vehicles & graph.ways.keys())
    if not shown:
        return None
    found = table(("to", "way", "weakest hop", "RTT ms", "delivery"), right=("RTT ms",))
    for name in shown:
        way = graph.ways[name]
        found.add_row(
            name,
            way_words(way) + ("" if way.traced else " *"),
            _weakest(way.weakest) if len(way.links) else "-",
            milliseconds(way.rtt),
            _both(percent(way.delivery()), percent(way.delivery(back=True))),
            style=STYLES[way.weakest.grade] if way.weakest else STYLES["down"],
        )
    return found


def way_words(way: Way) -> str:
    """``ground > quad1 > quad2``, with a question mark where it is lost."""
    return " > ".join(way.hops) + ("" if way.complete else " > ?") if way.hops else "?"


def _weakest(link: Link | None) -> str:
    if link is None:
        return "-"
    words = [link.state] if link.state != "up" else []
    if link.worst_loss:
        words.append(f"{percent(link.worst_loss)} lost")
    if link.rtt is not None:
        words.append(f"{milliseconds(link.rtt)} ms")
    return f"{link.a} - {link.b} ({', '.join(words)})"


def _both(there: str, back: str) -> str:
    return there if there == back else f"{there} / {back}"


# For a script.


def document(graph: Graph) -> dict[str, Any]:
    """What ``--json`` prints: a graph's nodes, links and ways."""
    return {
        "t": graph.t,
        "start": graph.start,
        "nodes": [
            {"name": node.name, "zid": node.zid, "role": node.role, "answers": node.answers}
            for node in graph.nodes.values()
        ],
        "links": [_link(link) for link in graph.links],
        "ways": {name: _way(way) for name, way in graph.ways.items()},
        "bad": graph.bad,
    }


def _link(link: Link) -> dict[str, Any]:
    ends = (link.a, link.b)
    return {
        "ends": ends,
        "state": link.state,
        "grade": link.grade,
        "cost": link.cost,
        "rtt": link.rtt,
        "age": link.age,
        "loss": {end: link.loss(end) for end in ends},
        "signal": {end: link.signal(end) for end in ends},
        "said": {
            end: msgspec.to_builtins(said)
            for end, said in zip(ends, (link.by_a, link.by_b), strict=True)
            if said is not None
        },
    }


def _way(way: Way) -> dict[str, Any]:
    weakest = way.weakest
    return {
        "hops": way.hops,
        "complete": way.complete,
        "traced": way.traced,
        "weakest": (weakest.a, weakest.b) if weakest else None,
        "rtt": way.rtt,
        "delivery": way.delivery(),
        "delivery_back": way.delivery(back=True),
    }
