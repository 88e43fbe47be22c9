"""The storage of a simulated PX4: its files, and a ULog of every flight with its parameters and texts."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Channel, Part, Sender
from zmav.sim.protocol.filesystem import FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.logs import ALL, MOST_ONE, FlightLog, Listing, Log, LogProtocol, LogStore

MAGIC = b"ULog\x01\x12\x35\x01"
_HEADER = struct.Struct("<8sQ")
_MESSAGE = struct.Struct("<HB")
LOGS = "/log/sess001"
_REAL32 = 9  # MAV_PARAM_TYPE


class UlogFlight(FlightLog):
    """What a PX4 writes while it is armed."""

    _writer: UlogWriter

    def say(self, severity: int, text: str) -> None:
        if self.running:
            self._writer.text(severity, self.time_us, text)

    def begin(self) -> bytearray:
        params = self._node.brain.params
        values = {name: params[name] if params.type_of(name) == _REAL32 else int(params[name]) for name in params.names}
        info = {"sys_name": "PX4", "ver_hw": "PX4_SITL", "ver_sw": "zmav-sim"}
        self._writer = UlogWriter(self.time_us, MOST_ONE, info=info, params=values)
        return self._writer.data

    def begun(self, log: Log) -> None:
        self._node.say(6, f"[logger] .{LOGS}/{log.name}\t")


class Px4LogProtocol(LogProtocol):
    """The log protocol as PX4 1.16 runs it: measured, and read in its mavlink_log_handler.

    An id is a log's place in its directory, from 0, and a directory has no order of time: here the newest comes first.
    ``last_log_num`` is the number of logs, or the end that was asked for, which is not looked at otherwise. Without
    logs it says nothing. A new request ends what is under way, and logs are given out in flight, once they are listed.
    """

    def __init__(self, store: LogStore) -> None:
        super().__init__(store, lambda: False)
        self._listed: dict[int, int] = {}
        """the end of the list that was asked for last, by channel"""

    def by_id(self, number: int) -> Log | None:
        return self.store.logs[-1 - number] if 0 <= number < len(self.store.logs) else None

    def last_number(self, listing: Listing) -> int:
        end = self._listed.get(id(listing.channel), ALL)
        return len(self.store.logs) if end == ALL else end

    def closed(self, channel: Channel) -> None:
        super().closed(channel)
        self._listed.pop(id(channel), None)

    def _busy(self, channel: Channel) -> bool:
        return False

    def _list(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        self._listed[id(channel)] = msg["end"]
        self._task = Listing(channel, msg["start"], ALL)

    def _data(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        log = self.by_id(msg["id"])
        if id(channel) in self._listed and log is not None and msg["ofs"] < len(log.data):
            super()._data(channel, msg, sender)


class Px4Storage:
    """What one vehicle keeps. ``parts`` are what its node offers of it."""

    def __init__(self, node: Node) -> None:
        self.logs = LogStore("log{}.ulg", first=100)
        self.flight_log = UlogFlight(node, self.logs)
        self.files = FileSystem(LOGS)
        self.files.attach(LOGS, self.logs.files, self.logs.remove)
        self.ftp = FtpServer(self.files, session=0)
        self.protocol = Px4LogProtocol(self.logs)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.flight_log, self.protocol, self.ftp


class UlogWriter:
    """A growing log, begun at ``time_us`` since boot; at most ``limit`` bytes, always whole messages.

    ``info`` are texts such as ``sys_name``; ``params`` are int (int32_t) or float. A header, then messages of size,
    type and body: https://docs.px4.io/main/en/dev_log/ulog_file_format.html. Topics are not logged.
    """

    def __init__(self, time_us: int, limit: int, *, info: Mapping[str, str], params: Mapping[str, float]) -> None:
        self.data = bytearray(_HEADER.pack(MAGIC, time_us))
        self.full = False
        self._limit = limit
        self._put("B", bytes(40))  # flag bits: nothing appended, no flags
        for key, text in info.items():
            self._put("I", _keyed(f"char[{len(text.encode())}] {key}", text.encode()))
        for name, value in params.items():
            kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
            self._put("P", _keyed(f"{kind} {name}", struct.pack(code, value)))

    def text(self, level: int, time_us: int, text: str) -> None:
        """A logged string; ``level`` is a MAV_SEVERITY."""
        self._put("L", struct.pack("<BQ", ord("0") + level, time_us) + text.encode())

    def _put(self, kind: str, body: bytes) -> None:
        if self.full or len(self.data) + _MESSAGE.size + len(body) > self._limit:
            self.full = True
            return
        self.data += _MESSAGE.pack(len(body), ord(kind)) + body


def _keyed(key: str, value: bytes) -> bytes:
    return bytes((len(key.encode()),)) + key.encode() + value
