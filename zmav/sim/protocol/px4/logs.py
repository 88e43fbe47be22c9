"""The log protocol as PX4 1.16 runs it, which differs from ArduPilot's: measured, and read in its mavlink_log_handler.

An id is a log's place in its directory, from 0, and a directory has no order of time: here the newest comes first.
``last_log_num`` is the number of logs, or the end that was asked for, which is not looked at otherwise. Without logs it
says nothing. A new request ends what is under way, and logs are given out in flight, once they have been listed.
"""

from __future__ import annotations

from typing import Any

from zmav.sim.protocol.channel import Channel
from zmav.sim.protocol.logs import ALL, Listing, Log, LogProtocol, LogStore
from zmav.sim.protocol.part import Sender


class Px4LogProtocol(LogProtocol):
    """Lists, sends and erases ``store``'s logs."""

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
