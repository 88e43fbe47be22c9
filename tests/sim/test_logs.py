"""The simulator's flight logs: real ones, by both protocols, within bounds."""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink import DFReader, mavutil

from zmav.sim import World
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.storage import MESSAGE, DataflashWriter, Storage
from zmav.sim.protocol.logs import LogStore
from zmav.sim.protocol.px4.storage import MAGIC, UlogWriter

if TYPE_CHECKING:
    from pathlib import Path

    from tests.sim.conftest import Gcs, MakeGcs

EPOCH_S = 1_790_000_000.0


def storage(gcs: Gcs) -> Storage:
    node = gcs.vehicle.node
    assert isinstance(node, MavNode)
    return node.storage


def read(data: bytes, path: Path) -> list[Any]:
    """A log's messages, as pymavlink reads them."""
    path.write_bytes(data)
    reader = DFReader.DFReader_binary(str(path))
    found = []
    while (message := reader.recv_msg()) is not None:
        found.append(message)
    return found


def test_a_flight_is_logged_and_read_by_pymavlink(make_gcs: MakeGcs, tmp_path: Path) -> None:
    gcs = make_gcs(epoch_s=EPOCH_S)
    assert storage(gcs).logs.logs == []
    gcs.put_up(5.0)
    gcs.command(176, 1, 9)
    gcs.until(lambda: not gcs.vehicle.copter.armed)
    (log,) = storage(gcs).logs.logs
    messages = read(bytes(log.data), tmp_path / "log.bin")
    kinds = Counter(m.get_type() for m in messages)
    assert kinds["PARM"] == len(gcs.vehicle.copter.params)
    texts = [m.Message for m in messages if m.get_type() == "MSG"]
    assert texts[0].startswith("ArduCopter V")
    assert "Disarming motors" in texts
    assert log.end_s == pytest.approx(EPOCH_S + gcs.world.time_s, abs=1.0)
    assert kinds["FMT"] == 3


def test_every_arming_begins_another_log(gcs: Gcs) -> None:
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    for _ in range(2):
        assert gcs.command(400, 1) == 0
        gcs.world.step(0.5)
        assert gcs.command(400, 0) == 0
        gcs.world.step(0.1)
    assert [log.name for log in storage(gcs).logs.logs] == ["00000001.BIN", "00000002.BIN"]
    assert [e.name for e in storage(gcs).files.list("/APM/LOGS")] == ["00000001.BIN", "00000002.BIN"]


def test_pymavlink_downloads_a_log_as_mavproxy_does() -> None:
    with World(copters=1, endpoint="tcp:0", ready_s=0.5) as world:
        node = world.vehicles[0].node
        assert isinstance(node, MavNode)
        data = bytes(range(251)) * 200
        world.call(lambda: node.storage.logs.begin(bytearray(data), EPOCH_S))
        link = mavutil.mavlink_connection(world.urls[0], source_system=250)
        link.wait_heartbeat(timeout=30)
        link.mav.log_request_list_send(1, 1, 0, 0xFFFF)
        entry = link.recv_match(type="LOG_ENTRY", blocking=True, timeout=30)
        assert (entry.id, entry.num_logs, entry.last_log_num, entry.size) == (1, 1, 1, len(data))
        assert entry.time_utc == EPOCH_S
        link.mav.log_request_data_send(1, 1, 1, 0, 0xFFFFFFFF)
        got = bytearray(len(data))
        missing = len(data)
        while missing:
            m = link.recv_match(type="LOG_DATA", blocking=True, timeout=30)
            assert m is not None
            got[m.ofs : m.ofs + m.count] = bytes(m.data[: m.count])
            missing -= m.count
        assert bytes(got) == data
        link.mav.log_request_end_send(1, 1)
        link.close()


