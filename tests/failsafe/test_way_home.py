"""``return = "together"``: nobody comes back, and the way home that came with the last segment is flown, or is not."""

from __future__ import annotations

import time
from typing import Any

import pytest

from tests.failsafe.conftest import Agent, Px4Peer, agent, another
from tests.services.conftest import GUIDED, LAND, LOITER, Bench, StartBench
from zmav import wire
from zmav.config import RETURN_LEAD, Failsafe, Geofence

GLOBAL = "SET_POSITION_TARGET_GLOBAL_INT"
HERE = (-35.0, 149.0)
ORIGIN = wire.Origin(lat_deg=HERE[0], lon_deg=HERE[1], alt_amsl=600.0)
UP, REST = (0.0, 0.0, -10.0), (0.0, 0.0, 0.0)
RTL, OFFBOARD, PX4_LAND = 6, 6 << 16, 4 << 16 | 6 << 24
AFTER = 1.0 + RETURN_LEAD
"""s after a segment's end from which the way home may begin"""
WAY = [(0.0, UP, REST), (1.0, (1.5, 0.0, -10.0), (3.0, 0.0, 0.0)), (2.0, (3.0, 0.0, -10.0), REST)]


def settings(**more: Any) -> dict[str, Any]:
    failsafe = Failsafe(hold_after=0.2, land_after=1.0, action="rtl", returns="together")
    return {"failsafe": failsafe, "origin": ORIGIN, **more}


async def committed(b: Bench, wait: float = AFTER + 0.2, way: Any = None, **more: Any) -> tuple[Agent, float]:
    """On a segment that ends within a second, with a way home that begins ``wait`` s after that; when it begins."""
    b.peer.place = HERE
    alice = await agent(b, **more)
    end = time.time() + 0.8
    points = [wire.SegmentPoint(t=end - 0.8, pos=UP), wire.SegmentPoint(t=end, pos=UP)]
    alice.put(vel=None, segment=points, home=wire.WayHome(start=end + wait, points=way or WAY))
    return alice, end + wait


def north(b: Bench) -> list[float]:
    """m north of the origin of each place that the autopilot was told."""
    return [(told.fields["lat_int"] / 1e7 - HERE[0]) * 111_000.0 for told in b.peer.heard(GLOBAL)]


async def test_it_is_flown_by_its_own_clock_and_lands_at_its_end(bench: StartBench) -> None:
    b = await bench(settings=settings())
    alice, start = await committed(b)
    state = await b.state(lambda s: s["segment"] is not None, "the segment")
    assert state["segment"]["home"] == pytest.approx(start, abs=1e-3)
    said = await b.event("it flies the way home that the planner sent", kind="failsafe")
    assert said["severity"] == "critical"
    assert time.time() < start
    await b.peer.until(lambda: max(north(b), default=0.0) > 0.3, "on its way")
    assert time.time() == pytest.approx(start + 0.4, abs=0.35)
    state = await b.state(lambda s: s["segment"] is None, "no segment any more")
    assert state["mover"] == "failsafe"
    assert state["lease_end"]["reason"] == "failsafe"
    alice.put()  # of a lease that has ended
    await b.state(lambda s: s["setpoints"].get("lease") == 1, "refused setpoint")
    await b.peer.until(lambda: b.peer.mode == LAND, "LAND")
    assert max(north(b)) == pytest.approx(3.0, abs=0.05)
    assert time.time() == pytest.approx(start + 2.0, abs=0.5)


async def test_px4_is_back_in_offboard_before_the_way_begins(bench: StartBench, px4: Px4Peer) -> None:
    """It left OFFBOARD for the hold."""
    b = await bench(px4, settings=settings())
    await committed(b, mode=OFFBOARD)
    await b.peer.until(lambda: b.peer.mode == 4 << 16 | 3 << 24, "HOLD")
    await b.event("it flies the way home that the planner sent", kind="failsafe")
    await b.peer.until(lambda: b.peer.mode == OFFBOARD, "OFFBOARD again")
    await b.peer.until(lambda: b.peer.mode == PX4_LAND, "LAND")


async def test_nothing_of_it_is_flown_unless_the_fleet_file_asks_for_it(bench: StartBench) -> None:
    b = await bench(settings=settings(failsafe=Failsafe(hold_after=0.2, land_after=1.0, action="rtl")))
    await committed(b)
    state = await b.state(lambda s: s["segment"] is not None, "the segment")
    assert state["segment"]["home"] is None
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    assert max(north(b)) < 0.05


