"""What a source puts on the fleet's key: moments whole, once, bounded, and one source at a time."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

import zmav
from ground.corrections import BURST, GATHER_S, MOST_RATE, Publisher, may_publish
from tests.rtcm import HOME, base_at, message
from tests.waiting import until
from zmav import geo, keys
from zmav.corrections import HEADER, MOST_NAME, ROOM, Batch
from zmav.errors import BadConfig
from zmav.formats.rtcm3 import Message
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.ground.rtk.conftest import Fleet

EPOCH = [base_at(), message(1077, size=400), message(1087, size=300)]


async def test_a_moment_is_one_batch_and_byte_for_byte(fleet: Fleet) -> None:
    async with fleet.publisher("gs") as one:
        for data in EPOCH:
            one.feed(b"$GN" + data)
        await until(lambda: fleet.data == b"".join(EPOCH), "corrections")
        (batch,) = fleet.batches
        assert batch.source == "gs"
        assert abs(batch.t - time.time()) < 5.0
        assert one.in_charge
        assert one.base is not None
        assert geo.from_ecef(one.base) == pytest.approx(HOME, abs=1e-3)
        assert one.station == 1234
        assert one.numbers == {1005: 1, 1077: 1, 1087: 1}
    assert fleet.said == ["in charge: corrections go to the fleet as gs"]


async def test_a_base_with_a_slow_line_has_one_moment_too(fleet: Fleet) -> None:
    """Its messages come one after the other."""
    data = [message(1000 + number, size=60) for number in range(5)]
    async with fleet.publisher("gs", gather=(1.0, 30.0)) as one:
        for each in data:
            one.feed(each)
            await asyncio.sleep(0.02)
        await until(lambda: fleet.data == b"".join(data), "the moment")
    assert len(fleet.batches) == 1


async def test_a_base_that_never_pauses_is_not_waited_for(fleet: Fleet) -> None:
    data = [message(1000 + number, size=60) for number in range(20)]
    async with fleet.publisher("gs", gather=(1.0, 0.2)) as one:
        for each in data:
            one.feed(each)
            await asyncio.sleep(0.03)
        await until(lambda: fleet.data == b"".join(data), "all of it")
    assert len(fleet.batches) >= 3


async def test_a_moment_is_not_waited_for_longer_than_is_usual(fleet: Fleet) -> None:
    """However busy the machine is: what was fed for twice as long as a moment lasts is of two at least."""
    data = message(1077, size=20)
    async with fleet.publisher("gs") as one:
        fed, began = 0, time.monotonic()
        while fed < 3 or time.monotonic() - began < 2.2 * GATHER_S[1]:
            one.feed(data)
            fed += 1
            await asyncio.sleep(0.01)
        await until(lambda: fleet.data == fed * data, "all of it")
    assert len(fleet.batches) >= 2


async def test_a_rich_moment_is_cut_for_datagrams(fleet: Fleet) -> None:
    data = [message(number, size=600) for number in (1077, 1087, 1097, 1127)]
    async with fleet.publisher("gs") as one:
        one.feed(b"".join(data))
        await until(lambda: fleet.data == b"".join(data), "corrections")
    assert len(fleet.batches) == 4
    assert len({batch.t_us for batch in fleet.batches}) == 1
    assert [batch.sequence for batch in fleet.batches] == [0, 1, 2, 3]
    assert all(len(payload) <= HEADER.size + MOST_NAME + ROOM for _, payload in fleet.samples.items)


async def test_a_flood_is_bounded(fleet: Fleet) -> None:
    async with fleet.publisher("gs") as one:
        began = time.monotonic()
        for seed in range(200):
            one.feed(message(1077, size=1000, seed=seed))
        took = time.monotonic() - began
        await asyncio.sleep(0.3)
        assert len(fleet.data) <= BURST + MOST_RATE * took
        assert one.flooded > 150


async def test_the_second_stands_by_and_takes_over_when_the_first_is_silent(fleet: Fleet) -> None:
    async with fleet.publisher("a", patience=1.5) as a, fleet.publisher("b", patience=1.5) as b:
        a.feed(message(1077, seed=0))
        await until(lambda: len(fleet.batches) == 1, "the first's")
        for seed in range(1, 6):
            b.feed(message(1087, seed=seed))
            a.feed(message(1077, seed=seed))
            await asyncio.sleep(0.2)
        assert {batch.source for batch in fleet.batches} == {"a"}
        assert (b.stands_by_for, b.in_charge, a.in_charge) == ("a", False, True)
        began = time.monotonic()
        while not b.in_charge:
            b.feed(message(1087))
            await asyncio.sleep(0.1)
            assert time.monotonic() - began < 10.0
        assert time.monotonic() - began > 1.0
        for seed in range(6):  # it comes back, and is the younger one now
            a.feed(message(1077, seed=seed))
            b.feed(message(1087, seed=seed))
            await asyncio.sleep(0.2)
        await until(lambda: fleet.batches[-1].source == "b", "the second's")
        assert (a.stands_by_for, a.in_charge) == ("b", False)
    assert fleet.said == [
        "in charge: corrections go to the fleet as a",
        "stands by: a is in charge",
        "in charge: corrections go to the fleet as b",
        "stands by: b is in charge",
    ]


async def test_one_that_begins_listens_first(fleet: Fleet) -> None:
    async with fleet.publisher("a") as a, fleet.publisher("b", listen=1.0) as b:
        for seed in range(15):
            b.feed(message(1087, seed=seed))
            a.feed(message(1077, seed=seed))
            await asyncio.sleep(0.1)
        assert {batch.source for batch in fleet.batches} == {"a"}
        assert b.stands_by_for == "a"


async def test_a_higher_priority_takes_over_at_once(fleet: Fleet) -> None:
    async with fleet.publisher("a") as a, fleet.publisher("b", priority=5) as b:
        a.feed(message(1077))
        await until(lambda: a.in_charge and bool(fleet.batches), "the first in charge, and heard")
        b.feed(message(1087))
        await until(lambda: fleet.batches[-1].source == "b", "the second's")
        await asyncio.sleep(0.1)
        a.feed(message(1077))
        await until(lambda: a.stands_by_for == "b", "the first to stand by")


@pytest.mark.parametrize("off", [-6.0, 6.0])
async def test_one_whose_clock_is_wrong_keeps_nobody_away(fleet: Fleet, off: float) -> None:
    """Every vehicle drops what it says."""
    wrong = Batch(9, 1, 1, round((time.time() + off) * 1e6), 0, "wrong", (Message(message(1077, seed=1)),))
    async with fleet.publisher("a") as a, fleet.client() as z:
        z.session.put(keys.RTCM.key("demo"), wrong.pack())
        await until(lambda: bool(fleet.batches), "the wrong one's")
        await asyncio.sleep(0.2)
        a.feed(message(1087))
        await until(lambda: fleet.batches[-1].source == "a", "corrections of now")
        assert (a.stands_by_for, a.in_charge) == ("", True)


async def test_garbage_on_the_key_ends_nothing(fleet: Fleet) -> None:
    async with fleet.publisher("a") as a, fleet.client() as z:
        for wrong in (b"", b"zR", bytes(5000)):
            z.session.put(keys.RTCM.key("demo"), wrong)
        await asyncio.sleep(0.2)
        a.feed(message(1077))
        await until(lambda: any(payload[:2] == b"zR" and len(payload) > 60 for _, payload in fleet.samples.items))


async def test_corrections_are_one_fleets(fleet: Fleet) -> None:
    for name in ("*", "demo-replay"):
        async with zmav.open(fleet=name, settings=SessionSettings(connect=[fleet.endpoint])) as z:
            assert not may_publish(z)
            with pytest.raises(BadConfig, match="name it with --fleet"):
                Publisher(z, "gs")
