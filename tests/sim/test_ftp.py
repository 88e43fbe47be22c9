"""The simulator's file server: pymavlink's own client, ArduPilot's rules, and bounds."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink import mavftp, mavutil

from tests.packed_params import unpack_params
from zmav.mavlink import plan_file
from zmav.mavlink.ftp import MOST_DATA, DirectoryEntry, Nak, Op, Packet, crc32, pack, unpack, unpack_entries
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params
from zmav.sim import World
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.items import Item
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.storage import Storage
from zmav.sim.protocol.filesystem import MOST, FileError, FileSystem

if TYPE_CHECKING:
    from pathlib import Path

    from tests.sim.conftest import Gcs


class Client:
    """Sends single packets at a ground station, and reads what they bring."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs = gcs
        self.seq = 0

    def send(self, op: int, data: bytes = b"", *, session: int = 5, seq: int | None = None, **more: Any) -> None:
        self.seq = self.seq + 2 if seq is None else seq
        packet = Packet(self.seq, session, op, **{"size": len(data), **more}, data=data)
        self.gcs.clear("FILE_TRANSFER_PROTOCOL")
        self.gcs.send("FILE_TRANSFER_PROTOCOL", payload=pack(packet))

    @property
    def answers(self) -> list[Packet]:
        return [unpack(m["payload"]) for m in self.gcs.all("FILE_TRANSFER_PROTOCOL")]

    def ask(self, op: int, data: bytes = b"", **more: Any) -> Packet:
        self.send(op, data, **more)
        (answer,) = self.answers
        assert answer.seq == (self.seq + 1) & 0xFFFF
        assert answer.req_opcode == op
        return answer


@pytest.fixture
def client(gcs: Gcs) -> Client:
    return Client(gcs)


def storage(gcs: Gcs) -> Storage:
    node = gcs.vehicle.node
    assert isinstance(node, MavNode)
    return node.storage


def test_pymavlinks_client_lists_reads_writes_and_checks(tmp_path: Path) -> None:
    with World(copters=1, endpoint="tcp:0", ready_s=0.5) as world:
        link = mavutil.mavlink_connection(world.urls[0], source_system=250)
        link.wait_heartbeat(timeout=30)
        client = mavftp.MAVFTP(link, target_system=1, target_component=1)

        def run(operation: str, *arguments: str) -> Any:
            result = getattr(client, f"cmd_{operation}")(list(arguments))
            if operation in ("get", "put", "getparams"):
                result = client.process_ftp_reply(operation, timeout=20)
            assert result.error_code == 0, (operation, result.error_code)
            return result

        local, back = tmp_path / "local.bin", tmp_path / "back.bin"
        local.write_bytes(bytes(range(256)) * 40)
        run("mkdir", "/APM/new")
        run("put", str(local), "/APM/new/a.bin")
        assert [(e.name, e.size_b) for e in run("list", "/APM/new").directory_listing] == [("a.bin", 10_240)]
        run("get", "/APM/new/a.bin", str(back))
        assert back.read_bytes() == local.read_bytes()
        run("getparams", str(tmp_path / "p.param"))
        lines = (tmp_path / "p.param").read_text().splitlines()
        assert len([line for line in lines if not line.startswith("#")]) == len(world.vehicles[0].copter.params)
        link.close()


def test_a_repeated_request_gets_its_answer_again_and_is_done_once(client: Client) -> None:
    assert client.ask(Op.CREATE_DIRECTORY, b"/APM/x").opcode == Op.ACK
    assert client.ask(Op.CREATE_DIRECTORY, b"/APM/x", seq=client.seq).opcode == Op.ACK
    assert client.ask(Op.CREATE_DIRECTORY, b"/APM/x").nak is Nak.FILE_EXISTS


