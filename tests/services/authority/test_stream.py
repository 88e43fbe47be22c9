"""A stream of setpoints when something around it changes: the clock, the lease, the session, a mode that comes late."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from tests.services.authority.test_segment import stand
from tests.services.authority.test_setpoint import GLOBAL, HOLD, LOCAL, OFFBOARD, ORIGIN, SET_MODE, STOP, pilot, vel
from zmav import wire
from zmav.config import Failsafe
from zmav.services.status.events import Events

if TYPE_CHECKING:
    from tests.services.conftest import StartBench


async def test_what_cannot_be_said_to_the_autopilot_does_not_keep_the_stream_fresh(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": Failsafe(hold_after=1.0, land_after="never")})
    alice = await pilot(b)
    alice.put()
    await b.peer.count(LOCAL, 1)
    for _ in range(12):
        alice.put(vel=None, rc=[None] * 16 + [1500])  # ArduPilot takes 16 channels
        await b.state(lambda s: True, "a moment")  # 5 Hz
    assert b.vehicle.setpoints.counts["unsupported"] == 12
    assert STOP in map(vel, b.peer.heard(LOCAL))
    assert not [e for e in b.events.objects() if e["kind"] == "fault"]


async def test_a_renewed_lease_still_lasts_until_the_segment_s_end(bench: StartBench) -> None:
    """Its holder's renewal may be the last that comes through."""
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 2.0, pos=(3.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    await alice.counted(flown=1)
    await b.ground.do("lease", holder="alice", ttl=0.2, lease=alice.token)
    await b.event("lease of alice ran out")
    assert time.time() > t + 2.0


async def test_a_point_after_a_segment_gives_the_lease_its_ttl_back(bench: StartBench) -> None:
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    await b.ground.do("lease", holder="alice", ttl=0.3, lease=alice.token)
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 50.0, pos=(3.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    await alice.counted(flown=1)
    alice.put()
    await b.event("lease of alice ran out")


async def test_a_step_of_the_clock_does_not_move_a_segment(bench: StartBench, monkeypatch: pytest.MonkeyPatch) -> None:
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    t, real = time.time(), time.time
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 20.0, pos=(20.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    await b.peer.count(GLOBAL, 2)
    monkeypatch.setattr(time, "time", lambda: real() + 12.0)
    await b.peer.count(GLOBAL, 6)
    norths = [(f.fields["lat_int"] + 350000000) / 1e7 * 110_941 for f in b.peer.heard(GLOBAL)]
    assert norths[-1] < 10.0
    points = [wire.SegmentPoint(t=time.time() + k, pos=(20.0, 0.0, -10.0)) for k in range(2)]
    alice.put(vel=None, segment=points)
    await b.event("the clock of quad1 was set by +12.00 s")
    state = await b.state(lambda s: s["lease"] is None, "the lease's end")
    assert state["lease_end"]["reason"] == "clock"
    assert state["segment"]["end"] == t + 20.0  # and is flown on


async def test_a_mode_that_comes_after_its_stream_has_ended_is_held(bench: StartBench) -> None:
    """PX4's HEARTBEAT is up to a second behind: what it was last told it would fly on with."""
    b = await bench(autopilot=12)
    b.peer.mute = {SET_MODE}
    alice = await pilot(b, mode=HOLD)
    for _ in range(40):
        alice.put()
        if b.peer.commands(SET_MODE):
            break
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.6)  # the stream has ended
    b.peer.mode = OFFBOARD
    b.peer.heartbeat()
    hold = {"param2": 4.0, "param3": 3.0}
    await b.peer.until(lambda: any(hold.items() <= t.fields.items() for t in b.peer.commands(SET_MODE)), "HOLD")


async def test_the_watchdog_outlives_a_session_that_is_closed(bench: StartBench) -> None:
    b = await bench()
    alice = await pilot(b)
    alice.put()
    await alice.counted(flown=1)
    b.vehicle.events._publisher.undeclare()  # as the end of the session does it
    await b.peer.until(lambda: STOP in map(vel, b.peer.heard(LOCAL)), "hold")
    await b.peer.until(lambda: sum(vel(t) == STOP for t in b.peer.heard(LOCAL)) > 2, "more holds")
    assert b.vehicle.authority.watchdog._thread.is_alive()
    b.vehicle.events._publisher = Events(b.vehicle.adapter.session, "demo", "spare")._publisher  # to be closed
