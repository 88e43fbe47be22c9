"""The right to fly ends while the stream goes on: the vehicle holds at once, and long before the stream is stale."""

from __future__ import annotations

import asyncio

import pytest

from tests.failsafe.conftest import PATIENT, agent, another, held, moves, nothing_more, stops
from tests.services.conftest import StartBench
from zmav.errors import Refused


@pytest.mark.parametrize("how", ["expired", "revoked", "released"])
async def test_lease(bench: StartBench, how: str) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    if how == "expired":
        await b.ground.do("lease", holder="alice", ttl=0.1, lease=alice.token)
    elif how == "revoked":
        await b.ground.do("revoke", reason="enough")
    else:
        await b.ground.do("release", lease=alice.token)
    await held(b)
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert (end["holder"], end["reason"]) == ("alice", how)
    flown = len(moves(b))
    alice.put()
    await b.state(lambda s: s["setpoints"].get("lease") == 1, "refused setpoint")
    await b.event("no such lease on quad1 any more", kind="setpoint")
    assert len(moves(b)) == flown


async def test_preempted(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b, priority=10)
    await alice.fly()
    bob = await another(b, "bob", priority=11)
    await held(b)
    alice.put()
    said = await b.event("bob (priority 11) took the lease from alice (10); bob commands quad1", kind="setpoint")
    assert said["detail"]["why"] == "lease"
    await bob.fly()
    assert moves(b)[-1].at > stops(b)[0].at


async def test_what_somebody_meant_ends_with_the_hold(bench: StartBench) -> None:
    """A revoked lease is no reason to fly home: somebody is there."""
    from zmav.config import Failsafe

    b = await bench(settings={"failsafe": Failsafe(hold_after=0.2, land_after=0.5)})
    alice = await agent(b)
    await alice.fly()
    await b.ground.do("revoke")
    await held(b)
    await b.peer.until(lambda: len(stops(b)) >= 4, "all its holds")
    await nothing_more(b)
    assert b.peer.mode == 4


FAR = {"frame": "global", "lat_deg": -35.005, "lon_deg": 149.0, "alt_rel": 10.0}


@pytest.mark.parametrize("how", ["preempted", "revoked", "released"])
async def test_an_order_under_way_ends_with_the_lease_it_was_given_under(bench: StartBench, how: str) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    b.peer.send("GLOBAL_POSITION_INT", lat=-350000000, lon=1490000000, relative_alt=10000)
    await b.state(lambda s: s["position"], "position")
    order = asyncio.create_task(b.ground.do("goto", lease=alice.token, **FAR))
    await b.peer.count("SET_POSITION_TARGET_GLOBAL_INT", 1)
    if how == "preempted":
        bob = await another(b, "bob", priority=5)
    elif how == "revoked":
        await b.ground.do("revoke")
    else:
        await b.ground.do("release", lease=alice.token)
    with pytest.raises(Refused, match="superseded"):
        await order
    await held(b)
    told = len(b.peer.heard("SET_POSITION_TARGET_GLOBAL_INT"))
    if how == "preempted":
        await bob.fly()  # nothing of alice's keeps the vehicle busy
    for _ in range(4):
        await b.state(lambda s: True, "a moment")
    assert len(b.peer.heard("SET_POSITION_TARGET_GLOBAL_INT")) == told