def test_one_session_which_others_get_after_three_idle_seconds(client: Client) -> None:
    assert client.ask(Op.CREATE_FILE, b"/APM/x", session=5).session == 5
    assert client.ask(Op.LIST_DIRECTORY, b"/", session=6).nak is Nak.INVALID_SESSION
    assert client.ask(Op.RESET_SESSIONS, session=6).opcode == Op.ACK
    assert client.ask(Op.WRITE_FILE, b"abc", session=5).opcode == Op.ACK
    assert client.ask(Op.CREATE_FILE, b"/APM/y", session=5).nak is Nak.FAIL
    client.gcs.world.step(3.1)
    assert client.ask(Op.LIST_DIRECTORY, b"/", session=6).opcode == Op.ACK
    assert client.ask(Op.WRITE_FILE, b"abc", session=5).nak is Nak.FILE_NOT_FOUND


def test_a_burst_is_500_packets_and_ends_with_the_file(client: Client) -> None:
    size = MOST_DATA * 501 + 10
    storage(client.gcs).files.create("/APM/f")
    storage(client.gcs).files.write("/APM/f", 0, bytes(size))
    assert int.from_bytes(client.ask(Op.OPEN_FILE_RO, b"/APM/f").data, "little") == size
    client.send(Op.BURST_READ_FILE, size=MOST_DATA)
    client.gcs.world.step()
    assert client.gcs.vehicle.node.next_due <= client.gcs.world.time_s  # the next tick goes on, and comes on time
    client.gcs.world.step(1.0)
    packets = client.answers
    assert len(packets) == 500
    assert [p.offset for p in packets] == list(range(0, 500 * MOST_DATA, MOST_DATA))
    assert [p.seq for p in packets] == list(range(client.seq + 1, client.seq + 501))
    assert [p.burst_complete for p in packets] == [False] * 499 + [True]
    client.send(Op.BURST_READ_FILE, size=MOST_DATA, offset=500 * MOST_DATA, seq=2000)
    client.gcs.world.step(0.1)
    full, short, end = client.answers
    assert (len(full.data), full.burst_complete) == (MOST_DATA, False)
    assert (len(short.data), short.burst_complete) == (10, True)
    assert (end.nak, end.offset) == (Nak.EOF, size)


@pytest.mark.parametrize(
    ("op", "data", "more", "nak"),
    [
        (Op.READ_FILE, b"", {"size": 10}, Nak.FILE_NOT_FOUND),
        (Op.BURST_READ_FILE, b"", {"size": 10}, Nak.FILE_NOT_FOUND),
        (Op.WRITE_FILE, b"x", {}, Nak.FILE_NOT_FOUND),
        (Op.LIST_DIRECTORY, b"", {}, Nak.INVALID_DATA_SIZE),
        (Op.LIST_DIRECTORY, b"/", {"size": 9}, Nak.INVALID_DATA_SIZE),
        (Op.LIST_DIRECTORY, b"/../..", {}, Nak.FILE_NOT_FOUND),
        (Op.LIST_DIRECTORY, b"/APM/terrain", {}, Nak.EOF),
        (Op.LIST_DIRECTORY, b"/", {"offset": 1 << 31}, Nak.EOF),
        (Op.OPEN_FILE_RO, b"/APM", {}, Nak.FILE_NOT_FOUND),
        (Op.OPEN_FILE_RO, b"\xff\xfe", {}, Nak.FILE_NOT_FOUND),
        (Op.OPEN_FILE_RO, b"@MISSION/other.dat", {}, Nak.FILE_NOT_FOUND),
        (Op.CREATE_FILE, b"/nowhere/x", {}, Nak.FILE_NOT_FOUND),
        (Op.CREATE_FILE, b"/APM", {}, Nak.FILE_PROTECTED),
        (Op.CREATE_FILE, b"/APM/LOGS/x", {}, Nak.FILE_PROTECTED),
        (Op.REMOVE_FILE, b"/APM", {}, Nak.FAIL_ERRNO),
        (Op.REMOVE_DIRECTORY, b"/APM", {}, Nak.FAIL_ERRNO),
        (Op.RENAME, b"/APM/x", {}, Nak.INVALID_DATA_SIZE),
        (Op.TRUNCATE_FILE, b"/APM/x", {}, Nak.FAIL),
        (Op.CALC_FILE_CRC32, b"@PARAM/param.pck", {}, Nak.FAIL),
        (77, b"", {}, Nak.FAIL),
        (Op.NONE, b"", {"size": 255}, Nak.INVALID_DATA_SIZE),
    ],
)
def test_what_cannot_be_done_is_refused(client: Client, op: int, data: bytes, more: dict[str, int], nak: Nak) -> None:
    assert client.ask(op, data, **more).nak is nak
    assert client.ask(Op.NONE).opcode == Op.ACK


