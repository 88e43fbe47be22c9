"""The right to fly ends while the stream goes on: the vehicle holds at once, and long before the stream is stale."""

from __future__ import annotations

import asyncio

import pytest

from tests.failsafe.conftest import PATIENT, agent, another, held, moves, nothing_more, stops
from tests.services.conftest import ARM, FAILED, SET_MODE, TAKEOFF, StartBench
from zmav.config import Failsafe
from zmav.errors import Refused, TimedOut, ZmavError

RTL = 6


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
    b = await bench(settings={"failsafe": Failsafe(hold_after=0.2, land_after=0.5)})
    alice = await agent(b)
    await alice.fly()
    await b.ground.do("revoke")
    await held(b)
    await b.peer.until(lambda: len(stops(b)) >= 4, "all its holds")
    await nothing_more(b)
    assert b.peer.mode == 4


@pytest.mark.parametrize("what", ["takeoff", "arm", "mission_current", "lease"])
async def test_what_comes_to_nothing_later_sends_nobody_home(bench: StartBench, what: str) -> None:
    """The stream was ended on purpose long ago: an order that is refused, or a lease that runs out, is no lost link."""
    b = await bench(settings={"failsafe": Failsafe(hold_after=0.2, land_after=0.5)})
    alice = await agent(b)
    await alice.fly()
    await b.ground.do("release", lease=alice.token)
    await held(b)
    await b.peer.until(lambda: len(stops(b)) >= 4, "all its holds")
    await nothing_more(b)  # for longer than land_after
    if what == "lease":
        await b.ground.do("lease", holder="bob", ttl=0.1)
        await b.event("lease of bob ran out")
    elif what == "arm":
        await b.ground.do("arm")  # it is
    else:
        b.peer.results[TAKEOFF] = [FAILED]
        with pytest.raises(ZmavError):
            await b.ground.do(what, **({"alt_rel": 5.0} if what == "takeoff" else {"index": 3}))
    for _ in range(8):  # 5 Hz: longer than land_after
        await b.state(lambda s: True, "a moment")
    assert b.peer.commands(SET_MODE) == []


async def test_after_an_order_that_came_to_nothing_the_action_follows_the_hold(bench: StartBench) -> None:
    """As long after it as after any other: while the order lasted, nobody was missed."""
    b = await bench(settings={"failsafe": Failsafe(hold_after=0.2, land_after=3.0)})
    alice = await agent(b)
    await alice.fly()
    b.peer.mute = {TAKEOFF}
    with pytest.raises(TimedOut):
        await b.ground.do("takeoff", alt_rel=5.0, lease=alice.token)
    failed = asyncio.get_running_loop().time()
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    assert b.peer.commands(SET_MODE)[0].at - failed > 2.0


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


@pytest.mark.parametrize("how", ["preempted", "revoked", "released"])
async def test_who_waits_to_arm_it_does_not_once_the_lease_has_ended(bench: StartBench, how: str) -> None:
    b = await (await bench()).connected()
    alice = await another(b, "alice")
    order = asyncio.create_task(b.ground.do("arm", ready_timeout=60.0, lease=alice.token))
    await b.state(lambda s: s["mover"] == "order", "the order")
    if how == "preempted":
        await another(b, "bob", priority=5)
    elif how == "revoked":
        await b.ground.do("revoke")
    else:
        await b.ground.do("release", lease=alice.token)
    await b.state(lambda s: s["mover"] == "nobody", "the order's end")
    b.peer.send("SYS_STATUS", onboard_control_sensors_health=0x10000000)
    b.peer.send("EKF_STATUS_REPORT", flags=16)
    await b.state(lambda s: s["ready"], "ready")
    with pytest.raises(Refused, match="superseded"):
        await order
    assert b.peer.commands(ARM) == []
