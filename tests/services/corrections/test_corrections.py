"""Corrections on their way to an autopilot: byte for byte, at the pace of its link, and never of two bases at once."""

from __future__ import annotations

import asyncio
import functools
import itertools
import time
from typing import TYPE_CHECKING

import pytest

from tests.rtcm import HOME, STATION, base_at, message, satellites
from zmav import keys
from zmav.corrections import OLDEST_S, PATIENCE_S, ROOM, Batch
from zmav.formats.rtcm3 import Message
from zmav.mavlink.rtcm import Joiner
from zmav.services.corrections.outgoing import FREE, LEAST, MOST_WAITING, Outgoing, Pace
from zmav.services.link.port import BUSY_S

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench

EPOCH = [base_at(), message(1077, size=400), message(1087, size=260), message(1230, size=20)]
sequence = itertools.count()


def batch(
    *messages: bytes, instance: int = 1, since: int = 1, priority: int = 0, t: float | None = None, source: str = "gs"
) -> Batch:
    t_us = round((time.time() if t is None else t) * 1e6)
    return Batch(priority, instance, since, t_us, next(sequence), source, tuple(Message(m) for m in messages or EPOCH))


def put(b: Bench, *batches: Batch | bytes) -> None:
    for each in batches:
        b.ground.put(keys.RTCM, each if isinstance(each, bytes) else each.pack())


def given(b: Bench) -> bytes:
    """What the autopilot was given, put together as it does it."""
    joiner, found = Joiner(), b""
    for told in b.peer.heard("GPS_RTCM_DATA"):
        found += joiner.add(told.fields["flags"], told.fields["len"], bytes(told.fields["data"]))
    return found


async def comes(b: Bench, data: bytes) -> None:
    await b.peer.until(lambda: given(b).endswith(data), "corrections at the autopilot")


async def test_the_autopilot_gets_them_byte_for_byte(bench: StartBench) -> None:
    b = await (await bench()).connected()
    put(b, batch())
    await comes(b, b"".join(EPOCH))
    assert given(b) == b"".join(EPOCH)
    put(b, batch(message(1077, size=1023), message(1127, size=777)))
    await comes(b, message(1077, size=1023) + message(1127, size=777))
    state = await b.state(lambda s: bool(s.get("corrections")), "corrections in its state")
    found = state["corrections"]
    assert (found["source"], found["station"]) == ("gs", STATION)
    assert 0.0 <= found["age"] < 3.0
    assert found["rate"] > 100
    await b.event("corrections come from gs")


