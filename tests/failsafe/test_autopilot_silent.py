"""The autopilot falls silent in the middle of a stream, and comes back as it likes."""

from __future__ import annotations

from tests.failsafe.conftest import agent, held
from tests.services.conftest import LOITER, StartBench


async def test_setpoints_are_refused_and_it_is_told_to_hold(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    await alice.fly()
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    await held(b)  # it may still hear us
    alice.put()
    await b.state(lambda s: s["setpoints"].get("silent") == 1, "refused setpoint")
    # Back again as it was, the stream may go on.
    b.peer.beating = True
    await b.state(lambda s: s["connected"], "its heartbeat")
    await alice.fly()


async def test_back_in_another_mode_it_is_not_ours(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    await alice.fly()
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    b.peer.mode, b.peer.beating = LOITER, True
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert end["reason"] == "pilot"
    alice.put()
    await b.state(lambda s: s["setpoints"].get("pilot") == 1, "refused setpoint")
    assert b.peer.mode == LOITER
