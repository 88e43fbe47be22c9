"""The routers' own map of the network, and the ways they take by it.

Every Zenoh router floods its links and their weights to all others, and sends what is for another router along the
shortest paths over them. Its admin space has the map in the DOT language (``linkstate/north``). Ties are broken in the
weights themselves, by a fraction that both ends of a link reckon alike, so the map says which way is taken.

The tables that follow from it can be asked for, too (``route/successor``). That is not done here: in Zenoh 1.10.2 a
router that is asked just while a new one joins panics in the task that reads from the asker's link, which stays up and
deaf from then on.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Mapping

ROUTER_ID = re.compile(r"[0-9a-f]{1,32}\Z")
LARGEST = 1_000_000
"""bytes of a map that is read: some 10,000 links"""
Map = dict[str, dict[str, float]]
"""router's id -> those it is linked with, and the weights of these links"""
_NODE = re.compile(r'^\s*(\d{1,9}) \[ label = "([0-9a-f]{1,32})" \]\s*$')
_LINK = re.compile(r'^\s*(\d{1,9}) -- (\d{1,9}) \[ label = "(\d{1,9}(?:\.\d{1,20})?)" \]\s*$')


def key(zid: str) -> str:
    """Where the map of the router ``zid`` is."""
    return f"@/{zid}/router/linkstate/north"


def read(data: bytes) -> Map:
    """A map; lines that are none of it are left out."""
    names: dict[str, str] = {}
    found: Map = {}
    lines = data[:LARGEST].decode("ascii", "replace").splitlines()
    for line in lines:
        if node := _NODE.match(line):
            names[node[1]] = node[2]
            found[node[2]] = {}
    for line in lines:
        if (link := _LINK.match(line)) and link[1] in names and link[2] in names and link[1] != link[2]:
            one, other, weight = names[link[1]], names[link[2]], float(link[3])
            found[one][other] = found[other][one] = weight
    return found


def ways(links: Mapping[str, Mapping[str, float]], source: str) -> dict[str, list[str]]:
    """The way of least weight from ``source`` to each that it reaches, both ends included."""
    came: dict[str, str] = {}
    queue = [(0.0, source, source)]
    while queue:
        far, here, before = heapq.heappop(queue)
        if here in came:
            continue
        came[here] = before
        for there, weight in links.get(here, {}).items():
            if there not in came:
                heapq.heappush(queue, (far + weight, there, here))
    found: dict[str, list[str]] = {}
    for target in came:  # in the order they were reached: each after the one before it
        found[target] = [source] if target == source else [*found[came[target]], target]
    return found
