"""Proofs and seals are judged beside the event loop: what has none never reaches it, however much of it comes."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from tests.trust.conftest import StartGuarded, secret_of
from tests.trust.test_setpoints import BACK, SETTINGS, counted, point, put
from tests.trust.test_vehicle import reason
from zmav import keys
from zmav.services.authority import setpoints
from zmav.trust.gate import Gate
from zmav.trust.seal import is_sealed, seal

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded

FLOOD = 300


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> collections.Counter[tuple[str, bool]]:
    """What was judged how often, and whether on an event loop."""
    counts: collections.Counter[tuple[str, bool]] = collections.Counter()

    def watched(what: str, judge: Callable[..., Any]) -> Callable[..., Any]:
        def judge_it(*args: Any) -> Any:
            counts[what, asyncio._get_running_loop() is not None] += 1
            return judge(*args)

        return judge_it

    monkeypatch.setattr(Gate, "check", watched("proof", Gate.check))
    monkeypatch.setattr(setpoints, "is_sealed", watched("seal", is_sealed))
    return counts


async def test_frames_and_orders(guarded: StartGuarded, judged: collections.Counter[tuple[str, bool]]) -> None:
    g: Guarded = await guarded()
    frame = g.key(keys.TX, sys=1, comp=0, msg="COMMAND_LONG")
    assert await reason(g.ask(None, b"{}", g.key(verb="land"))) == "unsigned"
    g.b.ground.session.put(frame, b"", congestion_control=zenoh.CongestionControl.BLOCK)
    await g.b.state(lambda s: s["forbidden"] == {"unsigned": 2}, "two refusals")
    assert judged == {("proof", False): 2}


async def test_setpoints(guarded: StartGuarded, judged: collections.Counter[tuple[str, bool]]) -> None:
    """Nor does one that the lease's holder sealed before another took the lease, and that is looked at after it."""
    g: Guarded = await guarded(**SETTINGS)
    async with g.client("swap", "planner") as z, g.client("swap2", "planner") as z2:
        await g.b.flying()
        alice, bob = z.vehicle("quad1"), z2.vehicle("quad1")
        async with alice.lease("alice", ttl=30.0) as lease:
            for seq in range(FLOOD):
                put(g, point(lease.token, seq), b"\x02" + bytes(16))
            flown = g.vehicle.setpoints
            await g.b.event("its seal is not that of the lease in force", kind="setpoint")
            assert not flown._waiting
            async with bob.lease("bob", ttl=30.0, priority=1) as second:
                secret, key = secret_of(lease), keys.SETPOINT.key("demo", "quad1", agent="alice")
                stolen = point(second.token, 1000)
                flown._waiting.append(setpoints.Heard("alice", stolen, secret))
                flown._next()
                await counted(g, "lease", 1)
                assert seal(secret, key, stolen) != seal(secret_of(second), key, stolen)
    assert BACK[0] not in {told.fields["vx"] for told in g.b.peer.heard("SET_POSITION_TARGET_LOCAL_NED")}
    assert judged["seal", False] > 0
    assert judged["seal", True] == 0
