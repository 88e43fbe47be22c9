"""What a simulated ArduPilot writes into its log while it is armed."""

from __future__ import annotations

import math
from collections.abc import Callable

from zmav import rotation
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.dataflash import DataflashWriter, Layout
from zmav.sim.protocol.logs import MOST_ONE, Log, LogStore
from zmav.sim.protocol.part import Part

ATTITUDE_S = 0.1
POSITION_S = 0.2
GPS_EPOCH_S = 315964800
WEEK_S = 604800
LEAP_S = 18
"""seconds that GPS time is ahead of UTC, since 2017"""
LAYOUTS = (
    Layout("PARM", "QNff", "TimeUS,Name,Value,Default", "s---", "F---"),
    Layout("MSG", "QZ", "TimeUS,Message", "s-", "F-"),
    Layout("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---"),
    Layout("ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method", "s----", "F----"),
    Layout("ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF", "sddddhh-", "F000000-"),
    Layout(
        "GPS",
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
        "s#-s-S-DUmnhnh-",
        "F--C-0BGGB000--",
    ),
    Layout("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "sDUmmm", "FGG000"),
    Layout("BAT", "QBfff", "TimeUS,Inst,Volt,Curr,CurrTot", "s#vAa", "F-00C"),
)
EKF3 = 3
"""the estimator that the attitude is from"""


class FlightLog(Part):
    """Begins a log when the vehicle is armed and ends it when it is disarmed. ``unix_us``: UTC as the GPS tells it."""

    def __init__(self, vehicle: ArduVehicle, store: LogStore, unix_us: Callable[[], int]) -> None:
        self._vehicle, self._store, self._unix_us = vehicle, store, unix_us
        self._writer: DataflashWriter | None = None
        self._log: Log | None = None
        self._mode = -1
        self._next_attitude = self._next_position = 0.0

    @property
    def _time_us(self) -> int:
        return int(self._vehicle.uptime * 1e6)

    def tick(self, now: float) -> None:
        if not self._vehicle.armed:
            if self._writer is not None:
                self._end()
            return
        writer = self._writer or self._begin(now)
        if self._vehicle.mode.number != self._mode:
            self._mode = self._vehicle.mode.number
            writer.write("MODE", self._time_us, self._mode, self._mode, 0)
        if now >= self._next_attitude:
            self._next_attitude += ATTITUDE_S
            s = self._vehicle.sense
            want_roll, want_pitch, _ = rotation.euler((s.want_qw, s.want_qx, s.want_qy, s.want_qz))
            tilt = map(math.degrees, (want_roll, s.roll, want_pitch, s.pitch))
            yaws = (math.degrees(yaw) % 360.0 for yaw in (s.want_yaw, s.yaw))
            writer.write("ATT", self._time_us, *tilt, *yaws, EKF3)
        if now >= self._next_position:
            self._next_position += POSITION_S
            self._write_position(writer)
            self._touch()

    def message(self, text: str) -> None:
        """A text that the vehicle said."""
        if self._writer is not None:
            self._writer.write("MSG", self._time_us, text)

    def _begin(self, now: float) -> DataflashWriter:
        writer = DataflashWriter(LAYOUTS, self._time_us, MOST_ONE)
        self._writer, self._log = writer, self._store.begin(writer.data, self._unix_us() / 1e6)
        self._mode, self._next_attitude, self._next_position = -1, now, now
        writer.write("MSG", self._time_us, f"{self._vehicle.FIRMWARE} V4.7.0-dev")
        params = self._vehicle.params
        for name in params.names:
            writer.write("PARM", self._time_us, name, params[name], math.nan)
        writer.write("ARM", self._time_us, 1, 0, 0, 0)
        return writer

    def _end(self) -> None:
        assert self._writer is not None
        self._writer.write("ARM", self._time_us, 0, 0, 0, 0)
        self._touch()
        self._writer = self._log = None

    def _touch(self) -> None:
        if self._log is not None:
            self._log.end_s = self._unix_us() / 1e6

    def _write_position(self, writer: DataflashWriter) -> None:
        vehicle, s = self._vehicle, self._vehicle.sense
        here, home = vehicle.position, vehicle.place(vehicle.home_world)
        gps_s = max(self._unix_us() / 1e6 - GPS_EPOCH_S + LEAP_S, 0.0)  # a simulated clock may start before GPS did
        course = math.degrees(math.atan2(s.ve, s.vn)) % 360.0
        solution = (0, 6, int(gps_s % WEEK_S * 1000.0), int(gps_s // WEEK_S), 10, 1.21)
        place = (here.lat_deg, here.lon_deg, here.alt_amsl_m)
        writer.write("GPS", self._time_us, *solution, *place, math.hypot(s.vn, s.ve), course, s.vd, 0.0, 1)
        above = here.alt_amsl_m - home.alt_amsl_m
        writer.write("POS", self._time_us, *place, above, above)
        writer.write("BAT", self._time_us, 0, vehicle.voltage, s.current_a, vehicle.consumed_mah)
