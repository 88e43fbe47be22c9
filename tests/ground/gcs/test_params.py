"""Parameters through the bridge: lists, questions and sets, answered in the place of an ArduCopter and a PX4."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from ground.gcs import param_copy
from ground.gcs.param_copy import read_value
from tests.ground.gcs.fleet import Caller, Fleet
from tests.waiting import wait_until
from zmav import keys
from zmav.mavlink import Frame, encode
from zmav.mavlink.ftp import Nak, Op, Packet, pack, unpack
from zmav.mavlink.packed_params import PATH
from zmav.mavlink.paramvalue import type_name
from zmav.sim import VehicleSpec

ARDUPILOT, PX4 = 1, 2
REAL32, INT32 = 9, 6


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    specs = [VehicleSpec(), VehicleSpec(autopilot="px4")]
    with Fleet(specs, speed=1.0, udpin="read_only=1", slow="rate=4kB/s") as fleet:
        yield fleet


@pytest.fixture
def gcs(fleet: Fleet) -> Iterator[Caller]:
    yield from station(fleet, 255)


@pytest.fixture
def other(fleet: Fleet) -> Iterator[Caller]:
    yield from station(fleet, 254)


def station(fleet: Fleet, sysid: int) -> Iterator[Caller]:
    caller = fleet.caller(sysid)
    caller.beat()
    yield caller
    caller.close()


def values(caller: Caller, sysid: int) -> dict[str, Any]:
    """What came as PARAM_VALUE, by name, as numbers of their type."""
    found: dict[str, Any] = {}
    for frame in frames(caller, sysid):
        heard = read_value(frame.data)
        bytewise = sysid == PX4 and heard.type == INT32
        found[heard.name] = struct.unpack("<i" if bytewise else "<f", heard.raw)[0]
    return found


def frames(caller: Caller, sysid: int) -> list[Frame]:
    return [frame for frame in caller.named("PARAM_VALUE") if frame.sysid == sysid]


def whole_list(caller: Caller, sysid: int, count: int, **target: int) -> None:
    caller.to("PARAM_REQUEST_LIST", sysid, **target)
    caller.wait(lambda: len(frames(caller, sysid)) >= count, f"{count} parameters of {sysid}")


def test_a_list_is_what_the_vehicle_holds_each_at_its_index_and_once(fleet: Fleet, gcs: Caller) -> None:
    """Target 0 means every vehicle, component 0 every component."""
    gcs.to("PARAM_REQUEST_LIST", 0, target_component=0)
    for number in (ARDUPILOT, PX4):
        held = fleet.params(number)
        gcs.wait(lambda: len(frames(gcs, number)) >= len(held), f"{len(held)} of {number}")  # noqa: B023
        got = [read_value(frame.data) for frame in frames(gcs, number)]
        assert [heard.place for heard in got] == list(range(len(held)))
        assert {heard.of for heard in got} == {len(held)}
        assert values(gcs, number) == pytest.approx(held, rel=1e-6)
        table = fleet.run(fleet.vehicle(number).params.list())
        assert [(heard.name, type_name(heard.type)) for heard in got] == [(p.name, p.type) for p in table.params]
    assert {(frame.sysid, frame.compid) for frame in gcs.named("PARAM_VALUE")} == {(ARDUPILOT, 1), (PX4, 1)}


def test_the_autopilot_and_the_mesh_hear_nothing_of_a_list(fleet: Fleet, gcs: Caller, other: Caller) -> None:
    before, asked = fleet.bridge.uplink.sent, []
    ask = fleet.z.ask

    async def counted(key: str, *args: Any, **more: Any) -> Any:
        asked.append(key)
        return await ask(key, *args, **more)

    fleet.z.ask = counted  # type: ignore[method-assign]
    try:
        for caller in (gcs, other):
            caller.to("PARAM_REQUEST_LIST", PX4)
            caller.to("PARAM_REQUEST_LIST", PX4)  # impatient: it gets them once
        for caller in (gcs, other):
            caller.wait(lambda: len(frames(caller, PX4)) >= len(fleet.params(PX4)), "all of them")  # noqa: B023
            caller.silent_about("PARAM_VALUE", PX4)
    finally:
        fleet.z.ask = ask  # type: ignore[method-assign]
    assert len(frames(gcs, PX4)) == len(frames(other, PX4)) == len(fleet.params(PX4))
    assert asked.count(keys.PARAMS.key("demo", "v2")) <= 2
    assert fleet.bridge.uplink.sent - before <= 4  # HEARTBEATs


def test_read_by_name_and_by_index(fleet: Fleet, gcs: Caller) -> None:
    by_name = gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_id="WPNAV_SPEED", param_index=-1)
    assert (by_name["param_id"], by_name["param_value"]) == ("WPNAV_SPEED", 1000.0)
    index = by_name["param_index"]
    assert gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_index=index) == by_name
    number = gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", PX4, param_id="COM_LOW_BAT_ACT", param_index=-1)
    assert number["param_type"] == INT32
    held = int(fleet.params(PX4)["COM_LOW_BAT_ACT"])
    assert struct.pack("<f", number["param_value"]) == struct.pack("<i", held)


def test_what_there_is_none_of_is_said_to_be_none(gcs: Caller) -> None:
    said = gcs.answer("PARAM_REQUEST_READ", "PARAM_ERROR", param_id="NO_SUCH_THING", param_index=-1)
    assert (said["param_id"], said["error"], said["target_system"]) == ("NO_SUCH_THING", 1, 255)
    said = gcs.answer("PARAM_REQUEST_READ", "PARAM_ERROR", param_index=30000)
    assert (said["param_index"], said["error"]) == (30000, 1)


def test_a_set_is_done_and_both_clients_see_it_once(fleet: Fleet, gcs: Caller, other: Caller) -> None:
    other.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_id="WPNAV_ACCEL", param_index=-1)
    set_it: dict[str, Any] = {"param_id": "WPNAV_ACCEL", "param_value": 222.0, "param_type": REAL32}
    assert gcs.answer("PARAM_SET", "PARAM_VALUE", **set_it)["param_value"] == 222.0
    assert fleet.params(ARDUPILOT)["WPNAV_ACCEL"] == 222.0
    other.wait(lambda: len(frames(other, ARDUPILOT)) > 1, "the news")
    for caller, count in ((gcs, 1), (other, 2)):
        caller.silent_about("PARAM_VALUE")
        assert [read_value(frame.data).name for frame in frames(caller, ARDUPILOT)] == ["WPNAV_ACCEL"] * count
    assert other.fields("PARAM_VALUE")[-1]["param_value"] == 222.0


def test_a_set_by_another_ground_node_is_seen(fleet: Fleet, gcs: Caller) -> None:
    gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", PX4, param_id="MPC_XY_CRUISE", param_index=-1)
    fleet.run(fleet.z.vehicle("v2").params.set("MPC_XY_CRUISE", 6.5))
    gcs.wait(lambda: values(gcs, PX4).get("MPC_XY_CRUISE") == 6.5, "the news")
    read = gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", PX4, param_id="MPC_XY_CRUISE", param_index=-1)
    assert read["param_value"] == 6.5


def test_integers_travel_bytewise_to_a_px4(fleet: Fleet, gcs: Caller) -> None:
    three = struct.unpack("<f", struct.pack("<i", 3))[0]
    done = gcs.answer("PARAM_SET", "PARAM_VALUE", PX4, param_id="COM_LOW_BAT_ACT", param_value=three, param_type=INT32)
    assert struct.pack("<f", done["param_value"]) == struct.pack("<i", 3)
    assert fleet.params(PX4)["COM_LOW_BAT_ACT"] == 3


def test_a_set_refused_is_answered_with_the_old_value_and_the_reason(fleet: Fleet, gcs: Caller) -> None:
    before = fleet.params(ARDUPILOT)["FRAME_CLASS"]
    for value, why in ((1.5, "takes integers"), (float("nan"), "not a number")):
        said = gcs.answer("PARAM_SET", "PARAM_VALUE", param_id="FRAME_CLASS", param_value=value, param_type=REAL32)
        assert (said["param_id"], said["param_value"]) == ("FRAME_CLASS", before)
        assert fleet.params(ARDUPILOT)["FRAME_CLASS"] == before
        gcs.wait(lambda: why in gcs.texts(), why)  # noqa: B023
    assert "FRAME_CLASS not set" in gcs.texts()
    gcs.answer("PARAM_SET", "PARAM_ERROR", param_id="NO_SUCH_THING", param_value=1.0, param_type=REAL32)


def test_read_only_answers_questions_and_sets_nothing(fleet: Fleet) -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(fleet.udp)
    viewer = Caller(sock, 253)
    try:
        viewer.beat()
        whole_list(viewer, PX4, len(fleet.params(PX4)))
        before = viewer.answer("PARAM_REQUEST_READ", "PARAM_VALUE", PX4, param_id="MIS_TAKEOFF_ALT", param_index=-1)
        said = viewer.answer(
            "PARAM_SET", "PARAM_VALUE", PX4, param_id="MIS_TAKEOFF_ALT", param_value=7.0, param_type=REAL32
        )
        assert said == before
        viewer.wait(lambda: "MIS_TAKEOFF_ALT not set: read-only" in viewer.texts(), "the reason")
        assert fleet.params(PX4)["MIS_TAKEOFF_ALT"] != 7.0
    finally:
        viewer.close()


def test_the_vehicle_s_own_flood_reaches_nobody(fleet: Fleet, gcs: Caller) -> None:
    gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_id="WPNAV_SPEED", param_index=-1)
    withheld = fleet.bridge.downlink.counters.withheld
    fleet.run(fleet.vehicle(ARDUPILOT).params.refresh())
    gcs.wait(lambda: fleet.bridge.downlink.counters.withheld > withheld + 1000, "a flood")
    gcs.silent_about("PARAM_VALUE", ARDUPILOT)


def test_what_a_vehicle_hears_of_another_is_not_taken_for_its_own(fleet: Fleet, gcs: Caller) -> None:
    """Both radios hear both autopilots: the other's parameters come over this vehicle's agent, too."""
    about: dict[str, Any] = {"param_id": "WPNAV_SPEED", "param_index": -1}
    before = gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", **about)["param_value"]
    withheld = fleet.bridge.downlink.counters.withheld
    fields = {"param_id": "WPNAV_SPEED", "param_value": before + 1.0, "param_type": REAL32, "param_count": 1}
    other = encode(fleet.z.dialect, "PARAM_VALUE", {**fields, "param_index": 0xFFFF}, sysid=PX4, compid=1, seq=0)
    fleet.z.session.put(keys.RX.key("demo", "v1", sys=PX4, comp=1, msg="PARAM_VALUE"), other)
    gcs.wait(lambda: fleet.bridge.downlink.counters.withheld > withheld, "the other's parameter")
    gcs.silent_about("PARAM_VALUE", ARDUPILOT)
    assert gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", **about)["param_value"] == before


def test_a_set_that_is_still_being_read_comes_as_it_is_read(
    fleet: Fleet, gcs: Caller, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The autopilot has restarted: its agent reads it again, and the client need not wait for the end of that."""
    monkeypatch.setattr(param_copy, "FRESH", 0.0)
    known, count = fleet.programs[0].params.known, len(fleet.params(ARDUPILOT))

    async def restarted() -> bool:
        known.doubt()
        await fleet.loop.run_in_executor(None, gcs.to, "PARAM_REQUEST_LIST", ARDUPILOT)
        while not frames(gcs, ARDUPILOT):
            await asyncio.sleep(0.001)
        return known.complete

    assert not fleet.run(restarted())
    gcs.wait(lambda: len(frames(gcs, ARDUPILOT)) >= count, "all of them")
    gcs.silent_about("PARAM_VALUE", ARDUPILOT)
    assert sorted(read_value(frame.data).place for frame in frames(gcs, ARDUPILOT)) == list(range(count))