@pytest.mark.parametrize(
    ("wait", "way", "words"),
    [
        (0.5, WAY, "0.5 s after the segment's end"),
        (500.0, WAY, "500.0 s after the segment's end"),
        (AFTER, [(t, (n + 2.0, e, d), v) for t, (n, e, d), v in WAY], "begin 2.0 m from the segment's end"),
        (AFTER, [(t + 1.0, pos, vel) for t, pos, vel in WAY], "begin at 0"),
        (AFTER, [*WAY[:2], (2.0, (3.0, 0.0, -10.0), (1.0, 0.0, 0.0))], "ends at rest"),
        (AFTER, [*WAY[:2], (90.0, (700.0, 0.0, -10.0), REST)], "after the point before it"),
        (AFTER, [*WAY, (60.0, (80.0, 0.0, -10.0), REST)], "geofence"),
        (AFTER, [], "begin at 0"),
    ],
)
async def test_one_that_makes_no_sense_is_not_kept_and_the_segment_is_flown(
    bench: StartBench, wait: float, way: Any, words: str
) -> None:
    b = await bench(settings=settings(geofence=Geofence(radius=50.0)))
    b.peer.place = HERE
    alice = await agent(b)
    end = time.time() + 0.8
    points = [wire.SegmentPoint(t=end - 0.8, pos=UP), wire.SegmentPoint(t=end, pos=UP)]
    alice.put(vel=None, segment=points, home=wire.WayHome(start=end + wait, points=way))
    said = await b.event("way home not kept")
    assert words in said["text"]
    state = await b.state(lambda s: s["segment"] is not None, "the segment")
    assert state["segment"]["home"] is None


async def test_one_who_is_elsewhere_does_what_is_configured(bench: StartBench) -> None:
    b = await bench(settings=settings())
    await committed(b)
    b.peer.place = (HERE[0] + 5e-5, HERE[1])  # 5.5 m north
    await b.event("the way home is not flown: it begins 5.5 m from here", kind="failsafe", severity="error")
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    assert max(north(b)) < 0.05


async def test_one_who_has_not_said_of_late_where_it_is_does_what_is_configured(bench: StartBench) -> None:
    b = await bench(settings=settings())
    await committed(b, wait=AFTER + 3.0)
    await b.event("the segment has ended")
    b.peer.place = None  # it says so no more
    await b.event("the way home is not flown: where it is, is not known", kind="failsafe", severity="error")
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")


async def test_one_whose_segment_was_cut_short_waits_for_no_way_home(bench: StartBench) -> None:
    b = await bench(settings=settings())
    alice, start = await committed(b, wait=AFTER + 8.0)
    await b.state(lambda s: s["segment"] is not None, "the segment")
    await b.ground.do("arm", lease=alice.token)  # it is, and holds
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    assert time.time() < start - RETURN_LEAD - 4.0


async def test_the_next_segment_takes_the_place_of_both(bench: StartBench) -> None:
    """One without a way home leaves none: it would begin elsewhere."""
    b = await bench(settings=settings())
    alice, _ = await committed(b)
    now = time.time()
    alice.put(vel=None, segment=[wire.SegmentPoint(t=now, pos=UP), wire.SegmentPoint(t=now + 1.0, pos=UP)])
    state = await b.state(lambda s: s["segment"] is not None and s["segment"]["seq"] == 2, "the second segment")
    assert state["segment"]["home"] is None
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    assert max(north(b)) < 0.05


@pytest.mark.parametrize("when", ["waiting", "flying"])
async def test_the_pilot_wins(bench: StartBench, when: str) -> None:
    b = await bench(settings=settings())
    _, start = await committed(b)
    if when == "flying":
        await b.peer.until(lambda: max(north(b), default=0.0) > 0.3, "on its way")
    else:
        await b.event("the segment has ended")
    b.peer.mode = LOITER
    b.peer.heartbeat()
    await b.state(lambda s: s["mover"] == "nobody", "nobody moves it")
    await flies_no_more(b, start + 2.5)
    assert b.peer.mode == LOITER


async def flies_no_more(b: Bench, until: float) -> None:
    """Nothing is streamed from now until then (UTC s)."""
    told = len(north(b))
    while time.time() < until:
        await b.state(lambda s: True, "a moment")
    assert len(north(b)) == told


async def test_an_operators_hold_ends_it(bench: StartBench) -> None:
    b = await bench(settings=settings())
    _, start = await committed(b)
    await b.peer.until(lambda: max(north(b), default=0.0) > 0.3, "on its way")
    await b.ground.do("hold")
    await flies_no_more(b, start + 2.5)
    assert b.peer.mode == GUIDED


async def test_a_lease_alone_does_not_take_it_back_and_a_setpoint_under_it_does(bench: StartBench) -> None:
    """The network is back in the middle: it goes on until it is told otherwise."""
    b = await bench(settings=settings())
    await committed(b)
    await b.peer.until(lambda: max(north(b), default=0.0) > 0.3, "on its way")
    bob = await another(b, "bob")
    told = len(north(b))
    await b.peer.until(lambda: len(north(b)) > told + 3, "it goes on")
    await bob.fly()
    assert (await b.state(lambda s: s["mover"] == "stream", "bob's stream"))["lease"]["holder"] == "bob"
    told = len(north(b))
    for _ in range(5):
        bob.put()
        await b.state(lambda s: True, "a moment")
    assert len(north(b)) == told
    assert b.peer.mode == GUIDED
