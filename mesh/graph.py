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

import zenoh

from mesh import linkstate
from mesh.findings import Findings
from mesh.tokens import find_tokens
from mesh.topology import Grade, Graph, Link, Node, Way
from zmav import keys
from zmav.client import Client
from zmav.errors import NoSuchVehicle

__all__ = ["Grade", "Graph", "Link", "Node", "Way", "gather"]


async def gather(z: Client, start: str | None = None, timeout: float = 1.0, tries: int = 3) -> Graph:
    """Ask the fleet; hosts that do not answer are asked again, ``tries`` times in all, then shown as they are told of.

    ``start``: whose ways; by default those of the router that ``z`` is a client of. Where ``z`` sees several fleets,
    names are ``fleet/name``. Raises :class:`NoSuchVehicle` for a start that is not there.
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
    root = _root(z, nodes, start)
    ways = await _ways(z, nodes, links, root, timeout) if root else {}
    names = {node.zid: name for name, node in nodes.items() if node.zid}
    return Graph(time.time(), names.get(root, root) if root else None, nodes, tuple(links.values()), ways, found.bad)


async def _tokens(z: Client, timeout: float) -> list[str]:
    key = keys.ALIVE.key(z.fleet_name, "*", role="*", sys="*", autopilot="*", uid="*", instance="*")

    try:
        return await asyncio.to_thread(find_tokens, z.session, key, timeout)
    except zenoh.ZError:
        return []


def _root(z: Client, nodes: dict[str, Node], start: str | None) -> str | None:
    """The id of the router that the ways begin at."""
    if start is not None:
        if start not in nodes or nodes[start].zid is None:
            known = ", ".join(name for name, node in nodes.items() if node.zid) or "none"
            raise NoSuchVehicle(f"no router of a host {start!r} is known; there are: {known}", missing=[start])
        return nodes[start].zid
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
