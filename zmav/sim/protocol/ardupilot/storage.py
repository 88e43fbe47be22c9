"""The storage of a simulated ArduPilot: its files, its logs, and its parameters as a file."""

from __future__ import annotations

import math
import re
import struct
from typing import NamedTuple
from urllib.parse import parse_qsl

from zmav.mavlink.ftp import MOST_DATA, Nak
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Part
from zmav.sim.protocol.filesystem import FileError, FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.logs import MOST_ONE, FlightLog, LogProtocol, LogStore
from zmav.sim.protocol.params import ParamStore

HEAD = b"\xa3\x95"
_CODES = {"B": "B", "Q": "Q", "f": "f", "n": "4s", "N": "16s", "Z": "64s"}
"""a field's letter -> struct's"""


class Layout(NamedTuple):
    """One kind of message: its type, a letter a field, and the fields' names."""

    number: int
    name: str
    letters: str
    labels: str

    @property
    def struct(self) -> struct.Struct:
        return struct.Struct("<2sB" + "".join(_CODES[letter] for letter in self.letters))


FORMAT = Layout(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
PARAMETER = Layout(129, "PARM", "QNff", "TimeUS,Name,Value,Default")
MESSAGE = Layout(130, "MSG", "QZ", "TimeUS,Message")


LOGS = "/APM/LOGS"
GUESS = 12
"""bytes a parameter that ArduPilot says the file of parameters has, before it is made"""


class DataflashLog(FlightLog):
    """What an ArduPilot writes while it is armed: its parameters, and what it says."""

    _writer: DataflashWriter

    def __init__(self, node: Node, vehicle: ArduVehicle, store: LogStore) -> None:
        super().__init__(node, store)
        self._vehicle = vehicle

    def say(self, severity: int, text: str) -> None:
        if self.running:
            self._writer.write(MESSAGE, self.time_us, text)

    def begin(self) -> bytearray:
        self._writer = DataflashWriter((PARAMETER, MESSAGE), MOST_ONE)
        self._writer.write(MESSAGE, self.time_us, f"{self._vehicle.FIRMWARE} V4.7.0-dev")
        params = self._vehicle.params
        for name in params.names:
            self._writer.write(PARAMETER, self.time_us, name, params[name], math.nan)
        return self._writer.data


class Storage:
    """What one vehicle keeps. ``parts`` are what its node offers of it."""

    def __init__(self, node: Node, vehicle: ArduVehicle) -> None:
        self.logs = LogStore()
        self.flight_log = DataflashLog(node, vehicle, self.logs)
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


class DataflashWriter:
    """A growing log of ``layouts``; ``data`` is always whole messages, and at most ``limit`` bytes.

    Every message is 0xA3 0x95, its type, and its fields; the FMT messages at the beginning say what each type holds:
    https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html
    """

    def __init__(self, layouts: tuple[Layout, ...], limit: int) -> None:
        self.data = bytearray()
        self.full = False
        self._limit = limit
        for layout in (FORMAT, *layouts):
            self.write(FORMAT, layout.number, layout.struct.size, layout.name, layout.letters, layout.labels)

    def write(self, layout: Layout, *values: float | str) -> None:
        """One message, its fields in order; nothing once the log is full."""
        form = layout.struct
        if self.full or len(self.data) + form.size > self._limit:
            self.full = True
            return
        packed = [re.sub(r"[^\x20-\x7e]", "?", each).encode() if isinstance(each, str) else each for each in values]
        self.data += form.pack(HEAD, layout.number, *packed)
