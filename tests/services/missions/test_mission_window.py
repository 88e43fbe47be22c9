"""Items of an upload under way: which are lost, which is refused, and words that come late or never."""

from __future__ import annotations

import asyncio

import pytest

from tests.services.conftest import Told
from tests.services.missions.mission_peer import (
    ACCEPTED,
    CANCELLED,
    DENIED,
    INVALID,
    MISSION,
    MissionBench,
    raw,
    waypoints,
)
from zmav.errors import Refused
from zmav.services.missions.transfer import TransferTimes


@pytest.mark.parametrize(("style", "most"), [("ardupilot", 4), ("px4", 1)])
async def test_so_many_items_are_under_way(mission_bench: MissionBench, style: str, most: int) -> None:
    """A far autopilot has the next items before it asks for them; one that takes only what it asked for has not."""
    b, peer = await mission_bench(
        style, pace=TransferTimes(reply=9.0, shortest=9.0, longest=9.0)
    )  # nothing is repeated
    peer.load(MISSION, raw(waypoints(3, alt=99.0)))
    take, waiting, under_way = peer.on_mission_item_int, list[Told](), list[int]()

    def hold(told: Told) -> None:
        """Answered when as many have come as are sent without an answer."""
        waiting.append(told)
        assert peer.upload
        if len(waiting) == min(most, peer.upload["count"] - peer.upload["next"]):
            under_way.append(len(waiting))
            for each in waiting:
                take(each)
            waiting.clear()

    peer.on_mission_item_int = hold  # type: ignore[method-assign]
    assert (await b.ground.do("mission_upload", items=waypoints(20))).result["count"] == 20
    assert peer.stored() == raw(waypoints(20))
    assert under_way[0] == max(under_way) == most
    assert len(peer.heard("MISSION_ITEM_INT")) == 20 + peer.home_first


async def test_which_of_those_under_way_is_refused(mission_bench: MissionBench) -> None:
    """The requests before the refusal are lost: only one by one is it certain which item it was."""
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {6: INVALID}
    peer.loses = lambda seq: seq >= 5 and len(peer.heard("MISSION_COUNT")) == 1
    with pytest.raises(Refused, match=r"refused item 5 \(MAV_CMD_NAV_WAYPOINT\): MAV_MISSION_INVALID") as caught:
        await b.ground.do("mission_upload", items=waypoints(12))
    assert (caught.value.detail["item"], caught.value.detail["in_force"]) == (5, "old")
    uploads = peer.heard("MISSION_COUNT")
    assert [told.fields["count"] for told in uploads] == [13, 13, 3]  # to learn which, and to bring the old one back
    assert peer.stored() == raw(waypoints(2))


