"""An autopilot that streams as it is told, over UDP or over a serial line no wider than it is said to be."""

from __future__ import annotations

import asyncio
import math
import os
import pty
import time
import tty
from typing import Any

from tests.services.conftest import ACCEPTED, Peer, Told

SET_INTERVAL, REJECTED_FOR_NOW, DENIED = 511, 1, 2
STEP_S = 0.01


class StreamPeer(Peer):
    """Sends messages at intervals, answers TIMESYNC, forgets everything in a reboot.

    ``unasked`` are the rates in Hz of what it sends by itself; ``denied`` the messages it does not send, ``later``
    those that it cannot send now, ``fastest`` the rate above which it denies any; ``fields`` what the messages hold.
    """

    def __init__(self, sysid: int = 1, unasked: dict[str, float] | None = None, **more: Any) -> None:
        super().__init__(sysid, **more)
        self.unasked = unasked or {}
        self.rates = dict(self.unasked)
        self.denied: set[str] = set()
        self.later: set[str] = set()
        self.fastest = 400.0
        self.fields: dict[str, dict[str, Any]] = {}
        self.answers_within = math.inf
        """s from a TIMESYNC question; 0: never"""
        self.booted = time.monotonic() - 100.0
        self._due: dict[str, float] = {}
        self._streamer: asyncio.Task[None] | None = None

    @property
    def boot(self) -> float:
        """s since its boot"""
        return time.monotonic() - self.booted

    def reboot(self) -> None:
        self.booted, self.rates = time.monotonic(), dict(self.unasked)

    async def open(self) -> None:
        await super().open()
        self._streamer = asyncio.get_running_loop().create_task(self._stream())

    async def close(self) -> None:
        assert self._streamer is not None
        self._streamer.cancel()
        await super().close()

    async def _stream(self) -> None:
        while True:
            now = time.monotonic()
            for name, hz in list(self.rates.items()):
                if name in self.dialect.by_name and now >= self._due.get(name, 0.0):
                    self._due[name] = max(self._due.get(name, now) + 1.0 / hz, now - 0.1)
                    self.send(name, **self.fields.get(name, {}))
            await asyncio.sleep(STEP_S)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        before = len(self.told)
        super().datagram_received(data, addr)
        for told in self.told[before:]:
            if told.name != "TIMESYNC" or told.fields["tc1"] != 0:
                continue
            if time.monotonic() - told.fields["ts1"] / 1e9 < self.answers_within:
                self.send("TIMESYNC", tc1=round(self.boot * 1e9), ts1=told.fields["ts1"])

    def command(self, told: Told) -> None:
        number = told.fields["command"]
        if number in self.mute or number != SET_INTERVAL:
            super().command(told)
            return
        name, interval = self.dialect.name_of(int(told.fields["param1"])), told.fields["param2"]
        result = DENIED if name in self.denied or 0 < interval < 1e6 / self.fastest else ACCEPTED
        result = REJECTED_FOR_NOW if name in self.later else result
        if result == ACCEPTED:
            self._set(name, interval)
        self.acknowledge(number, result, told.source)

    def _set(self, name: str, interval: float) -> None:
        hz = self.unasked.get(name, 0.0) if interval == 0 else 1e6 / interval if interval > 0 else 0.0
        self.rates = {**self.rates, name: hz} if hz else {n: r for n, r in self.rates.items() if n != name}

    def asked(self, name: str) -> list[float]:
        """The intervals in µs asked for so far."""
        msgid = float(self.dialect.message(name).id)
        return [t.fields["param2"] for t in self.commands(SET_INTERVAL) if t.fields["param1"] == msgid]


class SerialPeer(StreamPeer):
    """The same at the end of a pseudo terminal that carries ``baud / 10`` bytes a second; what does not fit is lost."""

    def __init__(self, baud: int, **more: Any) -> None:
        super().__init__(**more)
        self.baud, self.lost = baud, 0
        self._room, self._filled = 0.0, time.monotonic()
        self._master = self._slave = -1

    @property
    def url(self) -> str:
        return f"serial:{os.ttyname(self._slave)}:{self.baud}"

    async def open(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        asyncio.get_running_loop().add_reader(self._master, self._readable)
        await super().open()

    async def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._master)
        await super().close()
        os.close(self._master)
        os.close(self._slave)

    def _readable(self) -> None:
        self.datagram_received(os.read(self._master, 4096), None)

    def raw(self, data: bytes) -> None:
        now, rate = time.monotonic(), self.baud / 10
        self._room = min(self._room + (now - self._filled) * rate, rate / 10)
        self._filled = now
        if self._room < len(data):
            self.lost += 1
            return
        self._room -= len(data)
        try:
            os.write(self._master, data)
        except BlockingIOError:
            self.lost += 1
            return
        self.sent.append(data)


__all__ = ["DENIED", "SET_INTERVAL", "SerialPeer", "StreamPeer"]
