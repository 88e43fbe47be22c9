"""The way from one host to another, as Zenoh's routers themselves would go."""

from __future__ import annotations

from mesh.bench.asker import Bench
from mesh.linkstate import trace
from zmav.client import Client
from zmav.errors import TimedOut
from zmav.wire.bench import Pong


async def route(client: Client, a: Pong, b: Pong) -> list[str]:
    """Routers' ids from ``a`` to ``b``, both included; raises :class:`TimedOut` where ``a`` does not say how to go."""
    ways = await trace(client, a.zid)
    if b.zid not in ways:
        raise TimedOut(f"the router of {a.host} does not say how it reaches {b.host}", router=a.zid)
    return ways[b.zid]


async def named(bench: Bench, way: list[str]) -> list[str]:
    """The hosts' names of a way of ids; the id itself where a router has no responder."""
    names = {pong.zid: pong.host for pong in await bench.everyone()}
    return [names.get(zid, zid) for zid in way]
