"""TIMESYNC: the questions that the round trip and the clock live on, and the companion's clock held against GPS time.

https://mavlink.io/en/services/timesync.html. A question has ``tc1`` zero and our time in ``ts1``; the answer brings
``ts1`` back and the autopilot's time, nanoseconds since its boot, in ``tc1``.
"""

from __future__ import annotations

import asyncio
import collections
import math
import time
from collections.abc import Callable
from typing import NamedTuple

from zmav import wire
from zmav.autopilots.base import Fields
from zmav.mavlink import Frame, decode
from zmav.services.companion import Companion
from zmav.services.link.clock import AutopilotClock
from zmav.services.link.heard import AutopilotMessages
from zmav.waiting import on_loop

SETTLED_EVERY = 1.0
"""s between questions; while answers come and the clock has not settled, every tick asks"""
ANSWER = 0.25
"""s that an answer is awaited, frame by frame"""
OF_PERIOD, SILENT = 0.05, 2.0
"""of the time between two of the autopilot's questions: so long they may lie; s after which it asks no more"""
UNIX_TIME = 1_000_000_000_000_000
"""µs; SYSTEM_TIME and ``time_usec`` hold UTC above it (2001) and the time since boot, or nothing, below"""
WRONG, RIGHT = 1.0, 0.7
"""s off GPS time from which the companion's clock is called wrong, and below which it is right again; ArduPilot's own
UTC was seen 0.4 s off the time it had from its GPS"""


class AutopilotRestarted(NamedTuple):
    """It has begun again, or may have: all that it sent on request is to be asked for again. Told on the event loop."""


