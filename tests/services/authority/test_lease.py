"""One commander at a time: granted, renewed, run out, given back, preempted, revoked, ended with its holder."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest
import zenoh

import zmav
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import BadInput, NotHolder

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import Bench, StartBench

AWAY = "0badc0de"
"""a router that answers nobody"""


async def take(b: Bench, holder: str = "alice", ttl: float = 30.0, **more: object) -> str:
    token: str = (await b.ground.do("lease", holder=holder, ttl=ttl, **more)).result["lease"]
    return token


def here(b: Bench, holder: str, instance: str) -> zenoh.LivelinessToken:
    """The holder's liveliness token."""
    return b.ground.session.liveliness().declare_token(
        keys.HOLDER.key("demo", "quad1", holder=holder, instance=instance)
    )


async def test_granted_shown_and_given_back(bench: StartBench) -> None:
    b = await (await bench()).connected()
    before = time.time()
    outcome = await b.ground.do("lease", holder="alice", ttl=30.0)
    assert (outcome.result["holder"], outcome.result["ttl"]) == ("alice", 30.0)
    lease = (await b.state(lambda s: s["lease"], "lease"))["lease"]
    assert lease["holder"] == "alice"
    assert before + 29.9 < lease["expires"] < time.time() + 30.1
    assert outcome.result["lease"] not in str(b.states.objects()) + str(b.events.objects())
    await b.event("alice commands", kind="lease")
    with pytest.raises(NotHolder, match="alice commands quad1"):
        await b.ground.do("release", lease="guess")
    await b.ground.do("release", lease=outcome.result["lease"])
    await b.event("alice gave the lease back", kind="lease")
    await b.state(lambda s: s["lease"] is None, "no lease")
    with pytest.raises(NotHolder, match="no such lease on quad1"):
        await b.ground.do("release", lease=outcome.result["lease"])


