"""One commander at a time: granted, renewed, run out, given back, refused to a second, ended by hold and land."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from zmav import keys, wire
from zmav.errors import BadInput, NotHolder

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench


async def take(b: Bench, holder: str = "alice", ttl: float = 30.0) -> str:
    token: str = (await b.ground.do("lease", holder=holder, ttl=ttl)).result["lease"]
    return token


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
    with pytest.raises(NotHolder, match="hold, land and disarm are open to everybody"):
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


@pytest.mark.parametrize(
    ("args", "field"),
    [({"holder": ""}, "holder"), ({"holder": "a", "ttl": 61}, "ttl"), ({"holder": "a", "ttl": -1}, "ttl")],
)
async def test_wrong_requests(bench: StartBench, args: dict[str, object], field: str) -> None:
    b = await (await bench()).connected()
    with pytest.raises(BadInput, match="a lease needs") as e:
        await b.ground.do("lease", **args)
    assert e.value.detail["field"] == field
