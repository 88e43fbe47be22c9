"""The ways that Zenoh's routers take, read from the tables by which they pass messages on.

Each router tells in its admin space, for whatever begins at a router S and goes to a router D, which of its neighbours
is next (``route/successor/src/S/dst/D``). From hop to hop that is the way itself, and not what a map would suggest.
"""

from __future__ import annotations

import asyncio
import re
from collections import deque
from collections.abc import Mapping, Set

from zmav.client import Answer, Client

MOST_HOPS = 64
ROUTER_ID = re.compile(r"[0-9a-f]{1,32}\Z")


async def trace(
    z: Client, source: str, targets: Set[str], timeout: float = 1.0, tries: int = 2
) -> dict[str, list[str]]:
    """The routers' ids from ``source`` to each of ``targets``, both ends included; as far as they can be followed.

    All ways go on side by side, one question a router and hop: for one target its row, for several the whole table.
    """
    ways = {target: [source] for target in targets}
    open_ways = set(targets) - {source}
    while open_ways:
        at: dict[str, set[str]] = {}
        for target in open_ways:
            at.setdefault(ways[target][-1], set()).add(target)
        tables = await asyncio.gather(*(_table(z, source, hop, ends, timeout, tries) for hop, ends in at.items()))
        for (_, ends), table in zip(at.items(), tables, strict=True):
            for target in ends:
                following, way = table.get(target), ways[target]
                if following is None or following in way or len(way) >= MOST_HOPS:
                    open_ways.discard(target)
                    continue
                way.append(following)
                if following == target:
                    open_ways.discard(target)
    return ways


async def _table(z: Client, source: str, at: str, targets: Set[str], timeout: float, tries: int) -> dict[str, str]:
    """Target -> next hop at the router ``at``."""
    found: dict[str, str] = {}
    start = f"@/{at}/router/route/successor/src/{source}/dst/"
    for _ in range(tries):
        (only,) = targets if len(targets) == 1 else ("*",)
        for answer in await z.ask(start + only, timeout=timeout):
            if isinstance(answer, Answer) and answer.key.startswith(start) and len(answer.payload) < 100:
                following = answer.payload.decode("ascii", "replace").strip('" ')
                if ROUTER_ID.match(following):
                    found[answer.key[len(start) :]] = following
        if targets & found.keys():
            break
    return found


def fewest_hops(near: Mapping[str, Set[str]], start: str, end: str) -> list[str]:
    """Names from ``start`` to ``end``; empty where there is no way."""
    came: dict[str, str] = {start: start}
    queue = deque([start])
    while queue and end not in came:
        here = queue.popleft()
        for there in sorted(near.get(here, ())):
            if there not in came:
                came[there] = here
                queue.append(there)
    if end not in came:
        return []
    way = [end]
    while way[-1] != start:
        way.append(came[way[-1]])
    return way[::-1]
