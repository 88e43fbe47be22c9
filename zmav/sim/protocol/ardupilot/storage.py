"""The storage of a simulated ArduPilot: its files, its logs, and its parameters as a file."""

from __future__ import annotations

import math
from collections.abc import Callable
from urllib.parse import parse_qsl

from zmav import rotation
from zmav.mavlink.ftp import MOST_DATA, Nak
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.dataflash import DataflashWriter, Layout
from zmav.sim.protocol.channel import Part
from zmav.sim.protocol.filesystem import FileError, FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.logs import MOST_ONE, FlightLog, LogProtocol, LogStore
from zmav.sim.protocol.params import ParamStore

LOGS = "/APM/LOGS"
GUESS = 12
"""bytes a parameter that ArduPilot says the file of parameters has, before it is made"""
GPS_EPOCH_S = 315964800
WEEK_S = 604800
LEAP_S = 18
"""seconds that GPS time is ahead of UTC, since 2017"""
LAYOUTS = (
    Layout("PARM", "QNff", "TimeUS,Name,Value,Default"),
    Layout("MSG", "QZ", "TimeUS,Message"),
    Layout("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    Layout("ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method"),
    Layout("ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    Layout("GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    Layout("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    Layout("BAT", "QBfff", "TimeUS,Inst,Volt,Curr,CurrTot"),
)
ATTITUDE_S, POSITION_S = 0.1, 0.2
EKF3 = 3
"""the estimator that the attitude is from"""


class DataflashLog(FlightLog):
    """What an ArduPilot writes while it is armed."""

    def __init__(self, vehicle: ArduVehicle, store: LogStore, unix_us: Callable[[], int]) -> None:
        super().__init__(vehicle, store, unix_us)
        self._ardu = vehicle
        self._mode = -1
        self._next_attitude = self._next_position = 0.0
        self._writer: DataflashWriter

    def _write(self, name: str, *values: float | str) -> None:
        self._writer.write(name, self.time_us, *values)

    def message(self, text: str) -> None:
        """A text that the vehicle said."""
        if self.running:
            self._write("MSG", text)

    def begin(self) -> bytearray:
        self._writer = DataflashWriter(LAYOUTS, MOST_ONE)
        self._mode = -1
        self._next_attitude = self._next_position = self._ardu.now
        self._write("MSG", f"{self._ardu.FIRMWARE} V4.7.0-dev")
        params = self._ardu.params
        for name in params.names:
            self._write("PARM", name, params[name], math.nan)
        self._write("ARM", 1, 0, 0, 0)
        return self._writer.data

    def end(self) -> None:
        self._write("ARM", 0, 0, 0, 0)

    def write(self, now: float) -> None:
        if self._ardu.mode.number != self._mode:
            self._mode = self._ardu.mode.number
            self._write("MODE", self._mode, self._mode, 0)
        if now >= self._next_attitude:
            self._next_attitude += ATTITUDE_S
            self._write_attitude()
        if now >= self._next_position:
            self._next_position += POSITION_S
            self._write_position()

    def _write_attitude(self) -> None:
        s = self._ardu.sense
        want_roll, want_pitch, _ = rotation.euler((s.want_qw, s.want_qx, s.want_qy, s.want_qz))
        tilt = map(math.degrees, (want_roll, s.roll, want_pitch, s.pitch))
        self._write("ATT", *tilt, *(math.degrees(yaw) % 360.0 for yaw in (s.want_yaw, s.yaw)), EKF3)

    def _write_position(self) -> None:
        vehicle, s = self._ardu, self._ardu.sense
        here, home = vehicle.position, vehicle.place(vehicle.home_world)
        gps_s = max(self.unix_us() / 1e6 - GPS_EPOCH_S + LEAP_S, 0.0)  # a simulated clock may start before GPS did
        course = math.degrees(math.atan2(s.ve, s.vn)) % 360.0
        solution = (0, 6, int(gps_s % WEEK_S * 1000.0), int(gps_s // WEEK_S), 10, 1.21)
        place = (here.lat_deg, here.lon_deg, here.alt_amsl_m)
        self._write("GPS", *solution, *place, math.hypot(s.vn, s.ve), course, s.vd, 0.0, 1)
        above = here.alt_amsl_m - home.alt_amsl_m
        self._write("POS", *place, above, above)
        self._write("BAT", 0, vehicle.voltage, s.current_a, vehicle.consumed_mah)


class Storage:
    """What one vehicle keeps. ``parts`` are what its node offers of it."""

    def __init__(self, vehicle: ArduVehicle, unix_us: Callable[[], int]) -> None:
        self.logs = LogStore()
        self.flight_log = DataflashLog(vehicle, self.logs, unix_us)
        self.files = FileSystem(LOGS, "/APM/scripts", "/APM/terrain")
        self.files.attach(LOGS, self.logs.files, self.logs.remove)
        params = vehicle.params
        self.files.generate(PATH, lambda query, size: _packed(params, query, size), lambda: len(params) * GUESS)
        self.ftp = FtpServer(self.files)
        self.protocol = LogProtocol(self.logs, lambda: vehicle.armed)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.flight_log, self.protocol, self.ftp


def _packed(params: ParamStore, query: str, read_size: int) -> bytes:
    """``start`` and ``count`` choose among the parameters, as in ArduPilot; defaults are not told."""
    asked = dict(parse_qsl(query))
    if not all(value.isdecimal() for value in asked.values()):
        raise FileError(Nak.FAIL_ERRNO, 22)
    start, count = int(asked.get("start", 0)), int(asked.get("count", 0))
    names = params.names[start : start + count] if count else params.names[start:]
    rows = [PackedParam(name, params[name], params.type_of(name)) for name in names]
    return pack_params(rows, len(params), read_size or MOST_DATA)
