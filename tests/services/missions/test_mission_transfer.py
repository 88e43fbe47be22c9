"""Uploads and downloads against an autopilot that stores as ArduPilot does, and as PX4 does; bad links, bad manners."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.conftest import Told
from tests.services.missions.mission_peer import (
    DENIED,
    ERROR,
    FENCE,
    FENCE_ITEMS,
    INVALID,
    MISSION,
    RALLY,
    RALLY_ITEMS,
    WAYPOINT,
    MissionBench,
    plan,
    raw,
    waypoints,
)
from zmav.errors import BadInput, Refused, Stale, TimedOut, Unsupported
from zmav.services.missions.transfer import TransferTimes

if TYPE_CHECKING:
    from tests.conftest import Net


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_up_and_down(mission_bench: MissionBench, style: str) -> None:
    b, peer = await mission_bench(style)
    peer.load(MISSION, raw(waypoints(3, alt=99.0)))
    outcome = await b.ground.do("mission_upload", items=waypoints(12))
    assert peer.stored() == raw(waypoints(12))
    known_by = {"ardupilot": "read back", "px4": "opaque id"}[style]
    assert outcome.result["count"] == 12
    assert outcome.result["known_by"] == known_by
    assert "kept_otherwise" not in outcome.result
    assert (await b.ground.do("mission_download")).result["count"] == 12
    got = await plan(b)
    assert [(i.command, i.params, i.z) for i in got.items] == [
        (WAYPOINT, [each["params"][0], 0.0, 0.0, 0.0], each["z"]) for each in waypoints(12)
    ]
    assert [i.x for i in got.items] == pytest.approx([w["x"] for w in waypoints(12)])
    assert [i.y for i in got.items] == pytest.approx([w["y"] for w in waypoints(12)])
    assert {i.frame for i in got.items} == {"MAV_FRAME_GLOBAL_RELATIVE_ALT"}
    await b.ground.do("mission_clear")
    assert peer.stored() == []
    assert (await plan(b)).items == []


async def test_home_is_put_in_and_taken_out(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    jump = {"command": "MAV_CMD_DO_JUMP", "frame": "MAV_FRAME_MISSION", "params": [1, 3]}
    await b.ground.do("mission_upload", items=[*waypoints(2), jump])
    counts = [told.fields["count"] for told in peer.heard("MISSION_COUNT")]
    assert counts == [4]
    assert peer.plans[MISSION][3]["param1"] == 2.0  # as ArduPilot counts
    assert (await plan(b)).items[2].params[0] == 1.0


async def test_a_px4_mission_has_no_home(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    jump = {"command": "MAV_CMD_DO_JUMP", "frame": "MAV_FRAME_MISSION", "params": [1, 3]}
    await b.ground.do("mission_upload", items=[*waypoints(2), jump])
    assert peer.plans[MISSION][2]["param1"] == 1.0
    assert len(peer.plans[MISSION]) == 3


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
@pytest.mark.parametrize(("kind", "number", "items"), [("fence", FENCE, FENCE_ITEMS), ("rally", RALLY, RALLY_ITEMS)])
async def test_fences_and_rally_points(
    mission_bench: MissionBench, style: str, kind: str, number: int, items: list[dict[str, Any]]
) -> None:
    b, peer = await mission_bench(style)
    peer.load(MISSION, raw(waypoints(2)))
    await b.ground.do("mission_upload", kind=kind, items=items)
    assert len(peer.plans[number]) == len(items)  # no home among them
    assert [(i.command, i.params[0]) for i in (await plan(b, kind)).items] == [
        (i["command"], i.get("params", [0.0])[0]) for i in items
    ]
    assert peer.stored() == raw(waypoints(2))
    await b.ground.do("mission_clear", kind=kind)
    assert peer.plans[number] == []
    assert peer.stored() == raw(waypoints(2))


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_items_that_nobody_asked_for_yet_are_asked_for_in_their_turn(
    mission_bench: MissionBench, style: str
) -> None:
    """Another program reads the same plan, and what it is told comes to all."""
    b, peer = await mission_bench(style)
    peer.load(MISSION, raw(waypoints(12)))
    counted = peer.on_mission_request_list

    def count(told: Told) -> None:
        counted(told)
        to = dict(zip(("target_system", "target_component"), told.source, strict=True))
        for seq in (9, 6):
            peer.send("MISSION_ITEM_INT", **to, **peer.plans[MISSION][seq], seq=seq, mission_type=MISSION)

    peer.on_mission_request_list = count  # type: ignore[method-assign]
    assert (await b.ground.do("mission_download")).result["count"] == 12
    asked = [told.fields["seq"] for told in peer.told if told.name == "MISSION_REQUEST_INT"]
    assert set(asked) == set(range(12 + peer.home_first))


# The link.


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_a_hundred_items_over_a_bad_link(mission_bench: MissionBench, style: str) -> None:
    """20 % of the frames lost, 200 ms each way, at a tenth of all times: the peer gives an upload up after 0.8 s."""
    b, peer = await mission_bench(style, pace=TransferTimes(reply=0.072, shortest=0.02, longest=0.16))
    peer.load(MISSION, raw(waypoints(3, alt=99.0)))
    peer.loss, peer.delay, peer.time = 0.2, 0.02, 0.1
    assert (await b.ground.do("mission_upload", items=waypoints(100))).result["count"] == 100
    assert (await b.ground.do("mission_download")).result["count"] == 100
    assert peer.stored() == raw(waypoints(100))
    assert len((await plan(b)).items) == 100


@pytest.mark.parametrize("complains", [True, False])
async def test_the_last_word_is_lost(mission_bench: MissionBench, complains: bool) -> None:
    """The acknowledgement does not come, and a repeated item is refused or not even that: what is read back tells."""
    b, peer = await mission_bench("ardupilot")
    peer.silent_at_end = True
    take = peer.on_mission_item_int
    if not complains:
        peer.on_mission_item_int = lambda told: take(told) if peer.upload else None  # type: ignore[method-assign]
    assert (await b.ground.do("mission_upload", items=waypoints(5))).result["known_by"] == "read back"
    assert peer.stored() == raw(waypoints(5))
    assert len(peer.heard("MISSION_ITEM_INT")) < 6 + 6  # it is not asked for ever


async def test_nobody_answers(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", pace=TransferTimes(reply=0.02, shortest=0.02, attempts=4))
    peer.kinds = set()
    peer.ack = lambda *args: None  # type: ignore[method-assign]
    with pytest.raises(TimedOut, match="download of the mission: the autopilot does not answer"):
        await b.ground.do("mission_upload", items=waypoints(5))
    assert len(peer.heard("MISSION_REQUEST_LIST")) == 4
    assert not peer.heard("MISSION_COUNT")  # the old plan is not known, so it is not put at risk


# How it asks.


@pytest.mark.parametrize("asks", ["MISSION_REQUEST", "MISSION_REQUEST_INT"])
@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_it_asks_twice_for_everything(mission_bench: MissionBench, style: str, asks: str) -> None:
    """What was sent within the time that an answer takes is not sent again."""
    b, peer = await mission_bench(style, pace=TransferTimes(reply=9.0, shortest=9.0, longest=9.0))
    peer.asks, peer.times_asked = asks, 2
    await b.ground.do("mission_upload", items=waypoints(10))
    assert peer.stored() == raw(waypoints(10))
    assert len(peer.heard("MISSION_ITEM_INT")) == 10 + peer.home_first
    assert not peer.heard("MISSION_ITEM")


async def test_it_asks_out_of_order(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    order, got = [2, 0, 3, 1, 3, 0], {}

    def ask_next() -> None:
        peer.send("MISSION_REQUEST_INT", target_system=1, target_component=191, seq=order[0])

    def take(told: Any) -> None:
        got[told.fields["seq"]] = {name: told.fields[name] for name in ("x", "y", "z")}
        if order and told.fields["seq"] == order[0]:
            order.pop(0)
            if order:
                ask_next()
            else:
                peer.ack(MISSION, 0, told.source, 77)

    peer.on_mission_item_int = take  # type: ignore[method-assign]
    peer.ask = ask_next  # type: ignore[method-assign]
    await b.ground.do("mission_upload", items=waypoints(4))
    assert {seq: item["x"] for seq, item in got.items()} == {i: w["x"] for i, w in enumerate(raw(waypoints(4)))}


async def test_strangers_requests_and_acks_are_not_ours(mission_bench: MissionBench) -> None:
    """Another's transaction on the same link, seen in the middle of ours: only the target tells."""
    b, peer = await mission_bench("ardupilot")
    ask = peer.ask

    def with_noise() -> None:
        peer.send("MISSION_REQUEST_INT", target_system=255, target_component=190, seq=0)
        peer.ack(MISSION, ERROR, (255, 190))
        peer.ack(MISSION, 0, (255, 190))
        peer.ack(FENCE, ERROR, (1, 191))
        peer.ack(MISSION, 0, (1, 191))  # ours, but a late one
        ask()

    peer.ask = with_noise  # type: ignore[method-assign]
    await b.ground.do("mission_upload", items=waypoints(5))
    assert peer.stored() == raw(waypoints(5))
    # A request of the vehicle's that was late is repeated, and so is its answer; to answer a stranger's would go back.
    numbers = [told.fields["seq"] for told in peer.heard("MISSION_ITEM_INT")]
    assert numbers == sorted(numbers) and set(numbers) == set(range(6))


