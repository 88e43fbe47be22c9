"""The way from one host to another, as Zenoh's routers themselves would go."""

from __future__ import annotations

from mesh.bench.asker import Bench
from zmav.client import Answer, Client
from zmav.errors import TimedOut, ZmavError
from zmav.wire.bench import Pong

MOST_HOPS = 32
TRIES = 3


async def route(client: Client, a: Pong, b: Pong) -> list[str]:
    """Routers' ids from ``a`` to ``b``, both included; raises :class:`TimedOut` where one on the way says nothing."""
    way = [a.zid]
    while way[-1] != b.zid and len(way) < MOST_HOPS:
        way.append(await _next(client, way[-1], a.zid, b.zid))
        if way[-1] in way[:-1]:
            raise ZmavError(f"the routers send what goes from {a.host} to {b.host} in a circle", way=way)
    return way


async def _next(client: Client, at: str, source: str, target: str) -> str:
    key = f"@/{at}/router/route/successor/src/{source}/dst/{target}"
    for _ in range(TRIES):
        for answer in await client.ask(key, timeout=1.0, enough=lambda _: True):
            if isinstance(answer, Answer):
                return answer.payload.decode(errors="replace").strip('"')
    raise TimedOut(f"the router {at} does not say how it reaches {target}", router=at)


async def named(bench: Bench, way: list[str]) -> list[str]:
    """The hosts' names of a way of ids; the id itself where a router has no responder."""
    names = {pong.zid: pong.host for pong in await bench.everyone()}
    return [names.get(zid, zid) for zid in way]
