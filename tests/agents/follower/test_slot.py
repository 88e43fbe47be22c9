"""One vehicle for each place above a target, by tokens alone."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
import zenoh

from agents.follower.slot import Slot
from zmav import keys
from zmav.errors import Refused
from zmav.session import SessionSettings, open_session

if TYPE_CHECKING:
    from tests.conftest import Net


Open = Callable[[str], zenoh.Session]


@pytest.fixture
def client() -> Iterator[Open]:
    """Sessions with a router; closed at the end."""
    opened: list[zenoh.Session] = []

    def open_one(endpoint: str) -> zenoh.Session:
        opened.append(open_session(SessionSettings(connect=[endpoint])))
        return opened[-1]

    yield open_one
    for session in opened:
        session.close()


async def test_the_second_is_refused_and_told_by_whom(net: Net, client: Open) -> None:
    _, endpoint = net.router()
    one, two = client(endpoint), client(endpoint)
    async with Slot(one, keys.anything, "demo", "quad1", "rover1", "above"):
        second = Slot(two, keys.anything, "demo", "quad2", "rover1", "above")
        second.leaves = 0.5  # the first one's token stays
        with pytest.raises(Refused, match="quad1 keeps the place above rover1 already"):
            async with second:
                raise AssertionError
        async with (
            Slot(two, keys.anything, "demo", "quad2", "rover1", "left"),
            Slot(two, keys.anything, "demo", "quad2", "rover2", "above"),
        ):
            pass
    async with Slot(two, keys.anything, "demo", "quad2", "rover1", "above"):
        pass


async def test_what_was_left_is_free_at_once_for_who_was_refused(net: Net, client: Open) -> None:
    """Of many: a router may tell who subscribes as a token goes that it is gone, and only then that it is there."""
    _, endpoint = net.router()
    one, two = client(endpoint), client(endpoint)

    async def left_and_taken(target: str) -> None:
        async with Slot(one, keys.anything, "demo", "quad1", target, "above"):
            with pytest.raises(Refused):
                async with Slot(two, keys.anything, "demo", "quad2", target, "above"):
                    raise AssertionError
        async with Slot(two, keys.anything, "demo", "quad2", target, "above"):
            pass

    await asyncio.gather(*(left_and_taken(f"rover{n}") for n in range(60)))


async def test_of_two_at_once_one_gets_it(net: Net, client: Open) -> None:
    _, endpoint = net.router()
    sessions = [client(endpoint) for _ in range(3)]
    slots = [Slot(session, keys.anything, "demo", f"quad{i}", "rover1", "above") for i, session in enumerate(sessions)]
    results = await asyncio.gather(*(slot.__aenter__() for slot in slots), return_exceptions=True)
    assert sum(isinstance(result, Slot) for result in results) == 1
    assert sum(isinstance(result, Refused) for result in results) == 2


async def test_who_comes_while_another_leaves_has_it(net: Net, client: Open) -> None:
    _, endpoint = net.router()
    one, two = client(endpoint), client(endpoint)
    first = Slot(one, keys.anything, "demo", "quad1", "rover1", "above")
    await first.__aenter__()
    leaves = asyncio.get_running_loop().create_task(slot_left(first, 1.0))  # its token was seen, and is gone only then
    async with Slot(two, keys.anything, "demo", "quad2", "rover1", "above"):
        assert leaves.done()


async def slot_left(left: Slot, after: float) -> None:
    await asyncio.sleep(after)
    await left.__aexit__()


async def test_an_earlier_claim_that_comes_to_light_later_wins(net: Net, client: Open) -> None:
    _, endpoint = net.router()
    mine, other = client(endpoint), client(endpoint)
    lost: asyncio.Queue[str] = asyncio.Queue()
    async with Slot(mine, keys.anything, "demo", "quad1", "rover1", "above", lost.put_nowait) as kept:
        now = int(1e3 * time.time())
        tokens = [
            other.liveliness().declare_token(
                keys.SLOT.key("demo", vehicle, target="rover1", slot="above", since=since, instance=f"of-{vehicle}")
            )
            for since, vehicle in ((now + 60_000, "quad3"), (now - 60_000, "quad2"))
        ]
        assert await asyncio.wait_for(lost.get(), 30.0) == "quad2"
        assert kept.better == "quad2"
        assert len(tokens) == 2
