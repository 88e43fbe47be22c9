"""The way from one router to others, as a router itself tells it: see :mod:`mesh.linkstate`."""

from __future__ import annotations

from mesh import linkstate
from zmav.client import Answer, Client


async def trace(z: Client, source: str, timeout: float = 1.0, tries: int = 3) -> dict[str, list[str]]:
    """Ids of the routers from ``source`` to each that it reaches, both ends included, by its own map of the network.

    Empty where it does not answer. ``source`` is the id of a router.
    """
    for _ in range(tries):
        for answer in await z.ask(linkstate.key(source), timeout=timeout, enough=lambda _: True):
            if isinstance(answer, Answer) and answer.key == linkstate.key(source):
                return linkstate.ways(linkstate.read(answer.payload), source)
    return {}
