"""ArduPilot's plans are read as files, by MAVFTP, where it has them; and as the mission protocol does where not."""

from __future__ import annotations

import asyncio
import functools
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.services.conftest import PATIENCE_S, Bench, StartBench, Told
from tests.services.missions.mission_peer import (
    ACCEPTED,
    ERROR,
    FENCE,
    FENCE_ITEMS,
    INVALID,
    MISSION,
    QUICK,
    RALLY,
    RALLY_ITEMS,
    MissionPeer,
    plan,
    raw,
    waypoints,
)
from zmav import wire
from zmav.errors import Refused
from zmav.mavlink import load_dialect, plan_file
from zmav.mavlink.ftp import Nak, Op, Packet, pack, unpack
from zmav.services.missions.by_file import PlanFile
from zmav.services.missions.items import MOST
from zmav.services.missions.transfer import TransferTimes
from zmav.sim.protocol.channel import Channel
from zmav.sim.protocol.filesystem import FileSystem
from zmav.sim.protocol.ftp import FtpServer

HAS_FILES = 0x20
KINDS = {"mission": MISSION, "fence": FENCE, "rally": RALLY}
OLD, NEW = raw(waypoints(4, alt=90.0)), waypoints(10)
ONCE = TransferTimes(reply=9.0, shortest=9.0, longest=9.0)
"""nothing is repeated, however late its answer comes"""


class Outlet:
    """A link of the simulator that leads to the peer's."""

    def __init__(self, out: Callable[[bytes], None]) -> None:
        self.out = out

    def room(self) -> int:
        return 1 << 20

    def put(self, frame: bytes) -> None:
        self.out(frame)


class Plan:
    """The file of one of the peer's plans (a ``Readable``): its items as they are when each is read."""

    def __init__(self, peer: FilingPeer, kind: int, query: str, read_size: int) -> None:
        self._peer, self._kind, self._count = peer, kind, len(peer.plans[kind])

    def __getitem__(self, part: slice) -> bytes:
        self._peer.on_read(part.start)
        items = [{**item, "seq": seq} for seq, item in enumerate(self._peer.plans[self._kind])]
        packed = (plan_file.pack_item({**item, "mission_type": self._kind}, self._peer.dialect) for item in items)
        whole = plan_file.pack_header(self._kind, self._count) + b"".join(packed)
        return self._peer.changes_file(whole)[part]


class FilingPeer(MissionPeer):
    """A :class:`MissionPeer` with the simulated ArduPilot's file server, and its plans among the files."""

    def __init__(self, *, kinds: tuple[str, ...] = tuple(KINDS), capabilities: int = HAS_FILES, **more: Any) -> None:
        super().__init__(**more)
        self.capabilities = capabilities
        files = FileSystem("/APM")
        for kind in kinds:
            number = KINDS[kind]
            files.generate(plan_file.PATH.format(kind), functools.partial(Plan, self, number), lambda: 1 << 20)
        self.ftp = FtpServer(files)
        self.outlet = Outlet(self.raw)
        self.channel = Channel(self.dialect, self.outlet, self.packer.sysid, 1, now=0.0)
        self.on_read: Callable[[int], None] = lambda offset: None
        self.changes_file: Callable[[bytes], bytes] = lambda whole: whole

    def on_file_transfer_protocol(self, told: Told) -> None:
        self.ftp.answers()["FILE_TRANSFER_PROTOCOL"](self.channel, told.fields, told.source)
        self.ftp.tick(told.at)

    def asked(self, op: Op) -> int:
        """How often it was asked for that, repetitions aside."""
        packets = [unpack(each.fields["payload"]) for each in self.heard("FILE_TRANSFER_PROTOCOL")]
        return len({packet.seq for packet in packets if packet.opcode == op})


StartFiling = Callable[..., Awaitable[tuple[Bench, FilingPeer]]]


@pytest.fixture
async def filing(bench: StartBench) -> AsyncIterator[StartFiling]:
    peers: list[FilingPeer] = []

    async def start(pace: TransferTimes = QUICK, **more: Any) -> tuple[Bench, FilingPeer]:
        peer = FilingPeer(**more)
        await peer.open()
        peers.append(peer)
        b = await (await bench(peer)).connected()
        b.vehicle.missions.pace = pace
        return b, peer

    yield start
    for peer in peers:
        await peer.close()


# What it reads.


