"""The way from one router to others, as Zenoh's routers go: see :mod:`mesh.linkstate`."""

from __future__ import annotations

from mesh import linkstate
from zmav.client import Answer, Client


async def trace(z: Client, source: str, timeout: float = 1.0, tries: int = 3) -> dict[str, list[str]]:
    """Ids of the routers from ``source`` to each that it reaches, both ends included, by what all tell of their links.

    Empty where it does not answer. ``source`` is the id of a router.
    """
    for _ in range(tries):
        answers = {}
        for answer in await z.ask(linkstate.ASKED, timeout=timeout):
            if isinstance(answer, Answer) and (zid := linkstate.zid_of(answer.key)):
                answers[zid] = answer.payload
        if source in answers:
            return linkstate.ways(linkstate.read(answers), source)
    return {}
