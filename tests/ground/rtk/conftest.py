"""A fleet's ground for sources of corrections: a router, clients of it, and who listens on the fleet's key."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

import pytest

import zmav
from ground.corrections import Publisher
from zmav import keys
from zmav.corrections import Batch, unpack
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.conftest import Net, Samples


class Fleet:
    """One router, and what is heard on ``@fleet/rtcm`` there."""

    def __init__(self, net: Net) -> None:
        self.net = net
        self.router, self.endpoint = net.router()
        self.samples: Samples = net.ground(self.endpoint).samples(keys.RTCM)
        self.said: list[str] = []

    @property
    def batches(self) -> list[Batch]:
        return [unpack(payload) for _, payload in self.samples.items]

    @property
    def data(self) -> bytes:
        return b"".join(each.data for batch in self.batches for each in batch.messages)

    @contextlib.asynccontextmanager
    async def client(self, endpoint: str = "") -> AsyncIterator[zmav.Client]:
        async with zmav.open(settings=SessionSettings(connect=[endpoint or self.endpoint])) as z:
            yield z

    @contextlib.asynccontextmanager
    async def publisher(self, name: str, **more: object) -> AsyncIterator[Publisher]:
        async with self.client() as z:
            with Publisher(z, name, self.said.append, **{"listen": 0.0, **more}) as one:  # type: ignore[arg-type]
                await self.net.linked(z.session, keys.RTCM.key("demo"))
                yield one


@pytest.fixture
def fleet(net: Net) -> Fleet:
    return Fleet(net)