async def test_a_second_holder_is_refused_and_so_is_a_namesake(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = await take(b)
    for holder in ("bob", "alice"):
        with pytest.raises(NotHolder, match="alice commands quad1") as e:
            await b.ground.do("lease", holder=holder)
        assert e.value.detail["holder"] == "alice"
    again = await b.ground.do("lease", holder="alice", lease=token, ttl=20.0)
    assert (again.result["lease"], again.result["ttl"]) == (token, 20.0)


@pytest.mark.parametrize(("verb", "args"), [("arm", {"ready_timeout": 0}), ("set_mode", {"mode": "GUIDED"})])
async def test_orders_of_others_are_refused_while_it_lasts(
    bench: StartBench, verb: str, args: dict[str, object]
) -> None:
    b = await (await bench()).connected()
    token = await take(b)
    with pytest.raises(NotHolder, match="hold, land, rtl and disarm are open to everybody"):
        await b.ground.do(verb, **args)
    assert (b.peer.mode, b.peer.armed) == (0, False)
    assert (await b.ground.do(verb, lease=token, **args)).status == "done"


async def test_it_runs_out(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await take(b, ttl=0.3)
    said = await b.event("lease of alice ran out", kind="lease")
    assert said["severity"] == "warning"
    await b.state(lambda s: s["lease"] is None, "no lease")
    assert await take(b, "bob")


async def test_setpoints_renew_it(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    token = await take(b)
    granted = (await b.state(lambda s: s["lease"], "lease"))["lease"]["expires"]
    unused = (await b.state(lambda s: True, "a later state"))["lease"]["expires"]
    assert unused == pytest.approx(granted, abs=0.01)
    point = wire.Setpoint(lease=token, seq=1, deadline=time.time() + 4, vel=(1.0, 0.0, 0.0))
    b.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")
    await b.state(lambda s: s["lease"]["expires"] > granted + 0.1, "renewed lease")


@pytest.mark.parametrize("verb", ["hold", "land", "disarm"])
async def test_open_orders_of_others_end_it(bench: StartBench, verb: str) -> None:
    b = await (await (await bench()).connected()).flying()
    token = await take(b)
    asked = asyncio.create_task(b.ground.do(verb))
    said = await b.event(f"lease of alice revoked: {verb} was ordered", kind="lease")
    assert said["severity"] == "warning"
    b.peer.armed = b.peer.armed and verb != "land"
    assert (await asked).status == "done"
    with pytest.raises(NotHolder, match="no such lease"):
        await b.ground.do("release", lease=token)


async def test_open_orders_of_the_holder_keep_it(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    token = await take(b)
    await b.ground.do("hold", lease=token)
    assert (await b.state(lambda s: True, "state"))["lease"]["holder"] == "alice"
    assert not [e for e in b.events.objects() if "revoked" in e["text"]]


WRONG: list[tuple[dict[str, object], str]] = [
    ({"holder": ""}, "holder"),
    ({"holder": "A B"}, "holder"),
    ({"holder": "a", "ttl": 61}, "ttl"),
    ({"holder": "a", "ttl": -1}, "ttl"),
    ({"holder": "a", "priority": 101}, "priority"),
    ({"holder": "a", "priority": -1}, "priority"),
    ({"holder": "a", "instance": "a/b"}, "instance"),
    ({"holder": "a", "router": "*"}, "router"),
]


async def test_wrong_requests(bench: StartBench, subtests: pytest.Subtests) -> None:
    b = await (await bench()).connected()
    for args, field in WRONG:
        with subtests.test(args=args):
            with pytest.raises(BadInput) as e:
                await b.ground.do("lease", **args)
            assert e.value.detail["field"] == field
            assert b.vehicle.leases.holder is None


async def test_only_a_higher_priority_takes_it(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = await take(b, priority=50)
    for priority in (0, 50):
        with pytest.raises(NotHolder, match="alice commands quad1") as e:
            await b.ground.do("lease", holder="bob", priority=priority)
        assert e.value.detail["priority"] == 50
    assert await take(b, "bob", priority=51) != token
    said = await b.event("bob (priority 51) took the lease from alice (50)", kind="lease")
    assert said["detail"] == {"holder": "alice", "reason": "preempted", "by": "bob"}
    with pytest.raises(NotHolder, match=r"bob \(priority 51\) took the lease from alice.*bob commands quad1"):
        await b.ground.do("lease", holder="alice", lease=token, priority=50)
    state = await b.state(lambda s: s["lease"] and s["lease"]["holder"] == "bob", "bob's lease")
    assert (state["lease"]["priority"], state["lease"]["number"]) == (51, 2)
    assert (state["lease_end"]["number"], state["lease_end"]["reason"], state["lease_end"]["by"]) == (
        1,
        "preempted",
        "bob",
    )


async def test_an_operator_revokes_it(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = await take(b, priority=100)
    assert (await b.ground.do("revoke", reason="lunch")).result == {"holder": "alice"}
    await b.event("lease of alice revoked by an operator: lunch", kind="lease")
    with pytest.raises(NotHolder, match="no such lease on quad1 any more: lease of alice revoked"):
        await b.ground.do("set_mode", mode="GUIDED", lease=token)
    assert (await b.ground.do("revoke")).result == {"holder": None}


async def test_an_ended_lease_is_not_renewed(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = await take(b, ttl=0.1)
    await b.event("lease of alice ran out")
    with pytest.raises(NotHolder, match="any more: lease of alice ran out") as e:
        await b.ground.do("lease", holder="alice", lease=token)
    assert e.value.detail["reason"] == "expired"
    assert b.vehicle.leases.holder is None


async def test_orders_renew_it(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = await take(b)
    granted = (await b.state(lambda s: s["lease"], "lease"))["lease"]["expires"]
    await b.ground.do("set_mode", mode="GUIDED", lease=token)
    await b.state(lambda s: s["lease"]["expires"] > granted + 0.05, "renewed lease")


async def test_it_ends_with_its_holder_s_token(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = here(b, "alice", "one")
    another = here(b, "alice", "two")
    await take(b, instance="one")
    another.undeclare()
    await b.event("alice commands")
    assert (await b.state(lambda s: True, "a state"))["lease"]["holder"] == "alice"
    token.undeclare()
    said = await b.event("alice, who held the lease, is gone", kind="lease")
    assert said["detail"]["reason"] == "gone"
    assert (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]["reason"] == "gone"


async def test_a_token_that_comes_late_ends_nothing(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await take(b, instance="one")
    await b.state(lambda s: s["lease"], "lease")
    token = here(b, "alice", "one")
    leases = b.vehicle.leases
    await b.state(lambda s: ("alice", "one") in leases.present, "the token")
    assert leases.holder == "alice"
    token.undeclare()
    await b.event("alice, who held the lease, is gone")


async def test_a_token_that_was_there_before_the_agent_counts(bench: StartBench, onboard: StartOnboard) -> None:
    b = await (await bench()).connected()
    token = here(b, "alice", "one")
    await onboard.close(b.vehicle)
    again = await onboard(b.vehicle.adapter.session, b.peer.url, "quad1")
    await b.ground.do("lease", holder="alice", ttl=30, instance="one")
    while ("alice", "one") not in again.leases.present:
        await asyncio.sleep(0.01)
    token.undeclare()
    await b.event("is gone")


async def test_nothing_is_put_by_a_program_that_is_cancelled_while_it_gives_its_lease_back(bench: StartBench) -> None:
    b = await (await bench()).connected()
    async with zmav.open(connect=[b.endpoint]) as one:
        (quad,) = await one.wait_for("quad1")
        held: asyncio.Queue[zmav.Lease] = asyncio.Queue()

        async def hold() -> None:
            async with quad.lease("alice") as lease:
                held.put_nowait(lease)
                await asyncio.Event().wait()

        task = asyncio.create_task(hold())
        lease = await held.get()
        task.cancel()
        await asyncio.sleep(0)  # it gives it back
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        with pytest.raises(NotHolder, match="was given back"):
            lease.setpoint(vel=(0.0, 0.0, 0.0))
    await b.state(lambda s: s["lease"] is None, "no lease")


async def test_a_program_hears_what_took_its_lease(bench: StartBench) -> None:
    b = await (await bench()).connected()
    async with zmav.open(connect=[b.endpoint]) as one, zmav.open(connect=[b.endpoint]) as two:
        (mine,), (other,) = await one.wait_for("quad1"), await two.wait_for("quad1")
        async with mine.lease("alice", priority=5) as lease:
            assert lease.lost is None
            lease.setpoint(vel=(0.0, 0.0, 0.0))
            async with other.lease("bob", priority=6) as theirs:
                while lease.lost is None:
                    await asyncio.sleep(0.01)
                assert lease.lost.detail == {"vehicle": "quad1", "reason": "preempted", "by": "bob"}
                with pytest.raises(NotHolder, match=r"bob \(priority 6\) took the lease from alice"):
                    lease.setpoint(vel=(0.0, 0.0, 0.0))
                assert await mine.revoke("enough") == "bob"
                while theirs.lost is None:
                    await asyncio.sleep(0.01)
                assert theirs.lost.detail["reason"] == "revoked"
        async with mine.lease("alice") as again:
            assert again.number == 3
            assert (await b.state(lambda s: s["lease"], "lease"))["lease"]["number"] == 3
            assert again.lost is None
    await b.state(lambda s: s["lease"] is None, "no lease")


async def test_it_outlasts_a_link_that_is_down_and_no_longer_than_its_time(bench: StartBench) -> None:
    """Its holder's router is not heard either."""
    b = await (await bench()).connected()
    token = here(b, "alice", "one")
    await take(b, ttl=4.0, instance="one", router=AWAY)
    token.undeclare()
    await until(lambda: b.vehicle.leases.misses_holder, "a token that is missed")
    token = here(b, "alice", "one")
    await until(lambda: not b.vehicle.leases.misses_holder, "the token")
    assert b.vehicle.leases.holder == "alice"
    token.undeclare()
    await b.event("lease of alice ran out", kind="lease")
    assert not b.vehicle.leases.misses_holder


async def test_who_asks_meanwhile_has_it(bench: StartBench) -> None:
    b = await (await bench()).connected()
    token = here(b, "alice", "one")
    await take(b, priority=7, instance="one", router=AWAY)
    with pytest.raises(NotHolder, match="alice commands quad1"):
        await b.ground.do("lease", holder="bob", priority=7)
    token.undeclare()
    await until(lambda: b.vehicle.leases.misses_holder, "a token that is missed")
    assert await take(b, "bob", priority=7)
    assert (await b.event("alice, who held the lease, is gone", kind="lease"))["detail"]["reason"] == "gone"


@pytest.mark.parametrize("committed", [0.0, 60.0])
async def test_it_ends_when_its_holder_s_router_is_heard_without_it(
    bench: StartBench, net: Net, committed: float
) -> None:
    b = await (await bench()).connected()
    router, endpoint = net.router(net.router(b.endpoint)[1])
    far = net.ground(endpoint).session.liveliness()
    token = far.declare_token(keys.HOLDER.key("demo", "quad1", holder="alice", instance="one"))
    leases = b.vehicle.leases
    await until(lambda: ("alice", "one") in leases.present, "the token")
    mine = await take(b, instance="one", router=str(router.info.zid()))
    leases.commit(time.monotonic() + committed)
    token.undeclare()
    await until(lambda: leases.misses_holder, "a token that is missed")
    for _ in range(25):  # it is in use: the token is late, and not its holder
        await b.ground.do("lease", holder="alice", instance="one", router=str(router.info.zid()), lease=mine)
        await asyncio.sleep(0.05)
    assert leases.holder == "alice"
    await b.event("alice, who held the lease, is gone", kind="lease")
