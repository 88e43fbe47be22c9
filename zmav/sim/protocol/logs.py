"""The flight logs of a simulated autopilot, and the log protocol: https://mavlink.io/en/services/log.html

ArduPilot's rules: ids count from 1 (the oldest), nothing is given out while armed, one transfer at a time over all
links, requests that come while data is sent are ignored.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender

MOST = 4 << 20
"""bytes of all logs of one vehicle; the oldest make room"""
MOST_ONE = 2 << 20
PER_TICK = 160
"""LOG_DATA in one tick: 40 in each of ArduPilot's loops, of which there are four"""
DATA = 90
ALL = 0xFFFF
ERROR, INFO = 3, 6


@dataclass
class Log:
    """One flight's log; ``end_s``: UTC when it ended, or began where it has not."""

    name: str
    data: bytearray
    end_s: float


class LogStore:
    """The logs of one vehicle, oldest first, within bounds. ``form`` makes file names of numbers, from ``first`` on."""

    def __init__(self, form: str = "{:08d}.BIN", first: int = 1, *, most: int = MOST, most_one: int = MOST_ONE) -> None:
        self._form, self._most, self._most_one = form, most, most_one
        self.logs: list[Log] = []
        self._next = first

    def begin(self, data: bytearray, now_s: float) -> Log:
        """A new log; its ``data`` may still grow, up to :data:`MOST_ONE`."""
        log = Log(self._form.format(self._next), data, now_s)
        self._next += 1
        while self.logs and sum(len(each.data) for each in self.logs) + self._most_one > self._most:
            self.logs.pop(0)
        self.logs.append(log)
        return log

    def erase(self) -> None:
        self.logs.clear()

    def files(self) -> dict[str, bytes]:
        """The logs as a directory's files."""
        return {log.name: bytes(log.data) for log in self.logs}

    def remove(self, name: str) -> bool:
        before = len(self.logs)
        self.logs = [log for log in self.logs if log.name != name]
        return len(self.logs) < before


class FlightLog(Part, ABC):
    """Begins a log when the vehicle is armed and ends it when it is disarmed."""

    def __init__(self, node: Node, store: LogStore) -> None:
        self._node, self._store = node, store
        self._log: Log | None = None

    @property
    def time_us(self) -> int:
        return int(self._node.brain.uptime * 1e6)

    @property
    def running(self) -> bool:
        return self._log is not None

    def tick(self, now: float) -> None:
        if not self._node.brain.armed:
            if self._log is not None:
                self._log.end_s = self._node.unix_us / 1e6
                self._log = None
            return
        if self._log is None:
            self._log = self._store.begin(self.begin(), self._node.unix_us / 1e6)
            self.begun(self._log)

    @abstractmethod
    def begin(self) -> bytearray:
        """A new file, which may still grow."""

    def begun(self, log: Log) -> None:
        """There is a log now."""

    @abstractmethod
    def say(self, severity: int, text: str) -> None:
        """Log a text that the vehicle said."""


@dataclass
class Listing:
    channel: Channel
    next: int
    last: int


@dataclass
class Sending:
    channel: Channel
    log: Log
    id: int
    offset: int
    left: int


class LogProtocol(Part):
    """Lists, sends and erases ``store``'s logs; refuses while ``armed()``."""

    def __init__(self, store: LogStore, armed: Callable[[], bool]) -> None:
        self.store = store
        self._armed = armed
        self._warned = False
        self._task: Listing | Sending | None = None

    def answers(self) -> Mapping[str, Answer]:
        return {
            "LOG_REQUEST_LIST": self._list,
            "LOG_REQUEST_DATA": self._data,
            "LOG_REQUEST_END": self._end,
            "LOG_ERASE": self._erase,
        }

    @property
    def sending(self) -> bool:
        return self._task is not None and not self._armed()

    def tick(self, now: float) -> None:
        if (self._task is None and not self._warned) or self._refused(None):
            return
        for _ in range(PER_TICK):
            task = self._task
            if task is None or not task.channel.has_room():
                return
            if isinstance(task, Listing):
                self._send_entry(task)
            else:
                self._send_data(task)

    def closed(self, channel: Channel) -> None:
        if self._task is not None and self._task.channel is channel:
            self._task = None

    def by_id(self, number: int) -> Log | None:
        """The log of that id."""
        return self.store.logs[number - 1] if 1 <= number <= len(self.store.logs) else None

    def last_number(self, listing: Listing) -> int:
        """What a listing calls the last log's number."""
        return len(self.store.logs)

    def _refused(self, channel: Channel | None) -> bool:
        """Armed, and said so once."""
        if not self._armed():
            self._warned = False
            return False
        if channel is not None and not self._warned:
            self._warned = True
            channel.send("STATUSTEXT", severity=ERROR, text="Disarm for log download")
        return True

    def _busy(self, channel: Channel) -> bool:
        if self._task is None:
            return False
        if self._task.channel is not channel:
            channel.send("STATUSTEXT", severity=INFO, text="Log download in progress")
        return True

    def _list(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if self._refused(channel) or self._busy(channel):
            return
        count = len(self.store.logs)
        if count == 0:
            channel.send("LOG_ENTRY", id=0, num_logs=0, last_log_num=0, time_utc=0, size=0)
            return
        first, last = max(msg["start"], 1), min(msg["end"], count)
        if first <= last:
            self._task = Listing(channel, first, last)

    def _send_entry(self, task: Listing) -> None:
        log, count = self.by_id(task.next), len(self.store.logs)
        if log is None:
            self._task = None
            return
        task.channel.send(
            "LOG_ENTRY",
            id=task.next,
            num_logs=count,
            last_log_num=self.last_number(task),
            time_utc=int(log.end_s),
            size=len(log.data),
        )
        task.next += 1
        if task.next > task.last:
            self._task = None

    def _data(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if self._refused(channel) or self._busy(channel):
            return
        log = self.by_id(msg["id"])
        if log is not None:
            left = min(msg["count"], max(len(log.data) - msg["ofs"], 0))
            self._task = Sending(channel, log, msg["id"], msg["ofs"], left)

    def _send_data(self, task: Sending) -> None:
        count = min(task.left, DATA)
        data = bytes(task.log.data[task.offset : task.offset + count])
        task.channel.send("LOG_DATA", id=task.id, ofs=task.offset, count=count, data=data)
        task.offset, task.left = task.offset + count, task.left - count
        if count < DATA or task.left == 0:
            self._task = None

    def _end(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if not self._refused(channel):
            self._task = None

    def _erase(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if not self._refused(channel):
            self._task = None
            self.store.erase()