def test_a_list_over_a_narrow_link_lets_answers_through(fleet: Fleet) -> None:
    radio = fleet.caller(250, slow=True)
    try:
        radio.beat()
        radio.to("PARAM_REQUEST_LIST", ARDUPILOT)
        radio.wait(lambda: len(frames(radio, ARDUPILOT)) > 30, "the list")
        radio.answer("MISSION_REQUEST_LIST", "MISSION_COUNT", ARDUPILOT)
        assert len(frames(radio, ARDUPILOT)) < 300
    finally:
        radio.close()


def test_the_parameter_file_is_denied_so_that_the_list_is_asked_for(fleet: Fleet, gcs: Caller) -> None:
    """QGroundControl asks for it first; the autopilot hears nothing of it."""
    gcs.silent_about("_NOTHING")  # the heartbeat before it has gone to the vehicles
    sent = fleet.bridge.uplink.sent
    denied = ftp(gcs, Packet(10, 3, Op.OPEN_FILE_RO, len(PATH), data=PATH.encode()))
    assert (denied.opcode, denied.req_opcode, denied.nak) == (Op.NAK, Op.OPEN_FILE_RO, Nak.FILE_NOT_FOUND)
    assert fleet.bridge.uplink.sent == sent


def test_other_files_are_between_the_client_and_the_autopilot(fleet: Fleet, gcs: Caller) -> None:
    gcs.silent_about("_NOTHING")  # the heartbeat before it has gone to the vehicles
    sent = fleet.bridge.uplink.sent
    assert ftp(gcs, Packet(5, 0, Op.LIST_DIRECTORY, 1, data=b"/")).opcode == Op.ACK
    assert ftp(gcs, Packet(6, 0, Op.OPEN_FILE_RO, 12, data=b"/no/such/one")).nak is not None
    # The answer may be here before what was sent is counted.
    wait_until(lambda: fleet.bridge.uplink.sent == sent + 2, "two frames for the vehicle")


