"""Logs and files of the simulated PX4."""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING

from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.px4.storage import LOGS, MAGIC

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion


def fly(companion: Companion) -> Px4Node:
    companion.put_up()
    assert companion.command(400, 0, 21196) == [0]
    companion.world.step(2.0)  # down, and the log closed
    node = companion.vehicle.node
    assert isinstance(node, Px4Node)
    return node


def messages(data: bytes) -> list[tuple[str, bytes]]:
    assert data.startswith(MAGIC)
    at, found = 16, []
    while at < len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        found.append((chr(kind), data[at + 3 : at + 3 + size]))
        at += 3 + size
    return found


def test_a_flight_is_a_ulog(companion: Companion) -> None:
    node = fly(companion)
    (log,) = node.storage.logs.logs
    found = messages(bytes(log.data))
    kinds = Counter(kind for kind, _ in found)
    assert kinds["P"] == len(companion.vehicle.px4.params)
    assert b"Takeoff detected\t" in [body[9:] for kind, body in found if kind == "L"]


def listed(companion: Companion, start: int = 0, end: int = 0xFFFF) -> list[tuple[int, int, int, int]]:
    companion.clear()
    companion.send("LOG_REQUEST_LIST", start=start, end=end)
    companion.world.step(0.1)
    return [(e["id"], e["num_logs"], e["last_log_num"], e["size"]) for e in companion.all("LOG_ENTRY")]


def test_ids_are_places_in_a_directory(companion: Companion) -> None:
    """As PX4 1.16.1 lists them: from 0, in no order of time, and the last log's number is how many there are."""
    node = fly(companion)
    assert node.storage.logs.logs
    node.storage.logs.erase()
    assert listed(companion) == []
    for size in (100, 200, 300):
        node.storage.logs.begin(bytearray(size), size)
    assert listed(companion) == [(0, 3, 3, 300), (1, 3, 3, 200), (2, 3, 3, 100)]
    assert listed(companion, 1, 1) == [(1, 3, 1, 200), (2, 3, 1, 100)]
    assert listed(companion, 3, 3) == []


def test_a_log_is_given_out_in_the_air_once_it_was_listed(companion: Companion) -> None:
    fly(companion)
    companion.put_up()
    companion.clear()
    companion.send("LOG_REQUEST_DATA", id=0, ofs=0, count=90)
    companion.world.step(0.1)
    assert companion.all("LOG_DATA") == []
    assert len(listed(companion)) == 2
    companion.send("LOG_REQUEST_DATA", id=0, ofs=0, count=90)
    companion.world.step(0.1)
    assert bytes(companion.all("LOG_DATA")[0]["data"][:7]) == MAGIC[:7]


def test_the_files_are_the_logs(companion: Companion) -> None:
    node = fly(companion)
    assert [entry.name for entry in node.storage.files.list(LOGS)] == ["log100.ulg"]
    assert node.storage.files.open(f"{LOGS}/log100.ulg", 200) == bytes(node.storage.logs.logs[0].data)
    assert node.storage.files.list("/") != []
