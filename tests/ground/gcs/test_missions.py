"""Missions through the bridge: downloads from the vehicles' caches, uploads given to the vehicle whole."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import zmav
from ground.gcs import mission_asked
from tests.ground.gcs.fleet import Caller, Fleet
from zmav import wire
from zmav.mavlink import decode
from zmav.services.missions.items import Raw
from zmav.sim import VehicleSpec
from zmav.vehicle.missions import Missions

ARDUPILOT, PX4 = 1, 2
MISSION, FENCE, RALLY = 0, 1, 2
ACCEPTED, ERROR, UNSUPPORTED, INVALID, BAD_SEQUENCE, DENIED, CANCELLED = 0, 1, 3, 5, 13, 14, 15
GLOBAL, RELATIVE, MISSION_FRAME = 0, 3, 2
LAT, LON = -353632610, 1491652300
Item = dict[str, Any]


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    specs = [VehicleSpec(), VehicleSpec(autopilot="px4")]
    with Fleet(specs, speed=1.0, udpin="read_only=1") as fleet:
        yield fleet


@pytest.fixture
def gcs(fleet: Fleet) -> Iterator[Caller]:
    caller = fleet.caller()
    caller.beat()
    yield caller
    caller.close()


def waypoint(seq: int, alt: float = 20.0) -> Item:
    return {"frame": RELATIVE, "command": 16, "autocontinue": 1, "x": LAT + 1000 * seq, "y": LON, "z": alt}


def plan(number: int, count: int, alt: float = 20.0) -> list[Item]:
    """As a station uploads it: to an ArduPilot with home in front."""
    home = [{"frame": GLOBAL, "command": 16, "autocontinue": 1, "x": LAT, "y": LON, "z": 584.0}]
    return (home if number == ARDUPILOT else []) + [waypoint(seq, alt) for seq in range(count)]


def upload(gcs: Caller, number: int, items: list[Item], kind: int = MISSION) -> dict[str, Any]:
    """As a station does it, answering requests until an ACK comes."""
    acks, asked = len(gcs.fields("MISSION_ACK", number)), len(requests(gcs, number))

    def answered() -> bool:
        return len(requests(gcs, number)) > asked or len(gcs.fields("MISSION_ACK", number)) > acks

    gcs.to("MISSION_COUNT", number, count=len(items), mission_type=kind)
    while True:
        gcs.wait(answered, "a word")
        if len(gcs.fields("MISSION_ACK", number)) > acks:
            return gcs.fields("MISSION_ACK", number)[acks]
        seq = requests(gcs, number)[asked]
        asked += 1
        gcs.to("MISSION_ITEM_INT", number, seq=seq, mission_type=kind, **items[seq])


def requests(gcs: Caller, number: int) -> list[int]:
    return [fields["seq"] for fields in gcs.fields("MISSION_REQUEST_INT", number)]


def download(gcs: Caller, number: int, kind: int = MISSION) -> list[Item]:
    count = gcs.answer("MISSION_REQUEST_LIST", "MISSION_COUNT", number, mission_type=kind)
    assert (count["target_system"], count["target_component"], count["mission_type"]) == (gcs.sysid, 190, kind)
    items = [
        gcs.answer("MISSION_REQUEST_INT", "MISSION_ITEM_INT", number, seq=seq, mission_type=kind)
        for seq in range(count["count"])
    ]
    gcs.to("MISSION_ACK", number, type=ACCEPTED, mission_type=kind)
    assert [(item["seq"], item["mission_type"]) for item in items] == [(i, kind) for i in range(len(items))]
    return items


def send_whole(gcs: Caller, number: int, items: list[Item]) -> None:
    """Every item once it is asked for, and no more."""
    asked = len(requests(gcs, number))
    gcs.to("MISSION_COUNT", number, count=len(items))
    for seq, item in enumerate(items):
        gcs.wait(lambda: requests(gcs, number)[asked:][-1:] == [seq], f"a request for {seq}")  # noqa: B023
        gcs.to("MISSION_ITEM_INT", number, seq=seq, **item)


@contextlib.contextmanager
def late_orders(
    fleet: Fleet, of: type = zmav.Vehicle, name: str = "order"
) -> Iterator[tuple[Callable[[], object], list[int]]]:
    """Orders, or what else is asked ``of`` a vehicle, are given only once that is called; and 1 for each that has
    begun, -1 for each that has ended.
    """
    go, under_way = asyncio.Event(), list[int]()
    give = getattr(of, name)

    async def late(self: Any, *args: Any) -> Any:
        under_way.append(1)
        await go.wait()
        try:
            return await give(self, *args)
        finally:
            under_way.append(-1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(of, name, late)
        yield lambda: fleet.loop.call_soon_threadsafe(go.set), under_way


def core(items: list[Item]) -> list[Any]:
    """What an item is and where."""
    return [(item["command"], item["x"], item["y"], item["z"]) for item in items]


@pytest.mark.parametrize("number", [ARDUPILOT, PX4])
def test_what_is_uploaded_is_on_the_vehicle_and_comes_back(fleet: Fleet, gcs: Caller, number: int) -> None:
    items = plan(number, 5, alt=20.0 + number)
    ack = upload(gcs, number, items)
    assert (ack["type"], ack["mission_type"], ack["target_system"]) == (ACCEPTED, MISSION, 255)
    ours = fleet.run(fleet.vehicle(number).missions.download()).items
    assert [(round(i.x * 1e7), i.z) for i in ours] == [(LAT + 1000 * seq, 20.0 + number) for seq in range(5)]
    back = download(gcs, number)
    home = number == ARDUPILOT
    assert core(back)[home:] == core(items)[home:]
    assert not home or (back[0]["frame"], abs(back[0]["z"] - 584.0) < 1.0) == (GLOBAL, True)  # home is the autopilot's


@pytest.mark.parametrize(
    ("kind", "items"),
    [
        (
            FENCE,
            [{"frame": RELATIVE, "command": 5003, "param1": 80.0, "x": LAT, "y": LON, "z": 0.0, "autocontinue": 1}],
        ),
        (RALLY, [{"frame": RELATIVE, "command": 5100, "x": LAT, "y": LON + 5000, "z": 20.0, "autocontinue": 1}]),
    ],
)
def test_fence_and_rally_points_go_their_own_ways(fleet: Fleet, gcs: Caller, kind: int, items: list[Item]) -> None:
    mission = core(download(gcs, ARDUPILOT))
    assert upload(gcs, ARDUPILOT, items, kind)["mission_type"] == kind
    assert core(download(gcs, ARDUPILOT, kind)) == core(items)
    assert core(download(gcs, ARDUPILOT)) == mission


def test_lost_and_repeated_frames_of_the_client_cost_time_only(fleet: Fleet, gcs: Caller) -> None:
    items = plan(PX4, 4, alt=44.0)
    gcs.to("MISSION_ITEM_INT", PX4, seq=2, **items[2])  # of nothing
    gcs.to("MISSION_COUNT", PX4, count=4)
    gcs.wait(lambda: requests(gcs, PX4) != [], "a request")
    gcs.to("MISSION_COUNT", PX4, count=4)  # it lost the request, and says so again
    gcs.wait(lambda: len(requests(gcs, PX4)) >= 2, "another")
    for seq in (0, 0, 1, 0, 1, 3):
        gcs.to("MISSION_ITEM_INT", PX4, seq=seq, **items[seq])
    gcs.wait(lambda: requests(gcs, PX4)[-2:] == [2, 2], "it asks again for what is missing")
    gcs.to("MISSION_ITEM_INT", PX4, seq=2, **items[2])
    gcs.wait(lambda: requests(gcs, PX4)[-1] == 3, "the last")
    gcs.to("MISSION_ITEM_INT", PX4, seq=3, **items[3])
    gcs.wait(lambda: gcs.fields("MISSION_ACK", PX4) != [], "an ACK")
    assert core(download(gcs, PX4)) == core(items)
    assert [ack["type"] for ack in gcs.fields("MISSION_ACK", PX4)] == [ACCEPTED]


def test_an_upload_that_is_begun_again_is_the_one_that_counts(gcs: Caller) -> None:
    gcs.to("MISSION_COUNT", PX4, count=9)
    gcs.wait(lambda: requests(gcs, PX4) == [0], "a request")
    gcs.to("MISSION_ITEM_INT", PX4, seq=0, **waypoint(0))
    gcs.wait(lambda: requests(gcs, PX4)[-1] == 1, "the next")
    items = plan(PX4, 2, alt=33.0)
    assert upload(gcs, PX4, items)["type"] == ACCEPTED
    assert core(download(gcs, PX4)) == core(items)
    assert len(gcs.fields("MISSION_ACK", PX4)) == 1


def test_an_upload_begun_while_another_is_given_to_the_vehicle_waits_for_its_end(fleet: Fleet, gcs: Caller) -> None:
    """Side by side, either could be the one in force."""
    items = plan(PX4, 3, alt=35.0)
    with late_orders(fleet) as (go, under_way):
        send_whole(gcs, PX4, [waypoint(0)])
        gcs.wait(lambda: under_way != [], "an order")
        send_whole(gcs, PX4, items)
        gcs.wait(lambda: requests(gcs, PX4)[-3:] == [2, 1, 2], "requests to pass the time")
        assert under_way == [1]
        go()
        gcs.wait(lambda: gcs.fields("MISSION_ACK", PX4) != [], "an ACK")
    assert under_way == [1, -1, 1, -1]
    assert core(download(gcs, PX4)) == core(items)
    assert [ack["type"] for ack in gcs.fields("MISSION_ACK", PX4)] == [ACCEPTED]


def test_an_empty_upload_that_is_said_again_is_done_once(fleet: Fleet, gcs: Caller) -> None:
    with late_orders(fleet) as (go, under_way):
        for _ in range(3):
            gcs.to("MISSION_COUNT", PX4, count=0)
        gcs.silent_about("MISSION_ACK", PX4)
        go()
        gcs.wait(lambda: gcs.fields("MISSION_ACK", PX4) != [], "an ACK")
    assert under_way == [1, -1]
    assert [ack["type"] for ack in gcs.fields("MISSION_ACK", PX4)] == [ACCEPTED]


@pytest.mark.parametrize("kind", [MISSION, 255])
def test_a_clearing_waits_for_the_uploads_before_it(fleet: Fleet, gcs: Caller, kind: int) -> None:
    with late_orders(fleet) as (go, under_way):
        send_whole(gcs, PX4, [waypoint(0)])
        gcs.wait(lambda: under_way != [], "an order")
        send_whole(gcs, PX4, plan(PX4, 3, alt=36.0))
        gcs.wait(lambda: requests(gcs, PX4)[-3:] == [2, 1, 2], "requests to pass the time")
        asked = len(requests(gcs, PX4))
        gcs.to("MISSION_CLEAR_ALL", PX4, mission_type=kind)
        gcs.wait(lambda: len(requests(gcs, PX4)) >= asked + 2, "more of them")
        assert under_way == [1]
        go()
        gcs.wait(lambda: len(gcs.fields("MISSION_ACK", PX4)) == 2, "an ACK of the upload, and of the clearing")
    assert [ack["type"] for ack in gcs.fields("MISSION_ACK", PX4)] == [ACCEPTED] * 2
    assert download(gcs, PX4) == []


def test_an_item_asked_for_after_a_download_is_of_the_plan_of_now(fleet: Fleet, gcs: Caller) -> None:
    """A station's ACK at the end of a download may be lost, or never sent; and so may items before the last one, which
    are to be of the same plan.
    """

    def item(seq: int) -> float:
        return float(gcs.answer("MISSION_REQUEST_INT", "MISSION_ITEM_INT", PX4, seq=seq)["z"])

    async def change(alt: float) -> None:
        missions = fleet.vehicle(PX4).missions
        items = (await missions.get()).items
        for each in items:
            each.z = alt
        await missions.upload(items)

    assert upload(gcs, PX4, plan(PX4, 2, alt=21.0))["type"] == ACCEPTED
    assert gcs.answer("MISSION_REQUEST_LIST", "MISSION_COUNT", PX4)["count"] == 2
    assert [item(0), item(1)] == [21.0, 21.0]
    fleet.run(change(22.0))
    assert [item(0), item(1)] == [21.0, 21.0], "lost, and asked for once more"
    gcs.wait(lambda: item(0) == 22.0, "the plan of now")
    assert item(1) == 22.0
    for alt in (23.0, 24.0):
        fleet.run(change(alt))
        assert [item(0), item(1)] == [alt, alt]


def test_items_asked_for_at_once_take_one_question(fleet: Fleet, gcs: Caller) -> None:
    """So many that each for itself would leave no room for other stations."""
    assert upload(gcs, PX4, plan(PX4, 3, alt=26.0))["type"] == ACCEPTED
    with late_orders(fleet, Missions, "get") as (go, under_way):
        for seq in range(300):
            gcs.to("MISSION_REQUEST_INT", PX4, seq=seq)
            gcs.to("MISSION_REQUEST_INT", PX4, seq=seq % 3)
        gcs.wait(lambda: under_way != [], "a question")
        assert upload(gcs, ARDUPILOT, plan(ARDUPILOT, 1))["type"] == ACCEPTED
        go()
        gcs.wait(lambda: len(gcs.fields("MISSION_ITEM_INT", PX4)) >= 3, "all three")
    assert sorted(each["seq"] for each in gcs.fields("MISSION_ITEM_INT", PX4)) == [0, 1, 2]
    assert under_way == [1, -1]


def test_old_stations_get_and_send_floats(fleet: Fleet, gcs: Caller) -> None:
    upload(gcs, PX4, plan(PX4, 2))
    gcs.answer("MISSION_REQUEST_LIST", "MISSION_COUNT", PX4)
    item = gcs.answer("MISSION_REQUEST", "MISSION_ITEM", PX4, seq=1)
    assert item["x"] == pytest.approx((LAT + 1000) / 1e7, abs=1e-5)
    gcs.packer.version = 1
    gcs.to("MISSION_COUNT", PX4, count=1)
    gcs.wait(lambda: gcs.fields("MISSION_REQUEST", PX4) != [], "an old request")
    gcs.to("MISSION_ITEM", PX4, seq=0, **{**waypoint(0), "x": -35.25, "y": 149.25})
    gcs.wait(lambda: len(gcs.fields("MISSION_ACK", PX4)) == 2, "an ACK")
    gcs.packer.version = 2
    assert [(i["x"], i["y"]) for i in download(gcs, PX4)] == [(-352500000, 1492500000)]


def test_a_long_order_keeps_the_client_waiting_by_requests(fleet: Fleet, gcs: Caller) -> None:
    """Of items it has sent: the last two in turn."""
    with late_orders(fleet) as (go, _):
        gcs.to("MISSION_COUNT", PX4, count=3)
        for seq in range(3):
            gcs.wait(lambda: requests(gcs, PX4)[-1:] == [seq], f"a request for {seq}")  # noqa: B023
            gcs.to("MISSION_ITEM_INT", PX4, seq=seq, **waypoint(seq))
        gcs.wait(lambda: len(requests(gcs, PX4)) >= 6, "requests to pass the time")
        assert requests(gcs, PX4)[:6] == [0, 1, 2, 1, 2, 1]
        assert gcs.fields("MISSION_ACK", PX4) == []
        go()
        gcs.wait(lambda: gcs.fields("MISSION_ACK", PX4) != [], "an ACK")
    assert gcs.fields("MISSION_ACK", PX4)[0]["type"] == ACCEPTED


@pytest.mark.parametrize("lost", ["nothing", "a request", "an item", "all that is asked again"])
async def test_a_client_that_went_back_is_at_the_last_item_before_the_ack(lost: str) -> None:
    """MAVSDK counts on from each request that it hears, and takes an ACK before the last item for a fault."""
    item = Raw(RELATIVE, 16, 1, (0.0, 0.0, 0.0, 0.0), LAT, LON, 20.0)
    asked, began = list[int](), asyncio.Event()
    sent = 0

    def hear(name: str, seq: int) -> None:
        nonlocal sent
        asked.append(seq)
        again = asked[4:].count(2)  # after 0, 1, 2, and 1 once more
        if (lost, again) == ("a request", 1) or (lost == "all that is asked again" and len(asked) > 3):
            began.set()
            return
        sent = seq + 1
        if (lost, again) != ("an item", 1):
            loop.call_soon(upload.take, seq, item, False)
        if len(asked) == 4:
            loop.call_soon(began.set)

    loop = asyncio.get_running_loop()
    upload = mission_asked.Upload(hear, 3, as_float=False)
    await upload.collect()
    await upload.keep_waiting(began.wait())
    assert sent == 3
    assert asked == [0, 1, 2, 1, 2] + [2] * (lost in ("a request", "an item"))


def test_a_refusal_is_the_autopilot_s_own_and_the_old_plan_stays(fleet: Fleet, gcs: Caller) -> None:
    good = plan(PX4, 2, alt=25.0)
    assert upload(gcs, PX4, good)["type"] == ACCEPTED
    bad = [*plan(PX4, 1), {**waypoint(1), "command": 31010}]
    assert upload(gcs, PX4, bad)["type"] == UNSUPPORTED
    gcs.wait(lambda: "mission not uploaded: " in gcs.texts() and "in force: the old" in gcs.texts(), "words")
    nowhere = [{**waypoint(0), "x": 2**31 - 5}]
    assert upload(gcs, PX4, nowhere)["type"] == INVALID
    assert core(download(gcs, PX4)) == core(good)


def test_a_lease_in_other_hands_denies_it(fleet: Fleet, gcs: Caller) -> None:
    before = core(download(gcs, PX4))

    async def held() -> dict[str, Any]:
        async with fleet.z.vehicle("v2").lease("planner"):
            return await asyncio.to_thread(upload, gcs, PX4, plan(PX4, 1, alt=99.0))

    assert fleet.run(held())["type"] == DENIED
    gcs.wait(lambda: "mission not uploaded" in gcs.texts() and "planner" in gcs.texts(), "who has it")
    assert core(download(gcs, PX4)) == before


def test_clear_all_clears_all(fleet: Fleet, gcs: Caller) -> None:
    assert upload(gcs, ARDUPILOT, plan(ARDUPILOT, 2))["type"] == ACCEPTED
    assert gcs.answer("MISSION_CLEAR_ALL", "MISSION_ACK", mission_type=255)["type"] == ACCEPTED
    assert [len(download(gcs, ARDUPILOT, kind)[kind == MISSION :]) for kind in (MISSION, FENCE, RALLY)] == [0, 0, 0]
    assert fleet.run(fleet.vehicle(ARDUPILOT).missions.download()).items == []


def test_a_partial_list_is_refused(gcs: Caller) -> None:
    assert gcs.answer("MISSION_WRITE_PARTIAL_LIST", "MISSION_ACK", start_index=1, end_index=2)["type"] == 3


def test_jumps_count_as_the_autopilot_does(fleet: Fleet, gcs: Caller) -> None:
    jump = {
        "frame": MISSION_FRAME,
        "command": 177,
        "param1": 1.0,
        "param2": 2.0,
        "autocontinue": 1,
        "x": 0,
        "y": 0,
        "z": 0,
    }
    assert upload(gcs, ARDUPILOT, [*plan(ARDUPILOT, 3), jump])["type"] == ACCEPTED
    ours = fleet.run(fleet.vehicle(ARDUPILOT).missions.get()).items
    assert (ours[3].command, ours[3].params[:2]) == ("MAV_CMD_DO_JUMP", [0.0, 2.0])
    back = download(gcs, ARDUPILOT)[4]
    assert (back["command"], back["param1"], back["param2"]) == (177, 1.0, 2.0)


def test_the_current_item_is_set_by_an_order(fleet: Fleet, gcs: Caller) -> None:
    assert upload(gcs, ARDUPILOT, plan(ARDUPILOT, 4))["type"] == ACCEPTED
    gcs.to("MISSION_SET_CURRENT", ARDUPILOT, seq=3)

    async def flown() -> wire.Mission:
        while (mission := await fleet.z.vehicle("v1").missions.get()).current != 2:
            await asyncio.sleep(0.05)
        return mission

    assert fleet.run(flown()).current == 2
    assert [item["current"] for item in download(gcs, ARDUPILOT)] == [0, 0, 0, 1, 0]


def test_what_there_is_none_of_is_refused(gcs: Caller) -> None:
    assert gcs.answer("MISSION_REQUEST_LIST", "MISSION_ACK", PX4, mission_type=77)["type"] == UNSUPPORTED
    assert gcs.answer("MISSION_COUNT", "MISSION_ACK", PX4, count=1, mission_type=77)["type"] == UNSUPPORTED
    assert gcs.answer("MISSION_REQUEST_INT", "MISSION_ACK", PX4, seq=60000)["type"] == BAD_SEQUENCE


def test_read_only_downloads_and_changes_nothing(fleet: Fleet, gcs: Caller) -> None:
    items = plan(PX4, 2, alt=31.0)
    assert upload(gcs, PX4, items)["type"] == ACCEPTED
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(fleet.udp)
    viewer = Caller(sock)
    try:
        viewer.beat()
        assert core(download(viewer, PX4)) == core(items)
        assert upload(viewer, PX4, plan(PX4, 1))["type"] == DENIED
        assert viewer.answer("MISSION_CLEAR_ALL", "MISSION_ACK", PX4)["type"] == DENIED
        viewer.wait(lambda: "mission not changed: read-only" in viewer.texts(), "why")
    finally:
        viewer.close()
    assert core(download(gcs, PX4)) == core(items)


def test_an_item_to_fly_to_at_once_passes(fleet: Fleet, gcs: Caller) -> None:
    """ArduPilot's guided waypoint is an order in the shape of an item: the autopilot answers it itself."""
    sent = fleet.bridge.uplink.sent
    ack = gcs.answer("MISSION_ITEM", "MISSION_ACK", **{**waypoint(0), "x": -35.36, "y": 149.16, "current": 2})
    assert fleet.bridge.uplink.sent > sent
    assert ack["target_system"] == 255


def test_two_stations_at_once_do_not_hear_each_other(fleet: Fleet, gcs: Caller) -> None:
    other = fleet.caller(254)
    try:
        other.beat()
        mine, theirs = plan(PX4, 3, alt=41.0), plan(ARDUPILOT, 3, alt=42.0)

        async def both() -> tuple[dict[str, Any], dict[str, Any]]:
            return await asyncio.gather(
                asyncio.to_thread(upload, gcs, PX4, mine), asyncio.to_thread(upload, other, ARDUPILOT, theirs)
            )

        assert [ack["type"] for ack in fleet.run(both())] == [ACCEPTED, ACCEPTED]
        assert core(download(gcs, PX4)) == core(mine)
        assert core(download(other, ARDUPILOT))[1:] == core(theirs)[1:]
        for station, foreign in ((gcs, ARDUPILOT), (other, PX4)):
            heard = [frame for frame in station.frames if "MISSION_" in station.dialect.name_of(frame.msgid)]
            addressed = [decode(frame, gcs.dialect).get("target_system") for frame in heard if frame.sysid == foreign]
            assert [target for target in addressed if target is not None] == []
    finally:
        other.close()