async def test_only_what_may_be_refused_is_sent_one_by_one(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {6: INVALID}
    # Who does not send the items up to 3 unasked is stuck before them.
    peer.loses = lambda seq: seq in (1, 2, 3) or (seq >= 5 and len(peer.heard("MISSION_COUNT")) == 1)
    with pytest.raises(Refused, match=r"refused item 5 \(MAV_CMD_NAV_WAYPOINT\): MAV_MISSION_INVALID"):
        await b.ground.do("mission_upload", items=waypoints(12))
    assert [told.fields["count"] for told in peer.heard("MISSION_COUNT")] == [13, 13, 3]
    assert peer.stored() == raw(waypoints(2))


async def test_an_item_that_is_asked_for_again_late_is_not_the_one_refused(mission_bench: MissionBench) -> None:
    """A doubled request, or a delayed one: the upload begins again no second time for it."""
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {6: INVALID}
    take = peer.on_mission_item_int

    def ask_again(told: Told) -> None:
        if told.fields["seq"] == 6 and peer.upload and peer.upload["next"] == 6:
            peer.send(peer.asks, target_system=told.source[0], target_component=told.source[1], seq=5)
        take(told)

    peer.on_mission_item_int = ask_again  # type: ignore[method-assign]
    with pytest.raises(Refused, match=r"refused item 5 \(MAV_CMD_NAV_WAYPOINT\): MAV_MISSION_INVALID") as caught:
        await b.ground.do("mission_upload", items=waypoints(12))
    assert (caught.value.detail["item"], caught.value.detail["in_force"]) == (5, "old")
    assert [told.fields["count"] for told in peer.heard("MISSION_COUNT")] == [13, 13, 3]
    assert peer.stored() == raw(waypoints(2))


async def test_an_item_that_was_sent_alone_again_is_not_the_one_refused(mission_bench: MissionBench) -> None:
    """Of those behind it one had come before, and is refused; the request for it is lost."""
    b, peer = await mission_bench("ardupilot", pace=TransferTimes(reply=0.1, shortest=0.1, longest=0.15))
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {6: INVALID}
    peer.loses = lambda seq: seq >= 6 and len(peer.heard("MISSION_COUNT")) == 1
    take, held, first = peer.on_mission_item_int, list[Told](), list[Told]()

    async def insist(told: Told) -> None:
        while len(first) < 2:
            peer.send(peer.asks, target_system=told.source[0], target_component=told.source[1], seq=5)
            await asyncio.sleep(0.03)

    def delay(told: Told) -> None:
        """The first item 5 is lost, and what came behind it comes behind the second."""
        seq = told.fields["seq"]
        if len(peer.heard("MISSION_COUNT")) > 1 or seq < 5:
            take(told)
        elif seq > 5:
            held.append(told)
        elif not first:
            first.append(told)
            asking.append(asyncio.create_task(insist(told)))
        else:
            first.append(told)
            for each in (told, *held):
                take(each)

    asking: list[asyncio.Task[None]] = []
    peer.on_mission_item_int = delay  # type: ignore[method-assign]
    with pytest.raises(Refused, match=r"refused item 5 \(MAV_CMD_NAV_WAYPOINT\): MAV_MISSION_INVALID") as caught:
        await b.ground.do("mission_upload", items=waypoints(12))
    assert (caught.value.detail["item"], caught.value.detail["in_force"]) == (5, "old")
    assert peer.stored() == raw(waypoints(2))
    await asyncio.gather(*asking)


@pytest.mark.parametrize("result", [DENIED, CANCELLED])
async def test_what_refuses_no_item_is_not_asked_which_it_is(mission_bench: MissionBench, result: int) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {6: result}
    peer.loses = lambda seq: seq >= 5
    with pytest.raises(Refused, match="the autopilot refused the mission: ") as caught:
        await b.ground.do("mission_upload", items=waypoints(12))
    name = {DENIED: "MAV_MISSION_DENIED", CANCELLED: "MAV_MISSION_OPERATION_CANCELLED"}[result]
    assert (caught.value.detail["result"], caught.value.detail["in_force"]) == (name, "old")
    assert caught.value.detail["item"] is None
    assert [told.fields["count"] for told in peer.heard("MISSION_COUNT")] == [13, 3]
    assert peer.stored() == raw(waypoints(2))


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize(("count", "lost"), [(12, 1), (12, 3), (3, 3), (1, 1)])
async def test_the_last_requests_are_lost(mission_bench: MissionBench, count: int, lost: int, silent: bool) -> None:
    """Or overtaken by the acknowledgement, or that is lost, too: everything is there, and is not sent again."""
    b, peer = await mission_bench("ardupilot")
    peer.silent_at_end = silent
    peer.loses = lambda seq: seq > count - lost
    outcome = await b.ground.do("mission_upload", items=waypoints(count))
    assert (outcome.result["count"], outcome.result["known_by"]) == (count, "read back")
    assert peer.stored() == raw(waypoints(count))
    assert len(peer.heard("MISSION_COUNT")) == 1


async def test_a_late_word_is_none_of_a_short_plan(mission_bench: MissionBench) -> None:
    """All of it is sent at the first request, and not all of it arrives."""
    b, peer = await mission_bench("ardupilot")
    ask, take, dropped = peer.ask, peer.on_mission_item_int, list[Told]()

    def late() -> None:
        ask()
        if peer.upload and peer.upload["next"] == 0:
            peer.ack(MISSION, ACCEPTED, peer.upload["from"])

    def lose(told: Told) -> None:
        if told.fields["seq"] == 1 and not dropped:
            dropped.append(told)
        else:
            take(told)

    peer.ask, peer.on_mission_item_int = late, lose  # type: ignore[method-assign]
    assert (await b.ground.do("mission_upload", items=waypoints(3))).result["count"] == 3
    assert (peer.stored(), len(peer.heard("MISSION_COUNT"))) == (raw(waypoints(3)), 1)
    assert len(peer.heard("MISSION_REQUEST_LIST")) == 2  # before it, and when it had ended


@pytest.mark.parametrize("lost", [0, 3, 12])
async def test_an_item_under_way_is_lost(mission_bench: MissionBench, lost: int) -> None:
    """What comes behind it is not taken either, and all of that is sent again."""
    b, peer = await mission_bench("ardupilot")
    take, dropped = peer.on_mission_item_int, list[int]()

    def lose(told: Told) -> None:
        if told.fields["seq"] == lost and not dropped:
            dropped.append(lost)
        else:
            take(told)

    peer.on_mission_item_int = lose  # type: ignore[method-assign]
    assert (await b.ground.do("mission_upload", items=waypoints(12))).result["count"] == 12
    assert peer.stored() == raw(waypoints(12))
    assert len(peer.heard("MISSION_COUNT")) == 1
