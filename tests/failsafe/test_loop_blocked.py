"""The event loop that everything else lives on is blocked: the watchdog is not."""

from __future__ import annotations

import asyncio
import time
from itertools import pairwise
from typing import Any

import pytest

from tests.failsafe.conftest import PATIENT, agent
from tests.services.conftest import StartBench
from zmav.mavlink import decode, parse_frame


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def spin(seconds: float) -> None:
    """Work that never lets go of the interpreter by itself."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        sum(range(1000))


@pytest.mark.parametrize("block", [sleep, spin])
async def test_it_holds_in_time(bench: StartBench, monkeypatch: pytest.MonkeyPatch, block: Any) -> None:
    b = await bench()
    alice = await agent(b)
    sent: list[tuple[float, bytes]] = []
    send = b.vehicle.adapter.send_raw

    def record(data: bytes) -> bool:
        sent.append((time.monotonic(), data))
        return send(data)

    monkeypatch.setattr(b.vehicle.adapter, "send_raw", record)
    await alice.fly()
    block(1.5)
    free = time.monotonic()  # nothing ran on the loop between
    frames = [(at, parse_frame(data, b.peer.dialect)) for at, data in sent]
    told = [(at, decode(frame, b.peer.dialect)) for at, frame in frames if frame.msgid == 84]
    flown = next(at for at, f in told if f["vx"] != 0.0)
    stopped = next((at for at, f in told if f["vx"] == 0.0), free)
    assert stopped < free
    assert stopped - flown > 0.45


async def test_setpoints_that_wait_leave_others_their_turn(bench: StartBench) -> None:
    """A segment may take a tenth of a second to judge: an order to hold does not wait for all that came before it."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    counts = b.vehicle.authority.setpoints.counts
    before = counts.total()
    for _ in range(20):
        alice.put()
    sleep(0.5)  # until all of them wait
    judged = [before]
    while judged[-1] < before + 20:
        await asyncio.sleep(0)  # a turn of the loop
        judged.append(counts.total())
    assert max(after - earlier for earlier, after in pairwise(judged)) == 1


async def test_none_of_them_is_flown_once_nobody_watches_any_more(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    setpoints = b.vehicle.authority.setpoints
    before = setpoints.counts.total()
    for _ in range(20):
        alice.put()
    sleep(0.5)  # until all of them wait
    setpoints.close()
    await b.state(lambda s: True, "a moment")
    assert setpoints.counts.total() == before