def test_generated_files_are_read_in_steps_of_one_size(client: Client) -> None:
    client.ask(Op.OPEN_FILE_RO, PATH.encode())
    assert len(client.ask(Op.READ_FILE, size=100).data) == 100
    assert client.ask(Op.READ_FILE, size=50, offset=100).errno == 22
    client.ask(Op.TERMINATE_SESSION)
    client.ask(Op.OPEN_FILE_RO, f"{PATH}?start=3&count=2".encode())
    found = unpack_params(client.ask(Op.READ_FILE, size=MOST_DATA).data)
    assert [p.name for p in found] == client.gcs.vehicle.copter.params.names[3:5]
    client.ask(Op.TERMINATE_SESSION)
    client.ask(Op.OPEN_FILE_RO, f"{PATH}?start=x".encode())
    assert client.ask(Op.READ_FILE, size=MOST_DATA).errno == 22


def test_no_value_of_a_packed_parameter_lies_across_two_reads() -> None:
    rows = [PackedParam(f"P{i:03d}_{'x' * (i % 7)}", i * 1.5, 9) for i in range(300)]
    data = pack_params(rows, read_size=50)
    assert unpack_params(data) == rows
    for row in rows:
        at = data.index(row.name[-1:].encode() + struct.pack("<f", row.value)) + 1
        assert at // 50 == (at + 3) // 50, row


def test_the_card_is_full_one_day() -> None:
    files = FileSystem("/a")
    files.create("/a/f")
    with pytest.raises(FileError) as caught:
        files.write("/a/f", MOST, b"x")
    assert caught.value.number == 28
    with pytest.raises(FileError):
        for i in range(3_000):
            files.create(f"/a/{i}")
    assert files.list("/") == [DirectoryEntry("a", None)]


def test_directories_fill_it_too() -> None:
    files = FileSystem("/a")
    with pytest.raises(FileError) as caught:
        for i in range(3_000):
            files.mkdir(f"/a/d{i}")
    assert caught.value.number == 28


def test_the_checksum_is_the_protocols() -> None:
    table = []
    for n in range(256):  # as published: the reflected polynomial, begun with 0, not inverted
        c = n
        for _ in range(8):
            c = c >> 1 ^ 0xEDB88320 if c & 1 else c >> 1
        table.append(c)
    crc = 0
    for byte in b"123456789":
        crc = table[(crc ^ byte) & 0xFF] ^ crc >> 8
    assert crc32(b"123456789") == crc
    assert crc32(b"6789", crc32(b"12345")) == crc


def test_a_packet_there_and_back() -> None:
    packet = Packet(0xFFFE, 1, Op.ACK, 3, Op.READ_FILE, True, 1 << 31, b"a\0b")
    assert unpack(pack(packet)) == packet
    assert unpack(pack(packet).rstrip(b"\0")) == packet
    assert unpack(b"") == Packet(0, 0, 0)
    assert unpack_entries(b"Da\0Fb\t12\0S\0Fc\0\0X\0") == [
        DirectoryEntry("a", None),
        DirectoryEntry("b", 12),
        None,
        DirectoryEntry("c", 0),
        None,
    ]