@pytest.mark.parametrize(
    ("kind", "items"), [("mission", waypoints(100)), ("mission", []), ("rally", RALLY_ITEMS * 9), ("rally", [])]
)
async def test_both_readings_of_an_upload_are_of_the_file(
    filing: StartFiling, kind: str, items: list[dict[str, Any]]
) -> None:
    b, peer = await filing()
    peer.load(KINDS[kind], [{**OLD[0], "command": 5100 if kind == "rally" else 16}])
    outcome = await b.ground.do("mission_upload", kind=kind, items=items)
    assert (outcome.result["count"], outcome.result["known_by"]) == (len(items), "read back")
    assert (await b.ground.do("mission_download", kind=kind)).result["count"] == len(items)
    got = (await plan(b, kind)).items
    assert [(i.command, i.z) for i in got] == [(i["command"], i.get("z", 0.0)) for i in items]
    assert [(i.x, i.y) for i in got] == [pytest.approx((i["x"], i["y"])) for i in items]
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (0, 3)
    assert peer.ftp.open_path is None


async def test_a_fence_is_read_item_by_item(filing: StartFiling) -> None:
    """ArduPilot's file server reads a fence's index while the main loop may be making it."""
    b, peer = await filing()
    await b.ground.do("mission_upload", kind="fence", items=FENCE_ITEMS)
    assert [i.command for i in (await plan(b, "fence")).items] == [i["command"] for i in FENCE_ITEMS]
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (len(FENCE_ITEMS), 0)


async def test_a_jump_and_home_are_counted_as_ever(filing: StartFiling) -> None:
    b, peer = await filing()
    jump = {"command": "MAV_CMD_DO_JUMP", "frame": "MAV_FRAME_MISSION", "params": [1, 3]}
    await b.ground.do("mission_upload", items=[*waypoints(2), jump])
    assert peer.plans[MISSION][3]["param1"] == 2.0  # as ArduPilot counts
    there = await plan(b)
    assert (there.items[2].params[0], there.home) == (1.0, (-35.363261, 149.16523, 584.0))
    assert peer.by_item == 0


async def test_what_is_kept_otherwise_is_found_in_the_file(filing: StartFiling) -> None:
    b, peer = await filing()
    peer.load(MISSION, OLD)
    peer.changes = lambda seq, item: {**item, "x": item["x"] + 5} if seq == 3 and item["z"] < 60 else item
    with pytest.raises(Refused, match="but keeps it otherwise: item 2: place: sent"):
        await b.ground.do("mission_upload", items=NEW)
    assert (peer.stored(), peer.by_item) == (OLD, 0)


async def test_what_a_ground_station_put_there_between_is_what_a_refusal_goes_back_to(filing: StartFiling) -> None:
    b, peer = await filing()
    await b.ground.do("mission_upload", items=waypoints(4))
    peer.load(MISSION, OLD)  # as many items, and not a word of it on this link
    peer.refuses = {8: INVALID}
    with pytest.raises(Refused, match=r"refused item 7 .*in force: the old mission \(4 items\), restored"):
        await b.ground.do("mission_upload", items=NEW)
    assert (peer.stored(), peer.by_item) == (OLD, 0)


async def test_progress_is_told_by_items(filing: StartFiling) -> None:
    b, peer = await filing()
    peer.load(MISSION, raw(waypoints(99)))
    told: list[dict[str, Any]] = []
    await b.vehicle.missions.download(wire.MissionRefresh(kind="mission"), told.append)
    assert told[-1] == {"kind": "mission", "phase": "reading", "done": 100, "of": 100}
    assert [news["done"] for news in told] == sorted(news["done"] for news in told)
    assert len(told) == 16  # once a packet


async def test_a_hundred_items_over_a_bad_link(filing: StartFiling) -> None:
    """20 % of the frames lost each way."""
    # With 3 s for an answer one reading in ten would be item by item.
    b, peer = await filing(pace=TransferTimes(reply=0.072, shortest=0.02, longest=0.16, file=15.0))
    peer.load(MISSION, raw(waypoints(3, alt=99.0)))
    peer.loss, peer.delay, peer.time = 0.2, 0.01, 0.1
    assert (await b.ground.do("mission_upload", items=waypoints(100))).result["count"] == 100
    assert peer.stored() == raw(waypoints(100))
    assert (await b.ground.do("mission_download")).result["count"] == 100
    assert [i.z for i in (await plan(b)).items] == [each["z"] for each in waypoints(100)]
    assert peer.by_item == 0


