"""An autopilot with parameters at the far end of a slow serial line: a pty whose two directions carry so many bytes a
second and lose whole frames.

It answers as ArduPilot does: PARAM_REQUEST_LIST streams whenever its transmit buffer has room, at most 20 single
questions wait, and answers to those go first; HEARTBEAT and ATTITUDE flow beside.
"""

from __future__ import annotations

import collections
import contextlib
import os
import pty
import random
import threading
import time
import tty
from types import TracebackType
from typing import Any

from zmav.mavlink import Packer, Splitter, decode, load_dialect

TICK_S = 0.002
BUFFER = 256
"""bytes its transmit buffer holds"""
MOST_WAITING = 20
REAL32 = 9
NO_INDEX = 65535


class SlowAutopilot:
    """``path`` is the client's end of the line; ``share``: of the line's speed that a stream of parameters may take."""

    def __init__(self, count: int, rate: float, loss: float, share: float, seed: int) -> None:
        self.params = {f"P_{i:04d}": i * 0.5 for i in range(count)}
        self._names = list(self.params)
        self._rate, self._loss, self._share = rate, loss, share
        self._chance = random.Random(seed)
        dialect = load_dialect()
        self._packer, self._splitter, self._dialect = Packer(dialect, 1, 1), Splitter(dialect), dialect
        self._waiting: collections.deque[int | str] = collections.deque()
        self._next: int | None = None
        self._stream_budget = 0.0
        self._up = bytearray()
        self._down: collections.deque[bytes] = collections.deque()
        self._up_budget = self._down_budget = 0.0
        self.asked_at: float | None = None
        """monotonic seconds at which the list was first asked for, lost or not"""
        self.bytes_up = self.bytes_down = 0
        """since then"""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> SlowAutopilot:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        last = start = time.monotonic()
        beats = attitudes = 0
        while not self._over.wait(TICK_S):
            now = time.monotonic()
            passed, last = now - last, now
            self._receive(passed)
            if now - start >= beats:
                beats += 1
                self._say("HEARTBEAT", type=2, autopilot=3, base_mode=1, system_status=3)
            if now - start >= attitudes * 0.1:
                attitudes += 1
                self._say("ATTITUDE", time_boot_ms=int((now - start) * 1000) + 10_000)
            self._stream_budget = min(self._stream_budget + passed * self._rate * self._share, BUFFER)
            self._feed()
            self._transmit(passed)

    def _receive(self, passed: float) -> None:
        with contextlib.suppress(OSError):  # nothing there
            self._up += os.read(self._master, 4096)
        self._up_budget = self._up_budget + passed * self._rate if self._up else 0.0
        take = min(int(self._up_budget), len(self._up))
        self._up_budget -= take
        data = bytes(self._up[:take])
        del self._up[:take]
        if self.asked_at is not None:
            self.bytes_up += take
        for frame in self._splitter.feed(data) if data else ():
            name = self._dialect.name_of(frame.msgid)
            if name == "PARAM_REQUEST_LIST" and self.asked_at is None:
                self.asked_at = time.monotonic()
            if self._chance.random() >= self._loss:
                self._hear(name, decode(frame, self._dialect))

    def _hear(self, name: str, fields: dict[str, Any]) -> None:
        if name == "PARAM_REQUEST_LIST":
            self._next = 0
        elif name == "PARAM_REQUEST_READ" and len(self._waiting) < MOST_WAITING:
            self._waiting.append(fields["param_id"] if fields["param_index"] < 0 else fields["param_index"])
        elif name == "COMMAND_LONG" and (fields["command"], fields["param1"]) == (512, 148.0):
            self._say("AUTOPILOT_VERSION", uid=1, flight_sw_version=0x04070000)

    def _feed(self) -> None:
        """Answers first, then the stream, while the transmit buffer has room."""
        while self._waiting and self._room():
            asked = self._waiting.popleft()
            if isinstance(asked, str):
                self._value(asked, NO_INDEX)
            elif asked < len(self._names):
                self._value(self._names[asked], asked)
        while self._next is not None and self._room() and self._stream_budget > 0:
            self._stream_budget -= self._value(self._names[self._next], self._next)
            self._next = self._next + 1 if self._next + 1 < len(self._names) else None

    def _room(self) -> bool:
        return sum(map(len, self._down)) < BUFFER

    def _value(self, name: str, index: int) -> int:
        return self._say(
            "PARAM_VALUE",
            param_id=name,
            param_value=self.params[name],
            param_type=REAL32,
            param_count=len(self.params),
            param_index=index,
        )

    def _say(self, name: str, **fields: Any) -> int:
        frame = self._packer.pack(name, **fields)
        self._down.append(frame)
        return len(frame)

    def _transmit(self, passed: float) -> None:
        """What is lost takes its time on the line, too."""
        self._down_budget = self._down_budget + passed * self._rate if self._down else 0.0
        while self._down and self._down_budget >= len(self._down[0]):
            frame = self._down.popleft()
            self._down_budget -= len(frame)
            if self.asked_at is not None:
                self.bytes_down += len(frame)
            if self._chance.random() >= self._loss:
                os.write(self._master, frame)