def test_nothing_is_given_out_while_armed_and_that_is_said_once(gcs: Gcs) -> None:
    storage(gcs).logs.begin(bytearray(b"x" * 300), EPOCH_S)
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    gcs.command(400, 1)
    gcs.clear()
    for _ in range(2):
        gcs.send("LOG_REQUEST_LIST", start=0, end=0xFFFF)
        gcs.send("LOG_ERASE")
    gcs.world.step(0.2)
    assert gcs.all("LOG_ENTRY") == []
    assert gcs.texts().count("Disarm for log download") == 1
    assert storage(gcs).logs.logs[0].data == b"x" * 300
    gcs.command(400, 0)
    gcs.send("LOG_REQUEST_LIST", start=0, end=0xFFFF)
    gcs.world.step(0.2)
    assert [e["id"] for e in gcs.all("LOG_ENTRY")] == [1, 2]


def test_one_transfer_at_a_time(gcs: Gcs, another_gcs: Any) -> None:
    storage(gcs).logs.begin(bytearray(b"x" * 100_000), EPOCH_S)
    other = another_gcs(gcs.world, gcs.vehicle)
    gcs.send("LOG_REQUEST_DATA", id=1, ofs=0, count=100_000)
    gcs.send("LOG_REQUEST_DATA", id=1, ofs=50_000, count=90)
    other.send("LOG_REQUEST_DATA", id=1, ofs=0, count=90)
    gcs.world.step(0.02)
    assert "Log download in progress" in other.texts()
    assert gcs.vehicle.node.next_due <= gcs.world.time_s  # the next tick goes on, and comes on time
    assert [m["ofs"] for m in gcs.all("LOG_DATA")] == list(range(0, 320 * 90, 90))
    gcs.send("LOG_REQUEST_END")
    gcs.clear()
    other.send("LOG_REQUEST_DATA", id=1, ofs=99_990, count=90)
    gcs.world.step(0.02)
    assert gcs.all("LOG_DATA") == []
    assert [(m["ofs"], m["count"]) for m in other.all("LOG_DATA")] == [(99_990, 10)]
    other.clear()
    other.send("LOG_REQUEST_DATA", id=9, ofs=0, count=90)
    gcs.world.step(0.02)
    assert other.all("LOG_DATA") == []
    assert gcs.vehicle.node.next_due > gcs.world.time_s


def test_logs_stay_within_bounds() -> None:
    store = LogStore(most=3_000, most_one=1_000)
    for _ in range(6):
        store.begin(bytearray(1_000), EPOCH_S)
    assert [log.name for log in store.logs] == ["00000004.BIN", "00000005.BIN", "00000006.BIN"]
    writer = DataflashWriter((MESSAGE,), limit=20_000)
    for _ in range(1_000):
        writer.write(MESSAGE, 0, "words")
    assert writer.full
    assert 19_900 < len(writer.data) <= 20_000


def test_ulog_is_laid_out_as_documented() -> None:
    writer = UlogWriter(1_000, 10_000, info={"sys_name": "PX4"}, params={"MAV_SYS_ID": 3, "MPC_XY_P": 0.95})
    writer.text(6, 3_000, "Takeoff detected")
    data = bytes(writer.data)
    assert data[:8] == MAGIC
    assert struct.unpack_from("<Q", data, 8) == (1_000,)
    at, found = 16, []
    while at < len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        found.append((chr(kind), data[at + 3 : at + 3 + size]))
        at += 3 + size
    assert at == len(data)
    assert [kind for kind, _ in found] == ["B", "I", "P", "P", "L"]
    bodies = [body for _, body in found]
    assert bodies[0] == bytes(40)
    assert bodies[1] == b"\x10char[3] sys_name" + b"PX4"
    assert bodies[2] == b"\x12int32_t MAV_SYS_ID" + struct.pack("<i", 3)
    assert bodies[3] == b"\x0efloat MPC_XY_P" + struct.pack("<f", 0.95)
    assert bodies[4] == b"6" + struct.pack("<Q", 3_000) + b"Takeoff detected"
