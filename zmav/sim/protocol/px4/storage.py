"""The storage of a simulated PX4: its files, and a ULog of every flight."""

from __future__ import annotations

from collections.abc import Callable

from zmav.sim.autopilots.px4 import event_words
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.protocol.filesystem import FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.logs import MOST_ONE, Log, LogStore
from zmav.sim.protocol.part import Part
from zmav.sim.protocol.px4.logs import Px4LogProtocol
from zmav.sim.ulog import Topic, UlogWriter

LOGS = "/log/sess001"
EXTRAS, WORDS = "/etc/extras", "all_events.json.xz"
ATTITUDE_S = 0.1
POSITION_S = 0.2
_REAL32 = 9  # MAV_PARAM_TYPE
TOPICS = (
    Topic("vehicle_attitude", tuple(("float", f"q{i}") for i in range(4))),
    Topic("vehicle_local_position", tuple(("float", name) for name in ("x", "y", "z", "vx", "vy", "vz"))),
    Topic("vehicle_status", (("uint8_t", "nav_state"), ("uint8_t", "arming_state"), ("uint8_t", "failsafe"))),
)
_DISARMED, _ARMED = 1, 2  # arming_state


class FlightLog(Part):
    """Begins a log when the vehicle is armed and ends it when it is disarmed. ``unix_us``: UTC as the GPS tells it."""

    def __init__(self, copter: Px4Copter, store: LogStore, unix_us: Callable[[], int]) -> None:
        self._copter, self._store, self._unix_us = copter, store, unix_us
        self._writer: UlogWriter | None = None
        self._log: Log | None = None
        self._status = (-1, -1, -1)
        self._next_attitude = self._next_position = 0.0

    @property
    def _time_us(self) -> int:
        return int(self._copter.uptime * 1e6)

    def tick(self, now: float) -> None:
        if not self._copter.armed:
            if self._writer is not None:
                self._write_status(self._writer)
                self._writer = self._log = None
            return
        writer = self._writer or self._begin(now)
        self._write_status(writer)
        s = self._copter.sense
        if now >= self._next_attitude:
            self._next_attitude += ATTITUDE_S
            writer.write("vehicle_attitude", self._time_us, s.qw, s.qx, s.qy, s.qz)
        if now >= self._next_position:
            self._next_position += POSITION_S
            writer.write("vehicle_local_position", self._time_us, *self._copter.local, s.vn, s.ve, s.vd)
            if self._log is not None:
                self._log.end_s = self._unix_us() / 1e6

    def say(self, severity: int, text: str) -> None:
        """A text that the vehicle said."""
        if self._writer is not None:
            self._writer.text(severity, self._time_us, text)

    def _begin(self, now: float) -> UlogWriter:
        params = self._copter.params
        values = {name: params[name] if params.type_of(name) == _REAL32 else int(params[name]) for name in params.names}
        info = {"sys_name": "PX4", "ver_hw": "PX4_SITL", "ver_sw": "zmav-sim"}
        writer = UlogWriter(TOPICS, self._time_us, MOST_ONE, info=info, params=values)
        self._writer, self._log = writer, self._store.begin(writer.data, self._unix_us() / 1e6)
        if self._log is not None:
            self._copter.say(6, f"[logger] .{LOGS}/{_name(self._log)}\t")
        self._status, self._next_attitude, self._next_position = (-1, -1, -1), now, now
        return writer

    def _write_status(self, writer: UlogWriter) -> None:
        copter = self._copter
        status = (copter.mode.number, _ARMED if copter.armed else _DISARMED, int(copter.failsafe.active))
        if status != self._status:
            self._status = status
            writer.write("vehicle_status", self._time_us, *status)


class Px4Storage:
    """What one vehicle keeps. ``parts`` are what its node offers of it."""

    def __init__(self, copter: Px4Copter, unix_us: Callable[[], int]) -> None:
        self.logs = LogStore()
        self.flight_log = FlightLog(copter, self.logs, unix_us)
        self.files = FileSystem(LOGS, EXTRAS)
        self.files.attach(LOGS, self._files, self._remove)
        self.files.attach(EXTRAS, lambda: {WORDS: event_words.packed()}, lambda name: False)
        self.ftp = FtpServer(self.files, session=0)
        self.protocol = Px4LogProtocol(self.logs)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.flight_log, self.protocol, self.ftp

    def _files(self) -> dict[str, bytes]:
        return {_name(log): bytes(log.data) for log in self.logs.logs}

    def _remove(self, name: str) -> bool:
        return any(self.logs.remove(log.name) for log in self.logs.logs if _name(log) == name)


def _name(log: Log) -> str:
    return f"log{99 + log.number}.ulg"