async def test_the_file_s_beginning_is_lost(filing: StartFiling) -> None:
    """Then only its end tells how long it is."""
    b, peer = await filing()
    peer.load(MISSION, raw(waypoints(50)))
    out, lost = peer.raw, list[bytes]()

    def lose(data: bytes) -> None:
        if not lost and plan_file.pack_header(MISSION, 51) in data:
            lost.append(data)
        else:
            out(data)

    peer.outlet.out = lose
    assert (await b.ground.do("mission_download")).result["count"] == 50
    assert (len(lost), peer.by_item) == (1, 0)
    assert peer.asked(Op.READ_FILE) <= 8  # and not for all that a file may have


def test_what_lies_behind_the_file_s_end_takes_no_room() -> None:
    """A packet says itself where it belongs, and may say anything."""
    dialect = load_dialect()
    file = PlanFile("mission", dialect, lambda done, of: None)
    most = plan_file.size_of(MOST, dialect)
    for offset in (0xFFFFFFF0, most):
        assert (file.put(offset, b"x" * 16), len(file.data)) == (0, 0)
    assert (file.put(most - 1, b"xy"), len(file.data)) == (1, most)
    size = plan_file.size_of(2, dialect)
    assert (file.put(0, plan_file.pack_header(MISSION, 2)), len(file.data)) == (plan_file.HEADER.size, size)
    for offset in (size, size + 1, 0xFFFFFFF0):
        assert (file.put(offset, b"x"), len(file.data)) == (0, size)


# Others on the vehicle.


async def test_an_upload_by_another_in_the_middle(filing: StartFiling) -> None:
    """It overwrites items as they are read; the reading waits for its end, and begins again."""
    b, peer = await filing(pace=replace(QUICK, busy=PATIENCE_S))
    peer.load(MISSION, raw(waypoints(40)))

    def begin(offset: int) -> None:
        if offset >= 239 and peer.upload is None and len(peer.heard("MISSION_REQUEST_LIST")) == 1:
            peer.upload = {"kind": MISSION, "count": 41, "from": (255, 190), "next": 21, "new": []}
            peer.plans[MISSION][1:21] = raw(waypoints(20, alt=200.0))

    peer.on_read = begin
    reading = asyncio.create_task(b.ground.do("mission_download"))
    await peer.count("MISSION_REQUEST_LIST", 3)  # which was denied twice
    peer.load(MISSION, raw(waypoints(40, alt=200.0)))
    peer.upload = None
    assert (await reading).result["count"] == 40
    assert [i.z for i in (await plan(b)).items] == [each["z"] for each in waypoints(40, alt=200.0)]
    assert peer.by_item == 0


async def test_another_count_after_than_before_is_read_again(filing: StartFiling) -> None:
    b, peer = await filing()
    peer.load(MISSION, raw(waypoints(40)))
    once = iter([waypoints(50, alt=77.0)])

    def change(offset: int) -> None:
        if offset >= 239 and (new := next(once, None)) is not None:
            peer.load(MISSION, raw(new))

    peer.on_read = change
    assert (await b.ground.do("mission_download")).result["count"] == 50
    assert [i.z for i in (await plan(b)).items] == [each["z"] for each in waypoints(50, alt=77.0)]


async def test_a_file_that_never_has_as_many_items_as_are_counted(filing: StartFiling) -> None:
    b, peer = await filing(pace=ONCE)
    peer.load(MISSION, OLD)
    size = plan_file.size_of(4, peer.dialect)
    peer.changes_file = lambda whole: (plan_file.pack_header(MISSION, 4) + whole[plan_file.HEADER.size :])[:size]
    assert (await b.ground.do("mission_upload", items=NEW)).result["count"] == 10
    assert (await b.ground.do("mission_download")).result["count"] == 10
    assert peer.by_item == 5 + 11 + 11


ELSE = (255, 190)


@pytest.mark.parametrize(
    ("say", "by_item"),
    [
        (lambda peer: peer.ack(MISSION, ACCEPTED, ELSE), 41),
        (lambda peer: peer.send("MISSION_COUNT", target_system=255, target_component=190, count=77), 41),
        (lambda peer: peer.ack(FENCE, ACCEPTED, ELSE), 0),
        (lambda peer: peer.ack(MISSION, ERROR, ELSE), 0),
    ],
)
async def test_an_upload_by_another_between_the_two_counts(
    filing: StartFiling, say: Callable[[FilingPeer], None], by_item: int
) -> None:
    """Of as many items: what the others are told says that the file is a mixture."""
    b, peer = await filing()
    peer.load(MISSION, raw(waypoints(40)))
    new = waypoints(40, alt=200.0) if by_item else waypoints(40)

    def change(offset: int) -> None:
        if offset >= 239 and len(peer.heard("MISSION_REQUEST_LIST")) == 1:
            peer.load(MISSION, raw(new))
            say(peer)

    peer.on_read = change
    assert (await b.ground.do("mission_download")).result["count"] == 40
    assert [i.z for i in (await plan(b)).items] == [each["z"] for each in new]
    assert peer.by_item == by_item


