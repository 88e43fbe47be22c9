"""What is in force after an upload that fails, and what the cache behind ``mission/{kind}`` knows."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from tests.services.conftest import Bench
from tests.services.missions.mission_peer import (
    FENCE,
    FENCE_ITEMS,
    INVALID,
    MISSION,
    RALLY,
    RALLY_ITEMS,
    MissionBench,
    MissionPeer,
    plan,
    raw,
    waypoints,
)
from zmav import keys
from zmav.errors import Refused, Stale, TimedOut, ZmavError
from zmav.services.missions.items import Items
from zmav.services.missions.transfer import TransferTimes

OLD, NEW = raw(waypoints(4, alt=90.0)), waypoints(10)
BRIEF = TransferTimes(reply=0.02, shortest=0.02, longest=0.05, attempts=5, again=0.02, busy=0.1)


async def refused(b: Bench, **more: Any) -> ZmavError:
    with pytest.raises((Refused, TimedOut)) as caught:
        await b.ground.do("mission_upload", **more)
    return caught.value


# A failed upload.


async def test_a_refused_item_brings_the_old_mission_back(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    peer.refuses = {8: INVALID}
    error = await refused(b, items=NEW)
    assert peer.stored() == OLD  # of which the autopilot had overwritten everything
    assert "refused item 7 (MAV_CMD_NAV_WAYPOINT): MAV_MISSION_INVALID" in error.message
    assert error.message.endswith("in force: the old mission (4 items), restored")
    assert (error.detail["in_force"], error.detail["plan"], error.detail["item"]) == ("old", "mission", 7)
    there = await plan(b)
    assert (len(there.items), there.home) == (4, (-35.363261, 149.16523, 584.0))
    said = await b.event("in force: the old mission (4 items), restored", kind="mission")
    assert said["severity"] == "warning"


@pytest.mark.parametrize(
    ("style", "kind", "number", "items"),
    [
        ("px4", "mission", MISSION, NEW),
        ("ardupilot", "fence", FENCE, FENCE_ITEMS),
        ("px4", "rally", RALLY, RALLY_ITEMS),
    ],
)
async def test_where_nothing_was_overwritten_nothing_is_restored(
    mission_bench: MissionBench, style: str, kind: str, number: int, items: list[dict[str, Any]]
) -> None:
    b, peer = await mission_bench(style)
    old = [{**OLD[0], "command": 5100 if kind == "rally" else 5004 if kind == "fence" else 16, "param1": 9.0}]
    peer.load(number, old)
    peer.refuses = {len(items) - 1: INVALID}
    error = await refused(b, kind=kind, items=items)
    assert error.message.endswith("(1 items), untouched")
    assert peer.stored(number) == old
    assert len(peer.heard("MISSION_COUNT")) == 1


async def test_where_there_was_no_mission_there_is_none_again(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.refuses = {3: INVALID}
    error = await refused(b, items=NEW)
    assert peer.stored() == []
    assert "the old mission (0 items), restored" in error.message


async def test_refused_with_the_autopilot_s_words(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    take = peer.on_mission_item_int

    def grumble(told: Any) -> None:
        if told.fields["seq"] == 3:
            peer.send("STATUSTEXT", severity=3, text="Mission: bad altitude")
        take(told)

    peer.on_mission_item_int = grumble  # type: ignore[method-assign]
    peer.refuses = {3: INVALID}
    error = await refused(b, items=NEW)
    assert "MAV_MISSION_INVALID (Mission: bad altitude)" in error.message
    assert error.detail["reasons"] == ["Mission: bad altitude"]


async def test_kept_otherwise_in_its_place_is_a_failure(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    peer.changes = lambda seq, item: {**item, "x": item["x"] + 5} if seq == 3 and item["z"] < 60 else item
    error = await refused(b, items=NEW)
    assert "the autopilot took the mission, but keeps it otherwise: item 2: place: sent" in error.message
    assert peer.stored() == OLD


async def test_fewer_kept_than_sent_is_a_failure(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    ask = peer.ask

    def forget() -> None:
        if len(peer.plans[MISSION]) > 8:
            peer.plans[MISSION].pop()
        ask()

    peer.ask = forget  # type: ignore[method-assign]
    error = await refused(b, items=NEW)
    assert "but keeps" in error.message
    assert peer.stored() == OLD


async def test_rounded_parameters_are_told_and_no_failure(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.changes = lambda seq, item: {**item, "param1": float(int(item["param1"])), "z": round(item["z"], 2)}
    items = [{**each, "params": [2.5]} for each in waypoints(3)]
    outcome = await b.ground.do("mission_upload", items=items)
    assert outcome.result["kept_otherwise"] == [f"item {i}: param1: sent 2.5, kept 2" for i in range(3)]


async def test_what_is_left_to_the_autopilot_is_no_note(mission_bench: MissionBench) -> None:
    """NaN asks for nothing; and numbers come back as people write them, not as single precision holds them."""
    b, peer = await mission_bench("ardupilot")
    peer.changes = lambda seq, item: {**item, "param4": 0.0}
    items = [{**each, "params": [0.1, 0, 0, None], "z": 12.3} for each in waypoints(2)]
    outcome = await b.ground.do("mission_upload", items=items)
    assert "kept_otherwise" not in outcome.result
    assert [(i.params, i.z) for i in (await plan(b)).items] == [([0.1, 0.0, 0.0, 0.0], 12.3)] * 2


async def test_a_stack_that_is_exact_must_keep_parameters(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("generic")
    peer.load(MISSION, OLD)
    peer.changes = lambda seq, item: {**item, "param1": 7.0} if seq == 9 else item
    error = await refused(b, items=NEW)
    assert "item 9: param1: sent 4, kept 7" in error.message
    assert peer.stored() == OLD


async def test_it_dies_in_the_middle_and_is_mended_when_it_comes_back(
    mission_bench: MissionBench,
) -> None:
    b, peer = await mission_bench("ardupilot", pace=BRIEF)
    b.vehicle.missions.mend_every = 0.1
    peer.load(MISSION, OLD)
    peer.dies_at = 6
    error = await refused(b, items=NEW)
    assert isinstance(error, TimedOut)
    assert error.detail["in_force"] == "unknown"
    assert "maybe a mixture of old and new; it is put right once the autopilot answers again" in error.message
    assert peer.stored() not in (OLD, raw(NEW))
    peer.dead, peer.upload = False, None
    await b.event("mission: the old one was restored")
    assert peer.stored() == OLD
    assert len((await plan(b)).items) == 4


async def test_what_somebody_else_put_there_is_not_mended(
    mission_bench: MissionBench,
) -> None:
    """The new plan is found whole when the autopilot comes back: then it is the one in force."""
    b, peer = await mission_bench("ardupilot", pace=BRIEF)
    b.vehicle.missions.mend_every = 0.1
    peer.load(MISSION, OLD)
    peer.dies_at = 6
    await refused(b, items=NEW)
    peer.load(MISSION, raw(NEW))
    peer.dead, peer.upload = False, None
    await b.event("mission: the new one is in force after all")
    assert peer.stored() == raw(NEW)


async def test_a_second_try_goes_back_to_the_plan_before_the_first(
    mission_bench: MissionBench,
) -> None:
    b, peer = await mission_bench("ardupilot", pace=BRIEF)
    b.vehicle.missions.mend_every = math.inf
    peer.load(MISSION, OLD)
    peer.dies_at = 6
    await refused(b, items=NEW)
    peer.dead, peer.upload = False, None
    peer.refuses = {5: INVALID}
    error = await refused(b, items=NEW)
    assert "the old mission (4 items), restored" in error.message
    assert peer.stored() == OLD


# The cache.


async def count(peer: MissionPeer) -> int:
    return len(peer.heard("MISSION_REQUEST_LIST"))


async def test_after_an_upload_nothing_need_be_read(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    await b.ground.do("mission_upload", items=NEW)
    before = await count(peer)
    got = await plan(b)
    assert len(got.items) == 10
    assert got.id == peer.ids[MISSION]
    assert await count(peer) == before


async def test_an_id_that_is_right_saves_reading_the_old_plan(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    await b.ground.do("mission_upload", items=NEW)
    peer.say_current()
    await b.ground.ask(keys.MSG.key("demo", "quad1", msg="MISSION_CURRENT"))
    await asyncio.wait_for(_until(lambda: b.vehicle.missions.progress.ids[0] is not None), 10.0)
    before = await count(peer)
    await b.ground.do("mission_upload", items=waypoints(3))
    assert await count(peer) == before


async def _until(true: Any) -> None:
    while not true():
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_somebody_else_uploads(mission_bench: MissionBench, style: str) -> None:
    """ArduPilot tells by the number of items, PX4 by an id as well."""
    b, peer = await mission_bench(style)
    peer.load(MISSION, OLD)
    assert len((await plan(b)).items) == 4
    peer.load(MISSION, raw(waypoints(4 if style == "px4" else 7)))
    peer.say_current(1)
    await b.event("the mission on the autopilot changed", kind="mission")
    got = await plan(b)
    assert [i.z for i in got.items] == [i["z"] for i in peer.stored()]
    assert await count(peer) == 2


async def test_a_ground_station_s_upload_on_this_link_is_seen(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    await plan(b)
    peer.load(MISSION, raw(waypoints(4)))
    peer.ack(RALLY, 0, (255, 190))  # of a kind nobody has read
    peer.ack(MISSION, 1, (255, 190))  # it failed
    peer.say_current(1)
    await asyncio.wait_for(_until(lambda: b.vehicle.missions.progress.current == 1), 10.0)
    assert b.vehicle.missions._held["mission"].sure
    peer.ack(MISSION, 0, (255, 190))
    await b.event("the mission on the autopilot changed")
    assert (await plan(b)).items[0].z == waypoints(1)[0]["z"]
    assert await count(peer) == 2


async def test_the_same_count_is_no_change(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    await plan(b)
    peer.say_current(2, state=3)
    peer.ack(MISSION, 0, (1, 191))
    await asyncio.wait_for(_until(lambda: b.vehicle.missions.progress.current == 2), 10.0)
    got = await plan(b)
    assert (got.current, got.reached, got.state) == (1, None, "ACTIVE")
    assert await count(peer) == 1


async def test_cleared_by_somebody_else(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    await plan(b)
    peer.load(MISSION, [])
    peer.say_current(0, state=1)
    await b.event("the mission on the autopilot changed")
    assert (await plan(b)).items == []


async def test_progress_counts_without_home(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    peer.say_current(3, state=4)
    peer.send("MISSION_ITEM_REACHED", seq=2)
    await asyncio.wait_for(_until(lambda: b.vehicle.missions.progress.reached == 2), 10.0)
    got = await plan(b)
    assert (got.current, got.reached, got.state) == (2, 1, "PAUSED")
    missions = b.vehicle.missions
    items = missions.items

    def goes_on() -> Items:
        """Called in the thread that encodes the plan: the vehicle flies on meanwhile."""
        missions.progress.current = 9
        return items()

    missions.progress.current, missions.items = 2, goes_on  # type: ignore[method-assign]
    assert (await plan(b)).current == 1  # and not kept as what is told of the second item
    missions.items = items  # type: ignore[method-assign]
    peer.say_current(0)
    await asyncio.wait_for(_until(lambda: b.vehicle.missions.progress.current == 0), 10.0)
    assert (await plan(b)).current is None  # at home


async def test_another_autopilot_has_another_mission(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", uid=11)
    peer.load(MISSION, OLD)
    assert len((await plan(b)).items) == 4
    peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    peer.load(MISSION, raw(waypoints(2)))
    peer.uid, peer.beating = 12, True
    await b.state(lambda s: s["uid"] == f"{12:016x}", "another uid")
    assert len((await plan(b)).items) == 2


async def test_a_silent_autopilot_s_plan_is_still_known_but_not_read(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    await plan(b)
    peer.beating = False
    await b.state(lambda s: not s["connected"], "silence")
    assert len((await plan(b)).items) == 4
    with pytest.raises(Stale, match="silent"):
        await plan(b, "rally")
    with pytest.raises(Stale, match="silent"):
        await b.ground.do("mission_upload", items=NEW)


async def test_a_wildcard_gives_what_is_known(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, OLD)
    key = keys.MISSION.key("demo", "quad1", kind="*")
    assert await b.ground.ask(key) == []
    await plan(b)
    await plan(b, "fence")
    found = {str(reply.ok.key_expr) for reply in await b.ground.ask(key) if reply.ok}
    assert found == {keys.MISSION.key("demo", "quad1", kind=kind) for kind in ("mission", "fence")}
