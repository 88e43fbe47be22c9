"""The storage of a simulated ArduPilot: its files, its logs, and its parameters as a file."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import parse_qsl

from zmav.mavlink.ftp import MOST_DATA, Nak
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.protocol.ardupilot.flightlog import FlightLog
from zmav.sim.protocol.filesystem import FileError, FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.logs import LogProtocol, LogStore
from zmav.sim.protocol.params import ParamStore
from zmav.sim.protocol.part import Part

LOGS = "/APM/LOGS"
GUESS = 12
"""bytes a parameter that ArduPilot says the file of parameters has, before it is made"""


class Storage:
    """What one vehicle keeps. ``parts`` are what its node offers of it."""

    def __init__(self, vehicle: ArduVehicle, unix_us: Callable[[], int]) -> None:
        self.logs = LogStore()
        self.flight_log = FlightLog(vehicle, self.logs, unix_us)
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