async def test_what_others_were_told_before_the_count_is_no_news(filing: StartFiling) -> None:
    b, peer = await filing()
    peer.load(MISSION, OLD)
    count = peer.on_mission_request_list

    def tell(told: Told) -> None:
        peer.ack(MISSION, ACCEPTED, ELSE)
        count(told)

    peer.on_mission_request_list = tell  # type: ignore[method-assign]
    # Only before the first count: the second one follows the reading.
    peer.on_read = lambda offset: setattr(peer, "on_mission_request_list", count)
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert peer.by_item == 0


async def test_a_file_server_in_other_hands_is_not_waited_for(filing: StartFiling) -> None:
    """A log may be minutes on its way; and when it is through, plans come as files again."""
    b, peer = await filing()
    peer.load(MISSION, OLD)
    server = peer.ftp.answers()["FILE_TRANSFER_PROTOCOL"]
    theirs = Packet(1, 7, Op.OPEN_FILE_RO, len("@MISSION/rally.dat"), data=b"@MISSION/rally.dat")
    peer.ftp.tick(asyncio.get_running_loop().time())  # it was last spoken to now
    server(peer.channel, {"payload": pack(theirs)}, (255, 190))
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (peer.by_item, peer.ftp.open_path) == (5, "@MISSION/rally.dat")
    server(peer.channel, {"payload": pack(Packet(3, 7, Op.TERMINATE_SESSION))}, (255, 190))
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert peer.by_item == 5


async def test_a_file_of_our_own_on_its_way_is_not_waited_for(filing: StartFiling) -> None:
    b, peer = await filing()
    peer.load(MISSION, OLD)
    peer.ftp.faults.mute.add(Op.CALC_FILE_CRC32)
    getting = asyncio.create_task(b.ground.do("file_get", path="/APM/some.bin"))
    await peer.until(lambda: peer.asked(Op.CALC_FILE_CRC32) > 0, "question for a checksum")
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (5, 0)
    getting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await getting


async def test_what_is_told_to_others_is_not_taken(filing: StartFiling) -> None:
    """Another program's file, its plan's count and its items, in the middle of ours; the file's packets come to
    everybody, too, and to us.
    """
    b, peer = await filing()
    peer.load(MISSION, OLD)

    def noise(offset: int) -> None:
        to = {"target_system": 255, "target_component": 190}
        ours = peer.heard("FILE_TRANSFER_PROTOCOL")[-1]
        asked = unpack(ours.fields["payload"])
        other = Packet(asked.seq + 1, asked.session ^ 9, Op.ACK, 40, Op.BURST_READ_FILE, data=b"\xff" * 40)
        for system, component in ((255, 190), (0, 0), ours.source):
            end = {"target_system": system, "target_component": component}
            peer.send("FILE_TRANSFER_PROTOCOL", **end, payload=pack(other))
        peer.send("MISSION_COUNT", **to, count=5)
        peer.send("MISSION_COUNT", **to, count=77, mission_type=FENCE)
        peer.send("MISSION_ITEM_INT", **to, seq=2, **OLD[0])

    peer.on_read = noise
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert ([i.z for i in (await plan(b)).items], peer.by_item) == ([item["z"] for item in OLD], 0)


# Where it cannot be had.


async def test_without_such_a_file_items_are_asked_for(filing: StartFiling, caplog: pytest.LogCaptureFixture) -> None:
    """And the file is not asked for again, of the plans that it is not there for."""
    caplog.set_level(logging.DEBUG, "zmav.services.missions")
    b, peer = await filing(kinds=("rally",))
    peer.load(MISSION, OLD)
    peer.load(RALLY, [{**OLD[0], "command": 5100}])
    for _ in range(2):
        assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (10, 1)
    (line,) = (record for record in caplog.records if record.name.startswith("zmav.services.missions"))
    assert line.levelno == logging.DEBUG
    assert "quad1: the mission by the mission protocol: cannot read @MISSION/mission.dat" in line.getMessage()
    assert (await b.ground.do("mission_download", kind="rally")).result["count"] == 1
    assert peer.by_item == 10