async def test_a_ground_station_is_at_it_first(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.upload = {"kind": MISSION, "count": 3, "from": (255, 190), "next": 0, "new": []}
    upload = asyncio.create_task(b.ground.do("mission_upload", items=waypoints(4)))
    await peer.count("MISSION_REQUEST_LIST", 2)
    peer.upload = None
    await upload
    assert peer.stored() == raw(waypoints(4))


async def test_a_ground_station_never_ends(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(2)))
    peer.upload = {"kind": MISSION, "count": 3, "from": (255, 190), "next": 0, "new": []}
    for verb, args in (("mission_upload", {"items": waypoints(4)}), ("mission_download", {})):
        with pytest.raises(Refused, match="somebody else's transaction") as caught:
            await b.ground.do(verb, **args)
        assert caught.value.detail["result"] == "MAV_MISSION_DENIED"
    assert peer.stored() == raw(waypoints(2))


async def test_one_transaction_at_a_time(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.delay = 0.01
    orders = [
        b.ground.do("mission_upload", items=waypoints(6)),
        b.ground.do("mission_upload", kind="rally", items=RALLY_ITEMS),
        b.ground.do("mission_upload", kind="fence", items=FENCE_ITEMS),
        b.ground.do("mission_download", kind="rally"),
    ]
    await asyncio.gather(*orders)
    begun = [
        t for t in peer.told if t.name in ("MISSION_COUNT", "MISSION_REQUEST_LIST", "MISSION_ITEM_INT", "MISSION_ACK")
    ]
    kinds = [t.fields["mission_type"] for t in begun]
    runs = [kind for i, kind in enumerate(kinds) if i == 0 or kinds[i - 1] != kind]
    assert len(runs) <= 4, runs  # each to its end before the next
    assert [len(peer.plans[kind]) for kind in (MISSION, FENCE, RALLY)] == [7, 4, 1]


@pytest.mark.parametrize("style", ["ardupilot", "px4"])
async def test_two_clients_that_upload_at_once_mix_nothing(mission_bench: MissionBench, net: Net, style: str) -> None:
    """Over a link that delays and loses: what was late from the one upload goes into none of the other."""
    b, peer = await mission_bench(style)
    peer.delay, peer.loss, peer.time = 0.01, 0.05, 0.1
    plans, grounds = [waypoints(12, alt) for alt in (30.0, 60.0)], [b.ground, net.ground(b.endpoint)]
    for _ in range(3):
        told = len(peer.told)
        await asyncio.gather(*(g.do("mission_upload", items=p) for g, p in zip(grounds, plans, strict=True)))
        runs: list[list[float]] = []
        for each in peer.told[told:]:
            if each.name == "MISSION_COUNT":
                runs.append([])
            # The first one may be home; and before the first count some come late, from the round before.
            elif runs and each.name == "MISSION_ITEM_INT" and each.fields["seq"]:
                runs[-1].append(each.fields["z"])
        assert all(len({z >= 60.0 for z in run}) == 1 for run in runs if run), runs
        assert peer.stored() in [raw(p) for p in plans]


async def test_readers_at_the_same_time_share_one_download(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", pace=TransferTimes())  # a busy machine asks no second time
    peer.load(MISSION, raw(waypoints(8)))
    peer.delay = 0.02
    found = await asyncio.gather(*(plan(b) for _ in range(5)))
    assert [len(each.items) for each in found] == [8] * 5
    assert len(peer.heard("MISSION_REQUEST_LIST")) == 1
    await plan(b)  # from the cache
    assert len(peer.heard("MISSION_REQUEST_LIST")) == 1


async def test_a_slow_reading_says_how_far_it_is(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", pace=TransferTimes(reply=2.0))
    peer.load(MISSION, raw(waypoints(3)))
    answer = peer.on_mission_request_int
    peer.on_mission_request_int = lambda told: None if told.fields["seq"] == 2 else answer(told)  # type: ignore[method-assign]
    with pytest.raises(Stale, match="being read: 3 of 4 items") as caught:
        await plan(b)
    assert caught.value.detail["reading"] is True
    peer.on_mission_request_int = answer  # type: ignore[method-assign]
    assert len((await plan(b)).items) == 3


async def test_a_kind_it_does_not_keep(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.kinds = {MISSION}
    with pytest.raises(Unsupported, match="MAV_MISSION_UNSUPPORTED"):
        await b.ground.do("mission_upload", kind="fence", items=FENCE_ITEMS)
    with pytest.raises(Unsupported):
        await plan(b, "fence")
    with pytest.raises(BadInput, match="no kind of mission 'survey'"):
        await plan(b, "survey")


async def test_a_plan_that_changes_while_it_is_read(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.load(MISSION, raw(waypoints(8)))
    answer = peer.on_mission_request_int
    changed: list[bool] = []

    def change(told: Any) -> None:
        if told.fields["seq"] == 4 and not changed:
            changed.append(True)
            peer.load(MISSION, raw(waypoints(3)))
            peer.on_mission_request_list(told)
        answer(told)

    peer.on_mission_request_int = change  # type: ignore[method-assign]
    await b.ground.do("mission_download")
    assert len((await plan(b)).items) == 3


# What is checked before anything is sent.


BAD_ITEMS: list[tuple[str, list[dict[str, Any]], str]] = [
    ("mission", [{"command": "MAV_CMD_NAV_WAYPONT"}], "item 0: no command .*; did you mean MAV_CMD_NAV_WAYPOINT"),
    ("mission", [{"command": WAYPOINT, "frame": "GLOBAL"}], "no frame 'GLOBAL'; did you mean MAV_FRAME_GLOBAL"),
    ("mission", [{"command": WAYPOINT, "x": 90.1}], "item 0: latitude 90.1 is beyond ±90"),
    ("mission", [{"command": WAYPOINT, "y": -180.5}], "item 0: longitude -180.5 is beyond ±180"),
    ("mission", [{"command": WAYPOINT, "z": 1e39}], "z is 1e\\+39"),
    ("mission", [{"command": WAYPOINT, "params": [1, 2, 3, 4, 5]}], "5 params"),
    ("mission", [{"command": "MAV_CMD_DO_JUMP", "params": [1]}], "jumps to item 1.0, which there is not"),
    ("mission", [{"command": "MAV_CMD_DO_SET_SERVO", "x": 0.5}], "x is 0.5, but this command has whole numbers"),
    ("mission", RALLY_ITEMS, "MAV_CMD_NAV_RALLY_POINT in a mission"),
    ("mission", FENCE_ITEMS, "item 3: MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION in a mission"),
    ("rally", [{"command": WAYPOINT}], f"{WAYPOINT} in rally points"),
    ("fence", [{"command": WAYPOINT}], "is no fence item"),
    ("fence", FENCE_ITEMS[:2], "a polygon of 3 vertices \\(param1\\) ends after 2"),
    ("fence", [{**FENCE_ITEMS[0], "params": [2]}] * 2, "number of vertices of its polygon, 3 or more, not 2"),
    ("fence", [*FENCE_ITEMS[:2], {**FENCE_ITEMS[2], "params": [4]}], "its vertex 2 says 4.0 in param1"),
    ("fence", [{**FENCE_ITEMS[3], "params": [0]}], "a circle of radius 0 m"),
    ("mission", [{"command": WAYPOINT, "x": 95}, {"command": WAYPOINT}, {"command": "X"}], "item 0: .*; item 2: "),
]


async def test_bad_items_are_named_before_anything_is_sent(
    mission_bench: MissionBench, subtests: pytest.Subtests
) -> None:
    b, peer = await mission_bench("ardupilot")
    for kind, items, words in BAD_ITEMS:
        with subtests.test(words):
            with pytest.raises(BadInput, match=words) as caught:
                await b.ground.do("mission_upload", kind=kind, items=items)
            assert caught.value.detail["faults"]
    assert not [told for told in peer.told if told.name.startswith("MISSION_")]


async def test_places_by_frame(mission_bench: MissionBench) -> None:
    """Degrees in a global frame, metres in a local one, plain numbers where the command has no place."""
    b, peer = await mission_bench("px4")
    items = [
        {"command": WAYPOINT, "frame": "MAV_FRAME_GLOBAL", "x": -35.1234567, "y": 149.7654321, "params": [None] * 4},
        {"command": WAYPOINT, "frame": "MAV_FRAME_LOCAL_NED", "x": 12.5, "y": -7.25},
        {"command": "MAV_CMD_DO_DIGICAM_CONTROL", "frame": "MAV_FRAME_MISSION", "x": 1, "y": 2},
        {"command": "MAV_CMD_DO_DIGICAM_CONTROL", "frame": "MAV_FRAME_GLOBAL", "x": 1, "y": 2},
        {"command": "UNKNOWN_31999", "x": 1.5, "y": 2.5},
    ]
    await b.ground.do("mission_upload", items=items)
    assert [(i["x"], i["y"]) for i in peer.stored()] == [
        (-351234567, 1497654321),
        (125000, -72500),
        (1, 2),
        (1, 2),
        (15000000, 25000000),
    ]
    assert all(math.isnan(peer.stored()[0][f"param{n}"]) for n in range(1, 5))
    assert peer.stored()[4]["command"] == 31999
    await b.ground.do("mission_download")
    got = (await plan(b)).items
    assert [(i.command, i.x, i.y) for i in got] == [(i["command"], i["x"], i["y"]) for i in items]
    assert got[0].params == [None] * 4


async def test_refusals_name_the_item(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    peer.refuses = {8: INVALID}
    with pytest.raises(Refused, match=r"refused item 7 \(MAV_CMD_NAV_WAYPOINT\): MAV_MISSION_INVALID") as caught:
        await b.ground.do("mission_upload", items=waypoints(10))
    assert caught.value.detail["item"] == 7
    assert caught.value.detail["result"] == "MAV_MISSION_INVALID"


async def test_denied_in_the_middle_is_a_refusal(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    peer.load(MISSION, raw(waypoints(2)))
    peer.refuses = {3: DENIED}
    with pytest.raises(Refused, match=r"refused the mission: MAV_MISSION_DENIED; in force: the old mission"):
        await b.ground.do("mission_upload", items=waypoints(10))
