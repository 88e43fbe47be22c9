"""The storage of a simulated ArduPilot: its files, its logs, and its parameters as a file."""

from __future__ import annotations

import functools
import math
import re
import struct
from typing import NamedTuple
from urllib.parse import parse_qsl

from zmav.mavlink import plan_file
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.ftp import MOST_DATA, Nak
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params
from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.items import FENCE, MISSION, RALLY, ItemStore
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Part
from zmav.sim.protocol.filesystem import FileError, FileSystem
from zmav.sim.protocol.ftp import FtpServer
from zmav.sim.protocol.items import item_fields, read_item
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


PLAN_GUESS = 1 << 20
"""bytes that ArduPilot says a plan's file has"""
NO_CLEAR = 1
"""of a plan's file that is written: its items are put among those that there are"""


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
        for store in (vehicle.mission, vehicle.fence.items, vehicle.rally):
            path = plan_file.PATH.format(store.title.lower())
            take = functools.partial(take_plan, store, node.dialect)
            self.files.generate(path, functools.partial(PlanFile, store, node.dialect), lambda: PLAN_GUESS, take)
        self.ftp = FtpServer(self.files)
        self.protocol = LogProtocol(self.logs, lambda: vehicle.armed)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.flight_log, self.protocol, self.ftp


class PlanFile:
    """A plan's items (a ``Readable``), each as it is when it is read; how many they are is told as it was at first.
    As a real one's it ends where an item cannot be read.
    """

    def __init__(self, store: ItemStore, dialect: Dialect, query: str, read_size: int) -> None:
        self._store, self._dialect, self._count = store, dialect, len(store)

    def __getitem__(self, part: slice) -> bytes:
        size = plan_file.size_of(1, self._dialect) - plan_file.HEADER.size
        at, end = (max(offset - plan_file.HEADER.size, 0) for offset in (part.start, part.stop))
        data = plan_file.pack_header(self._store.kind, self._count) if at == 0 else b""
        begins = 0 if at == 0 else plan_file.HEADER.size + at // size * size
        for seq in range(at // size, min(-(-end // size), len(self._store))):
            item = self._store.read(seq)
            if isinstance(item, MissionResult):
                break
            data += plan_file.pack_item(item_fields(item, self._store.kind), self._dialect)
        return data[part.start - begins : part.stop - begins]


def take_plan(store: ItemStore, dialect: Dialect, data: bytes) -> None:
    """What ArduPilot makes of a plan's file that was written, and nobody is told. The old mission is cleared, unless it
    is being flown, before the items of the new one are looked at; what stands before a bad one stays. So it is with
    rally points. A fence takes effect as a whole.
    """
    if len(data) < plan_file.HEADER.size:
        return
    magic, _, options, start, count = plan_file.HEADER.unpack_from(data)
    rows = plan_file.unpack_items(data, dialect)
    if magic != plan_file.MAGIC or len(rows) != count or not all(any(row.values()) for row in rows):
        return  # nothing but zeros is an item that was never written
    keep, first = options & NO_CLEAR, start if store.kind == MISSION else 0
    if store.kind == FENCE:
        if keep or store.open(count) is not MissionResult.ACCEPTED:
            return
    elif not keep:
        store.clear()
    elif store.kind == RALLY:
        return
    for seq, row in enumerate(rows[: store.most], first):
        item = read_item({**row, "seq": seq}, as_int=True)
        apart = store.kind == MISSION and seq > len(store)
        if isinstance(item, MissionResult) or apart or store.put(item, count - 1) is not MissionResult.ACCEPTED:
            if store.kind == FENCE:
                store.abandon()
                return
            break
    store.close()


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