def test_plans_are_files_as_pymavlink_reads_them(client: Client) -> None:
    """Header and items as MAVProxy takes them apart, each item as it is when it is read."""
    gcs, copter = client.gcs, client.gcs.vehicle.copter
    places = [Item(command=16, frame=3, x=-353632610 + n, y=1491652300, z=20.0 + n, p1=1.0) for n in range(30)]
    for item in places:
        copter.mission.add(item)
    copter.rally.items = (Item(command=5100, frame=3, x=-353632610, y=1491652300, z=40.0, autocontinue=1),)
    layout = mavutil.mavlink.MAVLink_mission_item_int_message.unpacker
    for kind, number, count in (("mission", 0, 31), ("fence", 1, 0), ("rally", 2, 1)):
        opened = client.ask(Op.OPEN_FILE_RO, f"@MISSION/{kind}.dat".encode())
        assert int.from_bytes(opened.data, "little") == 1 << 20  # it is not read for that
        data = b""
        while (answer := client.ask(Op.READ_FILE, size=100, offset=len(data))).nak is None:
            data += answer.data
        assert answer.nak is Nak.EOF
        assert client.ask(Op.TERMINATE_SESSION).opcode == Op.ACK
        assert struct.unpack_from("<5H", data) == (0x763D, number, 0, 0, count)
        assert len(data) == 10 + count * layout.size
        rows = [layout.unpack_from(data, 10 + n * layout.size) for n in range(count)]
        gcs.clear("MISSION_ITEM_INT")
        for seq in range(count):
            gcs.send("MISSION_REQUEST_INT", seq=seq, mission_type=number)
        items = gcs.all("MISSION_ITEM_INT")
        names = ("param1", "param2", "param3", "param4", "x", "y", "z", "seq", "command")
        assert [row[:9] for row in rows] == [tuple(item[name] for name in names) for item in items]
        more = ("frame", "current", "autocontinue", "mission_type")
        assert [row[9:] for row in rows] == [(0, 0, *(item[name] for name in more)) for item in items]


def test_a_plan_that_changes_while_it_is_read_is_read_as_it_then_is(client: Client) -> None:
    mission = client.gcs.vehicle.copter.mission
    for n in range(20):
        mission.add(Item(command=16, x=1 + n, y=1, z=10.0))
    client.ask(Op.OPEN_FILE_RO, b"@MISSION/mission.dat")
    first = client.ask(Op.READ_FILE, size=MOST_DATA)
    assert struct.unpack_from("<5H", first.data)[4] == 21
    mission.open(12)
    rest = client.ask(Op.READ_FILE, size=MOST_DATA, offset=MOST_DATA)
    assert MOST_DATA + len(rest.data) == 10 + 12 * 38
    assert client.ask(Op.READ_FILE, size=MOST_DATA, offset=10 + 12 * 38).nak is Nak.EOF


def plan_of(gcs: Gcs, kind: int, *items: dict[str, Any], **header: int) -> bytes:
    head = {"magic": 0x763D, "kind": kind, "options": 0, "start": 0, "count": len(items), **header}
    packed = (plan_file.pack_item({"seq": n, "frame": 3, **item}, gcs.dialect) for n, item in enumerate(items))
    return struct.pack("<5H", *head.values()) + b"".join(packed)


def waypoint(z: float, **more: Any) -> dict[str, Any]:
    return {"command": 16, "autocontinue": 1, "x": -353632610, "y": 1491652300, "z": z, **more}


def put(client: Client, kind: str, data: bytes) -> None:
    """Written, closed, and acknowledged whatever became of it."""
    assert client.ask(Op.CREATE_FILE, f"@MISSION/{kind}.dat".encode()).opcode == Op.ACK
    for at in range(0, len(data), MOST_DATA):
        assert client.ask(Op.WRITE_FILE, data[at : at + MOST_DATA], offset=at).opcode == Op.ACK
    assert client.ask(Op.READ_FILE, size=10).nak is Nak.FAIL
    assert client.ask(Op.CREATE_FILE, f"@MISSION/{kind}.dat".encode()).nak is Nak.FAIL  # one at a time
    assert client.ask(Op.TERMINATE_SESSION).opcode == Op.ACK


def altitudes(gcs: Gcs) -> list[float]:
    mission = gcs.vehicle.copter.mission
    return [item.z for seq in range(1, len(mission)) if isinstance(item := mission.read(seq), Item)]