async def test_where_the_base_is(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lat, lon, _ = HOME
    b.peer.send("GPS_RAW_INT", fix_type=3)
    b.peer.place = lat + 0.01, lon
    await b.state(lambda s: bool(s.get("position")), "its position")
    put(b, batch())
    state = await b.state(lambda s: bool((s.get("corrections") or {}).get("baseline")), "a baseline")
    assert state["corrections"]["baseline"] == pytest.approx(1109, abs=3)
    put(b, batch(base_at(lat + 0.001)))
    await b.event("the base of gs moved by 111.0 m", severity="warning")
    assert b.vehicle.corrections.messages >= 1


async def test_corrections_of_another_place_are_told_of(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.send("GPS_RAW_INT", fix_type=3)
    b.peer.place = HOME[:2]
    await b.state(lambda s: bool(s.get("position")), "its position")
    put(b, batch(base_at(51.5, -0.1, 100.0), satellites()))
    await b.event("its corrections are another place's", severity="warning")


async def test_a_base_far_away_is_told_of_by_who_finds_out_only_then_where_it_is(bench: StartBench) -> None:
    """As with a receiver that is switched on while 'zmav rtk' runs."""
    b = await (await bench()).connected()
    far = batch(base_at(51.5, -0.1, 100.0), satellites())
    put(b, far)
    await comes(b, far.messages[-1].data)
    b.peer.send("GPS_RAW_INT", fix_type=3)
    b.peer.place = HOME[:2]
    await b.state(lambda s: bool(s.get("position")), "its position")
    put(b, batch(base_at(51.5, -0.1, 100.0), satellites()))
    await b.event("its corrections are another place's", severity="warning")


@pytest.mark.parametrize(("off", "reason", "words"), [(-6.0, "old", "s old"), (6.0, "ahead", "ahead of our clock")])
async def test_what_is_not_of_now_is_dropped(bench: StartBench, off: float, reason: str, words: str) -> None:
    b = await (await bench()).connected()
    put(b, batch(t=time.time() + off))
    event = await b.event(words, kind="corrections")
    assert event["severity"] == "warning"
    put(b, batch())
    await comes(b, b"".join(EPOCH))
    state = await b.state(lambda s: bool(s.get("corrections")), "those of now")
    assert state["corrections"]["dropped"] == {reason: len(EPOCH)}
    assert given(b) == b"".join(EPOCH)


async def test_two_bases_are_never_mixed(bench: StartBench) -> None:
    b = await (await bench()).connected()
    first = [batch(message(1077, size=50, seed=i), instance=1, since=10) for i in range(3)]
    other = [batch(message(1077, size=50, seed=i, station=9), instance=2, since=20, source="b") for i in range(3)]
    for one, two in zip(first, other, strict=True):
        put(b, one, two)
        await comes(b, one.messages[0].data)
    state = await b.state(lambda s: bool(s.get("corrections")), "corrections")
    assert state["corrections"]["dropped"]["standby"] >= 2
    assert given(b) == b"".join(each.messages[0].data for each in first)
    put(b, batch(message(1077, station=9), instance=3, since=5, priority=1, source="best"))
    await comes(b, message(1077, station=9))
    await b.event("corrections come from best now, and no more from gs", severity="notice")


async def test_garbage_reaches_no_autopilot(bench: StartBench) -> None:
    b = await (await bench()).connected()
    good = batch(message(1097))
    spoilt = bytearray(good.pack())
    spoilt[-5] ^= 1
    put(b, b"", b"zR", bytes(5000), bytes(spoilt), good.pack() + b"more")
    await asyncio.sleep(0.2)
    put(b, good)
    await comes(b, message(1097))
    assert given(b) == message(1097)
    state = await b.state(lambda s: bool(s.get("corrections")), "corrections")
    assert state["corrections"]["dropped"]["malformed"] >= 1


async def test_a_flood_waits_for_the_loop_and_not_in_it(bench: StartBench) -> None:
    """Orders are looked at there, too: of what comes while it is busy only the newest is left."""
    b = await (await bench()).connected()
    old, began = time.time() - 2 * OLDEST_S, time.monotonic()
    for _ in range(300):
        put(b, batch(message(1077), t=old))
        time.sleep(0.002)  # the loop has no time
    took = time.monotonic() - began
    put(b, batch(message(1087)))
    await comes(b, message(1087))
    state = await b.state(lambda s: bool(s.get("corrections")), "corrections in its state")
    assert state["corrections"]["dropped"]["old"] <= (3 + took // BUSY_S) * 16


async def test_a_slow_line_has_room_for_commands(bench: StartBench) -> None:
    """Of 57,600 baud a quarter: a flood of corrections takes 1.4 kB/s, and each fragment waits for the last."""
    b = await (await bench()).connected()
    b.vehicle.corrections.pace = pace = Pace(lambda: 5760.0)
    assert pace.rate == 1440.0
    began, until = time.monotonic(), time.monotonic() + 3.0
    while time.monotonic() < until:
        put(b, batch(message(1077, size=900), message(1087, size=600)))
        await asyncio.sleep(0.1)
    told, took = b.peer.heard("GPS_RTCM_DATA"), time.monotonic() - began
    assert sum(t.fields["len"] + 16 for t in told) <= pace.rate * (took + 0.5) + 200
    assert sum(t.fields["len"] for t in told) > 0.6 * pace.rate * took
    gaps = [two.at - one.at for one, two in itertools.pairwise(told) if one.fields["len"] == 180]
    assert sorted(gaps)[len(gaps) // 2] > 0.1
    state = await b.state(lambda s: bool(s.get("corrections")), "corrections")
    assert state["corrections"]["dropped"]["overtaken"] > 10
    assert state["corrections"]["rate"] <= 1.1 * pace.rate


async def test_it_says_when_they_stop(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.vehicle.corrections.silent_s = 1.0
    put(b, batch())
    await b.event("corrections come from gs")
    await b.event("no corrections for", severity="warning")


class TestOutgoing:
    def test_the_newest_of_a_number_wins(self) -> None:
        queue = Outgoing()
        queue.put(batch(base_at(), message(1077, seed=1), message(1087, seed=1), t=100.0))
        queue.put(batch(message(1077, seed=2), t=101.0))
        found = [each.message for each in iter(lambda: queue.next(101.0), None)]
        assert [each.number for each in found] == [1005, 1087, 1077]
        assert found[-1].data == message(1077, seed=2)
        assert queue.dropped == {"overtaken": 1}

    def test_a_moment_that_has_begun_is_finished_and_the_newest_follows(self) -> None:
        """No system of satellites starves on a line that is too slow for all."""
        queue = Outgoing()
        queue.put(batch(message(1074, seed=1), message(1084, seed=1), t=100.0))
        first = queue.next(100.0)
        queue.put(batch(message(1094, seed=1), t=100.0))
        for t in (101.0, 102.0):
            queue.put(batch(message(1074, seed=int(t)), message(1084, seed=int(t)), t=t))
        found = [each.message.data for each in iter(lambda: queue.next(102.0), None)]
        assert first is not None
        assert first.message.number == 1074
        assert found == [message(1084, seed=1), message(1094, seed=1), message(1074, seed=102), message(1084, seed=102)]
        assert queue.dropped == {"overtaken": 2}

    def test_two_of_one_number_and_moment_are_both_kept(self) -> None:
        queue = Outgoing()
        queue.put(batch(message(1077, seed=1), message(1077, seed=2), t=100.0))
        queue.put(batch(message(1077, seed=3), t=100.0))
        assert [each.message.data for each in iter(lambda: queue.next(100.0), None)] == [
            message(1077, seed=n) for n in (1, 2, 3)
        ]

    def test_what_has_become_old_is_not_begun(self) -> None:
        queue = Outgoing()
        queue.put(batch(t=100.0))
        assert queue.next(100.0 + OLDEST_S + 0.1) is None
        assert queue.dropped["old"] == len(EPOCH)

    def test_it_is_bounded(self) -> None:
        queue = Outgoing()
        for number in range(1000, 1100):
            queue.put(batch(message(number, size=ROOM), t=100.0))
        count = sum(1 for _ in iter(lambda: queue.next(100.0), None))
        assert count <= MOST_WAITING // ROOM
        assert queue.dropped["full"] == 100 - count

    def test_a_flood_of_small_messages_costs_little(self) -> None:
        queue, small = Outgoing(), [message(1000 + i, size=3) for i in range(200)]
        began = time.thread_time()
        for t in range(500):
            queue.put(batch(*small, t=100.0))
            if not t:
                queue.next(100.0)
        assert time.thread_time() - began < 1.0
        assert queue.dropped["full"] > 10_000

    def test_shares_of_lines(self) -> None:
        lines: tuple[float | None, ...] = (None, 960.0, 5760.0, 92160.0)
        rates = {capacity: Pace(functools.partial(next, itertools.repeat(capacity))).rate for capacity in lines}
        assert rates == {None: FREE, 960.0: LEAST, 5760.0: 1440.0, 92160.0: FREE}


def test_a_standby_is_waited_for_longer_than_slow_bases_pause() -> None:
    assert PATIENCE_S > OLDEST_S >= 5.0
