"""Committed segments: what is flown, from where, until when, and what becomes of one whose mode goes away."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from tests.services.authority.test_setpoint import GLOBAL, HOLD, OFFBOARD, ORIGIN, SET_MODE, Pilot, pilot
from zmav import keys, wire
from zmav.config import Failsafe
from zmav.errors import Refused

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench

RTL, ROVER_GUIDED = 4 << 16 | 5 << 24, 15


async def stand(b: Bench) -> None:
    """It says that it is 10 m above the origin."""
    b.peer.place = (ORIGIN.lat_deg, ORIGIN.lon_deg)
    await b.state(lambda s: s["local"] is not None, "where it is")


async def test_a_segment_is_flown_by_the_vehicle_until_its_end(bench: StartBench) -> None:
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 1.2, pos=(3.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    state = await b.state(lambda s: s["segment"] is not None, "the commitment")
    times = {"start": t, "rests": t + 1.2, "end": t + 1.2, "home": None}
    assert state["segment"] == {"lease": 1, "seq": alice.seq, **times}
    await b.state(lambda s: s["setpoints"] == {"flown": 1, "held": 1} and s["segment"], "hold at its end")
    told = b.peer.heard(GLOBAL)
    norths = [(f.fields["lat_int"] + 350000000) / 1e7 * 110_941 for f in told]
    assert len(norths) >= 8  # 10 Hz, on a busy machine
    assert norths == sorted(norths)
    assert norths[0] < 0.5
    assert norths[-1] > 2.5
    assert told[-1].at - told[0].at > 0.8
    said = await b.event("the segment has ended: holding position", kind="setpoint")
    assert said["severity"] == "info", "it ended as it was to"
    alice.put()
    await b.state(lambda s: s["segment"] is None, "something else to fly")


@pytest.mark.parametrize(("ends", "flown_on"), [("gone", True), ("revoked", False)])
async def test_a_segment_outlives_a_lost_holder_and_no_operator(bench: StartBench, ends: str, flown_on: bool) -> None:
    b = await bench(settings={"origin": ORIGIN})
    await pilot(b)
    await stand(b)
    liveliness = b.ground.session.liveliness()
    token = liveliness.declare_token(keys.HOLDER.key("demo", "quad1", holder="bob", instance="i1"))
    granted = await b.ground.do("lease", holder="bob", ttl=30, priority=9, instance="i1")
    bob = Pilot(b, granted.result["lease"])
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 2.0, pos=(4.0, 0.0, -10.0))]
    bob.put(vel=None, segment=points)
    await b.peer.until(lambda: len(b.peer.heard(GLOBAL)) >= 3, "the segment")
    if ends == "gone":
        token.undeclare()
    else:
        await b.ground.do("revoke")
    await b.state(lambda s: s["lease"] is None, "no lease")
    since = len(b.peer.heard(GLOBAL))
    await b.state(lambda s: s["setpoints"].get("held"), "hold")
    north = (b.peer.heard(GLOBAL)[-1].fields["lat_int"] + 350000000) / 1e7 * 110_941
    assert (north > 3.0) is flown_on
    assert (len(b.peer.heard(GLOBAL)) > since + 5) is flown_on


async def test_a_segment_outlasts_its_lease_s_ttl(bench: StartBench) -> None:
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    await b.ground.do("lease", holder="alice", ttl=0.2, lease=alice.token)
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 1.5, pos=(3.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    await b.state(lambda s: s["setpoints"].get("held"), "hold")
    texts = [e["text"] for e in b.events.objects() if e["kind"] in ("setpoint", "lease")]
    assert any("segment has ended" in text or "ran out" in text for text in texts)
    assert b.peer.heard(GLOBAL)[-1].at - b.peer.heard(GLOBAL)[0].at > 1.0


async def test_a_segment_that_is_too_long_or_over(bench: StartBench) -> None:
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    await stand(b)
    t = time.time()
    for start, end in ((t - 4.0, t - 1.0), (t, t + 59.0), (t + 59.0, t + 100.0)):
        alice.put(
            vel=None,
            segment=[
                wire.SegmentPoint(t=start, pos=(0.0, 0.0, -10.0)),
                wire.SegmentPoint(t=end, pos=(0.0, 0.0, -11.0)),
            ],
        )
    await b.state(lambda s: s["setpoints"] == {"late": 1, "flown": 1, "early": 1}, "counts")


def way(*places: tuple[float, float], speed: float = 2.5, begin: float = 0.0) -> list[wire.SegmentPoint]:
    """Metres north and east of the origin, 10 m above it, from now on."""
    t, points = time.time() + begin, [places[0]]
    found = [wire.SegmentPoint(t=t, pos=(*places[0], -10.0))]
    for place in places[1:]:
        t += max(abs(place[0] - points[-1][0]), abs(place[1] - points[-1][1])) / speed or 1.0
        points.append(place)
        found.append(wire.SegmentPoint(t=t, pos=(*place, -10.0)))
    return found


def asked(b: Bench, mode: int) -> int:
    """How often PX4 was asked for that mode."""
    main, sub = float(mode >> 16 & 0xFF), float(mode >> 24)
    return sum((t.fields["param2"], t.fields["param3"]) == (main, sub) for t in b.peer.commands(SET_MODE))


def north(b: Bench) -> list[float]:
    return [(f.fields["lat_int"] + 350000000) / 1e7 * 110_941 for f in b.peer.heard(GLOBAL)]


async def reengaging(b: Bench, segment: list[wire.SegmentPoint]) -> Pilot:
    """PX4 shows HOLD, which was asked for at the end of the segment before, while it is to fly ``segment``."""
    b.peer.mute = {SET_MODE}
    alice = await pilot(b, mode=OFFBOARD)
    await stand(b)
    alice.put(vel=None, segment=way((0.0, 0.0), (1.0, 0.0)))
    await b.peer.until(lambda: asked(b, HOLD) > 0, "the hold")
    begin = segment[0].t - time.time()
    alice.put(vel=None, segment=[wire.SegmentPoint(t=p.t - begin, pos=p.pos) for p in segment])
    await alice.counted(flown=2, held=1)
    before = asked(b, OFFBOARD)
    b.peer.mode = HOLD
    b.peer.heartbeat()
    await b.peer.until(lambda: asked(b, OFFBOARD) > before, "the mode again")
    assert (await b.state(lambda s: True, "a state"))["mover"] == "segment"
    return alice


async def test_one_that_begins_elsewhere_is_refused(bench: StartBench) -> None:
    """The autopilot would fly there straight, through what the segment was checked against."""
    b = await bench(settings={"origin": ORIGIN})
    alice = await pilot(b)
    alice.put(vel=None, segment=way((0.0, 0.0), (1.0, 0.0)))
    await alice.counted(away=1)
    said = await b.event("where it is, is not known")
    assert said["severity"] == "warning"
    await stand(b)
    alice.put(vel=None, segment=way((20.0, 0.0), (20.0, 0.0)))
    await alice.counted(away=2)
    alice.put(vel=None, segment=way((0.0, 0.0), (4.0, 0.0)))
    await alice.counted(away=2, flown=1)
    alice.put(vel=None, segment=way((12.0, 0.0), (12.0, 0.0)))  # no more so from the one that it follows
    await alice.counted(away=3, flown=1)
    assert max(north(b)) < 5.0


async def test_the_next_one_finds_the_vehicle_in_its_mode(bench: StartBench) -> None:
    """PX4 is late at the end, and drifts at each change of the mode."""
    b = await bench(autopilot=12, settings={"origin": ORIGIN})
    alice = await pilot(b, mode=OFFBOARD)
    await stand(b)
    alice.put(vel=None, segment=way((0.0, 0.0), (1.0, 0.0)))
    await b.peer.until(lambda: north(b)[-1:] > [0.98], "the end")
    ended = len(north(b))
    await b.peer.until(lambda: len(north(b)) > ended + 5, "its last place, again")
    assert north(b)[ended:] == pytest.approx([1.0] * len(north(b)[ended:]), abs=0.02)
    alice.put(vel=None, segment=way((1.0, 0.0), (2.0, 0.0)))
    await b.peer.until(lambda: north(b)[-1] > 1.9, "the next")
    assert not asked(b, HOLD)
    assert not asked(b, OFFBOARD)
    ended = len(north(b))
    await b.peer.until(lambda: asked(b, HOLD) > 0, "hold where nothing comes")
    assert len(north(b)) > ended + 10, "not before its last place was given for a while"


async def test_a_hold_that_comes_late_does_not_keep_the_vehicle_from_the_next_one(bench: StartBench) -> None:
    """The next segment meets the mode of the one before, and the hold that was asked for comes after it."""
    b = await bench(autopilot=12, settings={"origin": ORIGIN})
    await reengaging(b, way((1.0, 0.0), (40.0, 0.0), speed=1.0))
    b.peer.mode = OFFBOARD
    b.peer.heartbeat()
    since = len(north(b))
    await b.peer.until(lambda: len(north(b)) > since + 20, "the segment")
    assert north(b)[-1] > north(b)[since]
    assert not [e for e in b.events.objects() if "does not come" in e["text"]]


async def test_one_that_has_gone_ahead_while_its_mode_was_away_is_not_caught_up_with(bench: StartBench) -> None:
    b = await bench(autopilot=12, settings={"origin": ORIGIN})
    await reengaging(b, way((1.0, 0.0), *[(16.0, 0.0)] * 8, speed=6.0))
    await b.peer.until(lambda: north(b)[-1] > 15.9, "a segment that is far ahead")
    b.peer.mode = OFFBOARD
    b.peer.heartbeat()
    said = await b.event("m from where the segment has it now")
    assert "holding position" in said["text"]
    state = await b.state(lambda s: s["mover"] == "hold", "a hold")
    assert state["segment"] is None  # it is not at the end of it


async def test_a_mode_that_does_not_come_again_is_held_and_not_left_to_nobody(bench: StartBench) -> None:
    b = await bench(autopilot=12, settings={"origin": ORIGIN, "failsafe": Failsafe(land_after=2.0)})
    await reengaging(b, way((1.0, 0.0), (40.0, 0.0), speed=1.0))
    await b.event("OFFBOARD does not come again: holding position")
    await b.peer.until(lambda: asked(b, RTL) > 0, "the action that follows a hold")


@pytest.mark.parametrize("ends", ["release", "revoke"])
async def test_a_lease_that_ends_on_purpose_while_the_mode_is_away_ends_in_a_hold(bench: StartBench, ends: str) -> None:
    b = await bench(autopilot=12, settings={"origin": ORIGIN, "failsafe": Failsafe(land_after=2.5)})
    alice = await reengaging(b, way((1.0, 0.0), (40.0, 0.0), speed=1.0))
    await b.ground.do(ends, **({"lease": alice.token} if ends == "release" else {}))
    state = await b.state(lambda s: s["lease"] is None, "no lease")
    assert state["mover"] == "hold"
    for _ in range(17):
        await b.state(lambda s: True, "a moment")  # 5 Hz: past land_after
    assert not asked(b, RTL)


async def test_an_order_that_fails_while_the_mode_is_away_ends_in_a_hold(bench: StartBench) -> None:
    b = await bench(autopilot=12, settings={"origin": ORIGIN})
    alice = await reengaging(b, way((1.0, 0.0), (40.0, 0.0), speed=1.0))
    b.peer.mute = set()
    b.peer.results = {SET_MODE: [4]}
    with pytest.raises(Refused):
        await b.ground.do("rtl", lease=alice.token)
    await b.state(lambda s: s["mover"] == "hold", "a hold")


async def test_a_rover_s_height_keeps_it_from_no_segment(bench: StartBench) -> None:
    b = await bench(mav_type=10, settings={"origin": ORIGIN})
    alice = await pilot(b, mode=ROVER_GUIDED)
    await stand(b)  # 10 m above the origin, as a hill is
    t = time.time()
    places = ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    alice.put(vel=None, segment=[wire.SegmentPoint(t=t + k, pos=place) for k, place in enumerate(places)])
    await b.state(lambda s: s["segment"] is not None, "the segment")