@pytest.mark.parametrize(
    ("change", "left"),
    [
        ({}, [30.0, 31.0, 32.0]),
        ({"magic": 0x671B}, [10.0, 11.0]),
        ({"count": 3}, [10.0, 11.0]),  # fewer than are there
        ({"count": 5}, [10.0, 11.0]),
        ({"options": 1}, [30.0, 31.0, 32.0]),
        ({"options": 1, "start": 2}, [10.0, 0.0, 30.0, 31.0, 32.0]),  # whose first is no home there
        ({"options": 1, "start": 9}, [10.0, 11.0]),
    ],
)
def test_a_mission_is_written_as_a_file(client: Client, change: dict[str, int], left: list[float]) -> None:
    gcs = client.gcs
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), waypoint(10.0), waypoint(11.0)))
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), *(waypoint(z) for z in (30.0, 31.0, 32.0)), **change))
    assert altitudes(gcs) == left


@pytest.mark.parametrize(
    ("third", "left"),
    [
        ({"command": 999}, [30.0]),  # it was cleared before that was seen, and nobody is told
        ({"command": 177, "param1": 4.0}, [30.0]),
        ({"command": 0, "seq": 0, "frame": 0, "autocontinue": 0, "x": 0, "y": 0, "z": 0.0}, [10.0, 11.0]),
    ],
)
def test_a_bad_item_of_a_file_leaves_half_a_mission(client: Client, third: dict[str, Any], left: list[float]) -> None:
    """What is nothing but zeros was never written: then all of it is refused."""
    gcs = client.gcs
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), waypoint(10.0), waypoint(11.0)))
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), waypoint(30.0), {**waypoint(31.0), **third}, waypoint(32.0)))
    assert altitudes(gcs) == left
    assert not gcs.all("MISSION_ACK")


def test_a_mission_that_is_flown_keeps_its_end(client: Client) -> None:
    """A file cannot clear it, so the rest of the old one stays behind a shorter one."""
    gcs = client.gcs
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), *(waypoint(10.0 + n) for n in range(5))))
    gcs.put_up()
    assert gcs.command(176, 1, 3) == 0
    gcs.until(lambda: gcs.vehicle.copter.mission.state is State.RUNNING)
    put(client, "mission", plan_of(gcs, 0, waypoint(0.0), waypoint(30.0)))
    assert altitudes(gcs) == [30.0, 11.0, 12.0, 13.0, 14.0]


def test_fences_and_rally_points_are_written_as_files(client: Client) -> None:
    copter = client.gcs.vehicle.copter
    circle, point = waypoint(0.0, command=5003, param1=90.0), waypoint(20.0, command=5100)
    put(client, "fence", plan_of(client.gcs, 1, circle))
    put(client, "rally", plan_of(client.gcs, 2, point, point))
    assert (len(copter.fence.items), len(copter.rally)) == (1, 2)
    put(client, "fence", plan_of(client.gcs, 1, circle, waypoint(0.0)))
    put(client, "fence", plan_of(client.gcs, 1, circle, circle, options=1))
    put(client, "rally", plan_of(client.gcs, 2, point, options=1))
    assert (len(copter.fence.items), len(copter.rally)) == (1, 2)
    put(client, "rally", plan_of(client.gcs, 2, point, waypoint(0.0), point))
    assert len(copter.rally) == 1  # what stood before the bad one


def test_a_file_that_nobody_closes_is_closed_for_the_next(client: Client) -> None:
    gcs = client.gcs
    data = plan_of(gcs, 0, waypoint(0.0), waypoint(30.0))
    assert client.ask(Op.CREATE_FILE, b"@MISSION/mission.dat", session=5).opcode == Op.ACK
    assert client.ask(Op.WRITE_FILE, data, session=5).opcode == Op.ACK
    gcs.world.step(3.1)
    assert client.ask(Op.LIST_DIRECTORY, b"/", session=6).opcode == Op.ACK
    assert altitudes(gcs) == [30.0]
