"""A line of routers that answer measurements, and a client of the first of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
import zenoh

import zmav
from mesh.bench.asker import Bench
from mesh.bench.responder import Responder
from mesh.plan import RouterPlan
from tests.conftest import PATIENCE_S, Net
from zmav import keys
from zmav.config import Host
from zmav.trust.credentials import Credentials
from zmav.waiting import within


def plan_of(name: str, credentials: Credentials | None = None, host: Host | None = None) -> RouterPlan:
    return RouterPlan(fleet="demo", name=name, profile="lan", host=host or Host(), settings={}, credentials=credentials)


class Line:
    """Routers in a line, first to last; each is linked to the one before."""

    def __init__(self, net: Net, stack: contextlib.AsyncExitStack) -> None:
        self._net, self._stack = net, stack
        self.sessions: dict[str, zenoh.Session] = {}
        self.endpoints: dict[str, str] = {}
        self.responders: dict[str, Responder] = {}

    async def add(self, plan: RouterPlan, *connect: str) -> None:
        session, endpoint = self._net.router(*connect)
        self.sessions[plan.name], self.endpoints[plan.name] = session, endpoint
        self.responders[plan.name] = await self._stack.enter_async_context(Responder(session, plan))

    async def ask(self, name: str, credentials: str | None = None) -> Bench:
        """A client of that router."""
        client = zmav.open(fleet="demo", connect=[self.endpoints[name]], credentials=credentials)
        return Bench(await self._stack.enter_async_context(client))


async def idle(host: Responder) -> None:
    """Wait until nothing is measured there."""

    async def wait() -> None:
        while host.busy:
            await asyncio.sleep(0.02)

    await within(PATIENCE_S, wait())


Start = Callable[..., Awaitable[tuple[Line, Bench]]]


@pytest.fixture
async def line(net: Net) -> AsyncIterator[Start]:
    """``await line("quad1", "quad2")``: their routers know of each other when it returns."""
    async with contextlib.AsyncExitStack() as stack:

        async def start(*names: str) -> tuple[Line, Bench]:
            made, before = Line(net, stack), list[str]()
            for name in names:
                await made.add(plan_of(name), *before)
                before = [made.endpoints[name]]
            first, last = made.sessions[names[0]], made.sessions[names[-1]]
            # A subscriber at each end that is known at the other: what is declared later is known soon, too.
            for here, there, name in ((first, last, names[-1]), (last, first, names[0])):
                key = keys.STATE.key("linked", name)
                subscriber = there.declare_subscriber(key)
                await net.linked(here, key)
                subscriber.undeclare()
            return made, await made.ask(names[0])

        yield start