@pytest.mark.parametrize(
    ("op", "names"),
    [
        (Op.CREATE_FILE, "@PARAM/param.pck"),
        (Op.OPEN_FILE_WO, "/@MISSION/mission.dat"),
        (Op.REMOVE_FILE, "@MISSION/fence.dat"),
        (Op.RENAME, "/APM/plan\0@MISSION/rally.dat"),
    ],
    ids=["parameters", "a plan", "removed", "renamed"],
)
def test_nobody_writes_a_plan_or_parameters_as_a_file(fleet: Fleet, gcs: Caller, op: Op, names: str) -> None:
    """Nobody would have judged where it leads, or whether its writer may: the messages for it become orders."""
    gcs.silent_about("_NOTHING")  # the heartbeat before it has gone to the vehicles
    sent = fleet.bridge.uplink.sent
    denied = ftp(gcs, Packet(20, 0, op, len(names), data=names.encode()))
    assert (denied.opcode, denied.req_opcode, denied.nak) == (Op.NAK, op, Nak.FILE_PROTECTED)
    gcs.wait(lambda: "mission_upload writes plans" in gcs.texts(), "what to do instead")
    assert fleet.bridge.uplink.sent == sent


def ftp(caller: Caller, packet: Packet) -> Packet:
    answer = caller.answer("FILE_TRANSFER_PROTOCOL", "FILE_TRANSFER_PROTOCOL", ARDUPILOT, payload=pack(packet))
    assert (answer["target_system"], unpack(answer["payload"]).seq) == (255, packet.seq + 1)
    return unpack(answer["payload"])


def test_hostile_names_and_indices_harm_nothing(gcs: Caller) -> None:
    for name in ("", "A*/B", "\x7f\x01", "x" * 16, "?" * 16):
        gcs.to("PARAM_REQUEST_READ", param_id=name, param_index=-1)
        gcs.to("PARAM_SET", param_id=name, param_value=1.0, param_type=77)
    gcs.to("PARAM_REQUEST_READ", param_index=-32768, param_id="$*")
    assert (
        gcs.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_id="WPNAV_SPEED", param_index=-1)["param_value"] == 1000.0
    )


def test_a_flood_of_questions_is_bounded_and_others_are_answered(gcs: Caller, other: Caller) -> None:
    question = gcs.packer.pack("PARAM_REQUEST_READ", target_system=1, target_component=1, param_index=5)
    gcs.sock.sendall(question * 20_000)
    assert other.answer("PARAM_REQUEST_READ", "PARAM_VALUE", param_index=7)["param_index"] == 7
    gcs.wait(lambda: len(frames(gcs, ARDUPILOT)) > 100, "some answers")