@pytest.mark.parametrize(
    ("changes", "again"),
    [
        (lambda whole: b"\x3c" + whole[1:], 1),  # another magic number
        (lambda whole: whole[:2] + b"\x01" + whole[3:], 1),  # another plan
        (lambda whole: whole[:6] + b"\x01" + whole[7:], 1),  # not from its first item on
        (lambda whole: whole[:6], 1),
        (lambda whole: b"", 1),
        (lambda whole: whole[:-38], 2),  # an item that cannot be read: in the same order it may be
    ],
)
async def test_what_is_no_such_file_is_not_taken_for_one(
    filing: StartFiling, changes: Callable[[bytes], bytes], again: int
) -> None:
    """It is asked for once in an order, and in the next order again: it may have been a stray packet."""
    b, peer = await filing(pace=ONCE)
    peer.load(MISSION, OLD)
    peer.changes_file = changes
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (await b.ground.do("mission_upload", items=NEW)).result["count"] == 10
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (5 + 5 + 11, 1 + again)
    assert peer.ftp.open_path is None
    peer.changes_file = lambda whole: whole
    assert (await b.ground.do("mission_download")).result["count"] == 10
    assert peer.by_item == 5 + 5 + 11


@pytest.mark.parametrize(
    ("op", "nak"),
    [
        (Op.BURST_READ_FILE, Nak.FILE_PROTECTED),
        (Op.BURST_READ_FILE, Nak.FILE_NOT_FOUND),
        (Op.OPEN_FILE_RO, Nak.FILE_PROTECTED),
        (Op.OPEN_FILE_RO, Nak.FAIL),
    ],
)
async def test_what_is_refused_now_may_be_had_another_time(filing: StartFiling, op: Op, nak: Nak) -> None:
    b, peer = await filing()
    peer.load(MISSION, OLD)
    peer.ftp.faults.refuse[op] = nak
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (peer.by_item, peer.ftp.open_path) == (5, None)
    peer.ftp.faults.refuse.clear()
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (5, 2)


@pytest.mark.parametrize("op", [Op.OPEN_FILE_RO, Op.BURST_READ_FILE])
async def test_a_silent_server_is_waited_for_once_in_an_order(filing: StartFiling, op: Op) -> None:
    """And asked again in the next: it may have been the link."""
    b, peer = await filing(pace=replace(QUICK, file=0.2))
    peer.load(MISSION, OLD)
    peer.ftp.faults.mute.add(op)
    assert (await b.ground.do("mission_upload", items=NEW)).result["count"] == 10
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (5 + 11, 1)
    packets = [unpack(told.fields["payload"]) for told in peer.heard("FILE_TRANSFER_PROTOCOL")]
    assert 1 <= sum(packet.opcode == op for packet in packets) <= 2  # in 0.2 s
    peer.ftp.faults.mute.clear()
    assert (await b.ground.do("mission_download")).result["count"] == 10
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (5 + 11, 2)


async def test_an_armed_vehicle_is_not_asked_for_files(filing: StartFiling) -> None:
    """ArduPilot sends everything else more slowly meanwhile."""
    b, peer = await filing()
    peer.load(MISSION, OLD)
    peer.armed = True
    await b.state(lambda s: s["armed"], "armed")
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert not peer.heard("FILE_TRANSFER_PROTOCOL")


async def test_a_vehicle_that_is_armed_meanwhile_is_asked_for_no_more_files(filing: StartFiling) -> None:
    b, peer = await filing(pace=ONCE)
    peer.load(MISSION, OLD)
    take, held = peer.on_mission_item_int, list[Told]()
    peer.on_mission_item_int = lambda told: (held.append if told.fields["seq"] == 10 else take)(told)  # type: ignore[method-assign]
    uploading = asyncio.create_task(b.ground.do("mission_upload", items=NEW))
    await peer.until(lambda: bool(held), "last item")
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (0, 1)
    peer.armed = True
    await b.state(lambda s: s["armed"], "armed")
    take(held[0])
    assert (await uploading).result["count"] == 10
    assert (peer.by_item, peer.asked(Op.OPEN_FILE_RO)) == (11, 1)


@pytest.mark.parametrize(("style", "capabilities"), [("px4", HAS_FILES), ("ardupilot", 0)])
async def test_who_does_not_have_them_is_not_asked_for_files(
    filing: StartFiling, style: str, capabilities: int
) -> None:
    b, peer = await filing(style=style, capabilities=capabilities)
    peer.load(MISSION, OLD)
    assert (await b.ground.do("mission_download")).result["count"] == 4
    assert not peer.heard("FILE_TRANSFER_PROTOCOL")
