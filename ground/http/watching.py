"""``GET /report``: what ``zmav top --json`` prints, for as long as somebody asks for it again."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.documents import answer
from ground.http.gateway import Gateway
from ground.top.watch import Watch
from zmav.waiting import alongside

LASTING = 30.0
"""s that the fleet is watched after the last request: watching asks every vehicle every two seconds"""
SETTLE = 1.0
"""s for the first answers"""


class Watching:
    """On the event loop."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._watch = Watch(gateway.client)
        self._task: asyncio.Task[None] | None = None
        self._until = 0.0
        gateway.at_end(self._end)

    async def report(self, request: Request) -> Response:
        """Every vehicle with what is not well with it, by the rules of zmav top and zmav doctor; links, agents."""
        self._until = time.monotonic() + LASTING
        if self._task is None or self._task.done():
            self._watch = Watch(self._gateway.client)
            self._task = asyncio.create_task(self._run())
            await self._watch.settle(SETTLE)
        links = [
            {"a": link.a, "b": link.b, "grade": link.grade, "loss": link.worst_loss, "rtt": link.rtt}
            for link in self._watch.links
        ]
        document: dict[str, Any] = msgspec.to_builtins(self._watch.report())
        return answer({**document, "links": links})

    async def _run(self) -> None:
        async with alongside(self._watch.run()) as (watch,):
            while time.monotonic() < self._until and not watch.done():
                await asyncio.sleep(1.0)

    def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()


def routes(gateway: Gateway) -> list[BaseRoute]:
    return [Route("/report", Watching(gateway).report, methods=["GET"])]
