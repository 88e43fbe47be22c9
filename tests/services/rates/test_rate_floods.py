"""Wishes for messages by the thousand: the fastest of each are kept, and nobody is shut out."""

# ruff: noqa: F811 (fixtures of another file)
from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from tests.services.rates.test_rate import flows, on, one, quick, token  # noqa: F401  (fixtures)
from zmav.mavlink import load_dialect
from zmav.services.rates.demand import FASTEST, Demands

if TYPE_CHECKING:
    from tests.services.conftest import StartBench
    from tests.services.rates.rate_peer import StreamPeer


async def test_who_comes_late_is_served_however_many_wishes_there_are(bench: StartBench, one: StreamPeer) -> None:
    """A member that may read may wish: of each message the fastest wishes are remembered, and no others."""
    b = await on(bench, one)
    names = [name for name in load_dialect().by_name if name != "VFR_HUD"][:100]
    flood = [token(b.ground, names[n % 100], 0.5 + n / 1000, f"flood-{n}") for n in range(2500)]
    late = token(b.ground, "VFR_HUD", 20, "late-1")
    await flows(one, "VFR_HUD", 20.0)
    readers = b.vehicle.rates.demands.current()
    assert sum(map(len, readers.values())) <= FASTEST * len(names) + 1
    assert max(demand.hz for demand in readers[names[0]]) == 0.5 + 2.4, "the fastest is among them"
    for held in (*flood, late):
        held.undeclare()


async def test_who_was_left_out_is_found_again_when_faster_readers_have_gone(
    bench: StartBench,
    one: StreamPeer,
) -> None:
    b = await on(bench, one)
    b.vehicle.rates.demands.ask_again = 0.4
    slow = token(b.ground, "VFR_HUD", 7, "slow-1")
    await flows(one, "VFR_HUD", 7.0)
    fast = [token(b.ground, "VFR_HUD", 30, f"fast-{n}") for n in range(2 * FASTEST)]
    await flows(one, "VFR_HUD", 30.0)
    for held in fast:
        held.undeclare()
    await flows(one, "VFR_HUD", 7.0)
    slow.undeclare()


async def test_a_flood_of_wishes_is_planned_for_once_in_a_while(bench: StartBench, one: StreamPeer) -> None:
    """Each plan looks at all that is wanted, so not every wish may cause one."""
    b, plans = await on(bench, one), list[float]()
    demands = Demands(b.vehicle.companion, lambda: plans.append(time.monotonic()))
    demands.quiet = 3600.0
    demands.start()
    held = [token(b.ground, "VFR_HUD", n, f"flood-{n}") for n in range(1, 201)]
    await flows(one, "VFR_HUD", 200.0)
    while max((each.hz for each in demands.current().get("VFR_HUD", ())), default=0.0) < 200.0:
        await asyncio.sleep(0.01)
    assert len(plans) <= 1
    demands.close()
    for each in held:
        each.undeclare()


async def test_a_wish_for_next_to_nothing_keeps_no_other_from_being_asked_for(
    bench: StartBench, one: StreamPeer
) -> None:
    """Its interval fits no field of MAVLink."""
    b = await on(bench, one)
    held = [token(b.ground, "ATTITUDE_QUATERNION", "1e-300", "slow-1"), token(b.ground, "VFR_HUD", 20, "late-1")]
    await flows(one, "VFR_HUD", 20.0)
    assert all(0 < interval < 2**31 for interval in one.asked("ATTITUDE_QUATERNION"))
    for each in held:
        each.undeclare()


async def test_who_wishes_for_next_to_nothing_keeps_no_other_from_the_same_message(
    bench: StartBench, one: StreamPeer
) -> None:
    """Neither by how long an answer to it would take, nor as the most that there is of it."""
    b = await on(bench, one)
    one.later, one.fastest = {"VFR_HUD"}, 15.0
    held = [token(b.ground, name, "1e-300", "slow-1") for name in ("VFR_HUD", "ATTITUDE_QUATERNION")]
    await b.event("VFR_HUD at 0.0167 Hz refused: TEMPORARILY_REJECTED")
    await one.until(lambda: "ATTITUDE_QUATERNION" in one.rates, "it, as seldom as that")
    one.later = set()
    held += [token(b.ground, "VFR_HUD", 12, "late-1"), token(b.ground, "ATTITUDE_QUATERNION", 20, "late-1")]
    await flows(one, "VFR_HUD", 12.0)
    await flows(one, "ATTITUDE_QUATERNION", 10.0)  # 20 are more than there is
    for each in held:
        each.undeclare()