class TimeSync:
    """Asks, measures round trips, feeds the clock. Lives on the event loop."""

    def __init__(self, companion: Companion) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self.clock = AutopilotClock()
        self.gps_offset: float | None = None
        """s by which GPS time is ahead of the companion's UTC"""
        self.restarts = 0
        """times that the autopilot was seen to begin again, or may have"""
        self._there = 0.0
        """monotonic seconds at which the autopilot was heard: first, and then at its last answer"""
        self._wrong = False
        self._source: tuple[int, int] | None = None
        self._asked: collections.deque[int] = collections.deque(maxlen=16)
        self._rtts: list[float] = []
        self._unanswered = False
        self._questioned, self._between = 0.0, math.inf
        """monotonic seconds at which the autopilot last asked for our time, and from the time before to then"""
        self._stop: Callable[[], None] | None = None
        self._system_time = AutopilotMessages(companion, {"SYSTEM_TIME": self._on_system_time})

    def start(self) -> None:
        answered = on_loop(asyncio.get_running_loop(), self._on_timesync)
        # The time is taken in the reader thread: what comes after is ours and not the link's.
        self._stop = self._port.listen("TIMESYNC", lambda frame: answered(frame, time.monotonic_ns()))
        self._system_time.start()

    def close(self) -> None:
        self._system_time.close()
        if self._stop is not None:
            self._stop()

    def tick(self) -> None:
        """A few times a second."""
        now = time.monotonic_ns()
        if self._identity.source != self._source:
            self._source = self._identity.source
            self.clock.forget()
            self._there = now / 1e9
            self.gps_offset = None
        settling = bool(self._rtts) and not self.clock.settled
        if settling or not self._asked or now - self._asked[-1] >= (SETTLED_EVERY - 0.1) * 1e9:
            self._asked.append(now)
            self._unanswered = True
            self._port.send("TIMESYNC", tc1=0, ts1=now)

    @property
    def asking(self) -> bool:
        """An answer may come now. Any thread."""
        return self._unanswered and time.monotonic_ns() - self._asked[-1] < ANSWER * 1e9

    @property
    def lag(self) -> float:
        """s that the autopilot's own question may lie, by how often it asks: PX4, ten times a second, takes no answer
        after 10 ms, and a simulator in lock step waits for each. Any thread.
        """
        return self._between * OF_PERIOD if time.monotonic() - self._questioned < SILENT else math.inf

    def take_rtt(self) -> float | None:
        """The least round trip since the last call, in seconds; None: no answer came."""
        found = min(self._rtts, default=None)
        self._rtts.clear()
        return found

    def _on_timesync(self, frame: Frame, received: int) -> None:
        fields = decode(frame, self._port.dialect)
        sent = fields["ts1"]
        if (frame.sysid, frame.compid) != self._identity.source:
            return
        if fields["tc1"] == 0:
            # The autopilot asks for our time. A simulator in lock step waits for this: all it said before is heard.
            self._questioned, self._between = received / 1e9, received / 1e9 - self._questioned
            self._port.send("TIMESYNC", tc1=time.monotonic_ns(), ts1=sent)
            return
        if sent not in self._asked or self._identity.source != self._source:
            return  # an answer to somebody else, or to what was asked before we knew this autopilot
        self._unanswered = False
        self._rtts.append((received - sent) / 1e9)
        before, now = self.clock.boot, fields["tc1"] / 1e9
        verdict = self.clock.sample(sent / 1e9, received / 1e9, now)
        if sent / 1e9 - now > self._there and not self.clock.simulated:
            verdict = "restarted"  # it began after it was heard: no answer before is needed to see that
        self._there = received / 1e9
        if verdict in ("restarted", "behind"):
            self.gps_offset = None
            self.restarts += 1
            if verdict == "restarted":
                was = f"from {before:.1f} s " if before else ""
                text = f"the autopilot has restarted: its time went {was}to {now:.1f} s"
                self._events.emit("autopilot", "warning", text, limit="restart")
            else:
                text = f"the autopilot was silent, and its time went on by {now - before:.1f} s only, to {now:.1f} s"
                self._events.emit("autopilot", "notice", text, limit="restart")
            self._port.bus.tell(AutopilotRestarted())

    def _on_system_time(self, fields: Fields, frame: Frame) -> None:
        if fields["time_unix_usec"] < UNIX_TIME:
            return
        ours = self.clock.utc(fields["time_boot_ms"])
        if self.clock.simulated:
            self.gps_offset = None  # its days are longer or shorter than ours
            return
        if ours is None:
            return
        self.gps_offset = fields["time_unix_usec"] / 1e6 - ours.utc
        off = abs(self.gps_offset)
        if not self._wrong and off - ours.error > WRONG:
            self._wrong = True
            way = "behind" if self.gps_offset > 0 else "ahead of"
            text = f"this computer's clock is {off:.1f} s {way} GPS time: set it (NTP, or a clock chip)"
            self._events.emit("clock", "warning", text, gps_offset_s=self.gps_offset)
        elif self._wrong and off < RIGHT:
            self._wrong = False
            self._events.emit("clock", "info", "this computer's clock agrees with GPS time", gps_offset_s=off)

    def stamp(self, fields: dict[str, object]) -> tuple[float | None, float | None]:
        """(UTC seconds, error in seconds) of a message with these fields, by its own time; None where it has none, or
        it cannot be told. A UTC of the autopilot's own is taken as it is: it has no error of our making.
        """
        boot_ms, usec = fields.get("time_boot_ms"), fields.get("time_usec")
        if isinstance(usec, int) and usec >= UNIX_TIME:
            return usec / 1e6, None
        found = None
        if isinstance(boot_ms, int) and boot_ms > 0:
            found = self.clock.utc(boot_ms)
        elif isinstance(usec, int) and usec > 0:
            found = self.clock.at(usec / 1e6)
        return (found.utc, found.error) if found else (None, None)

    def info(self) -> wire.ClockInfo | None:
        """For VehicleState; None until the clock has settled."""
        boot = self.clock.at(0.0)
        now = self.clock.at(self.clock.boot)
        if boot is None or now is None:
            return None
        return wire.ClockInfo(
            boot_t=boot.utc, error_s=now.error, drift_ppm=self.clock.drift * 1e6, gps_offset_s=self.gps_offset
        )
