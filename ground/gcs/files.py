"""ArduPilot's parameter file, answered in the vehicles' place: QGroundControl fetches it instead of the list.

``@PARAM/param.pck`` by MAVFTP (https://mavlink.io/en/services/ftp.html) is made of the copy that lists are answered
from. Whatever else is asked of the file server passes to the autopilot, also the same file with its defaults
(``?withdefaults=1``: MAVProxy and Mission Planner), which no cache holds.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from ground.gcs.answerer import Answerer, GcsClient, Ground
from ground.gcs.params import Params, System
from ground.gcs.request_handlers import HandlersByClient, RequestHandlers
from ground.gcs.target import is_for_autopilots, vehicles
from zmav.errors import ZmavError
from zmav.mavlink import Frame, decode, paramvalue, targets
from zmav.mavlink.ftp import MOST_DATA, Nak, Op, Packet, pack, unpack
from zmav.mavlink.packed_params import PATH, PackedParam, pack_params

TYPES = frozenset({"INT8", "INT16", "INT32", "REAL32"})
"""the file can hold no others"""
READING = frozenset({Op.READ_FILE, Op.BURST_READ_FILE})
OURS = READING | {Op.TERMINATE_SESSION}


@dataclass
class Opened:
    """The file as a client reads it; laid out for the size of its reads once that is known."""

    session: int
    rows: list[PackedParam]
    read_size: int = 0
    data: bytes = b""

    def part(self, offset: int, size: int) -> bytes:
        if size != self.read_size:
            self.read_size, self.data = size, pack_params(self.rows, read_size=size)
        return self.data[offset : offset + size]


class Files(Answerer):
    takes = frozenset({"FILE_TRANSFER_PROTOCOL"})

    def __init__(self, ground: Ground, by_client: HandlersByClient, params: Params) -> None:
        self._ground, self._by_client, self._params = ground, by_client, params
        self._sessions: dict[tuple[GcsClient, int], int] = {}
        """whose reads are ours: session numbers by client and system"""
        self._open: dict[tuple[RequestHandlers, int], Opened] = {}
        by_client.forget.append(self._forget)

    # On the carrying threads.

    def offer(self, client: GcsClient, frame: Frame) -> bool:
        system, _ = targets(frame, self._ground.dialect)
        if not system or not is_for_autopilots(self._ground, client, frame):
            return False
        packet, key = unpack(decode(frame, self._ground.dialect)["payload"]), (client, system)
        if packet.opcode == Op.OPEN_FILE_RO and packet.data.rstrip(b"\0") == PATH.encode():
            (_, vehicle), *_ = vehicles(self._ground, client, frame)
            state = vehicle.last_state
            if state is None or state.autopilot != "ardupilot":
                return False
            self._sessions[key] = packet.session
        elif self._sessions.get(key) != packet.session or packet.opcode not in OURS:
            self._sessions.pop(key, None)  # it is at something else: that is between it and the autopilot
            return False
        self._by_client.of(client).ask(self._serve, frame)
        return True

    def left(self, client: GcsClient) -> None:
        for key in [key for key in list(self._sessions) if key[0] is client]:
            self._sessions.pop(key, None)

    # From here on: on the event loop.

    def _forget(self, handlers: RequestHandlers) -> None:
        self._open = {key: opened for key, opened in self._open.items() if key[0] is not handlers}

    def _serve(self, handlers: RequestHandlers, frame: Frame) -> None:
        packet = unpack(decode(frame, self._ground.dialect)["payload"])
        for system in self._params.meant(handlers, frame):
            key = handlers, system.sysid
            opened = self._open.get(key)
            if packet.opcode == Op.OPEN_FILE_RO:
                self._params.in_background(self._begin(handlers, frame, system, packet))
            elif packet.opcode == Op.TERMINATE_SESSION:
                self._open.pop(key, None)
                handlers.forget((Files, system.sysid))
                self._sessions.pop((handlers.client, system.sysid), None)
                self._answer(handlers, frame, system, packet, Op.ACK)
            elif opened is None:
                self._answer(handlers, frame, system, packet, Op.NAK, bytes((Nak.INVALID_SESSION,)))
            elif packet.opcode == Op.READ_FILE:
                self._read(handlers, frame, system, packet, opened)
            else:
                self._burst(handlers, frame, system, packet, opened)

    async def _begin(self, handlers: RequestHandlers, frame: Frame, system: System, packet: Packet) -> None:
        """Open the file, once the set is known; where it cannot be had in a file, let the autopilot do it."""
        try:
            await system.copy.refresh()
        except ZmavError:
            self._answer(handlers, frame, system, packet, Op.NAK, bytes((Nak.FAIL,)))
            return
        params = [param for name in system.copy.names if (param := system.copy.param(name)) is not None]
        if any(param.type not in TYPES for param in params):
            self._sessions.pop((handlers.client, system.sysid), None)
            self._ground.put(handlers.client, frame)
            return
        rows = [
            PackedParam(p.name, math.nan if p.value is None else p.value, paramvalue.type_number(p.type))
            for p in params
        ]
        opened = self._open[handlers, system.sysid] = Opened(packet.session, rows)
        opened.part(0, MOST_DATA)
        self._answer(handlers, frame, system, packet, Op.ACK, struct.pack("<I", len(opened.data)))

    def _read(self, handlers: RequestHandlers, frame: Frame, system: System, packet: Packet, opened: Opened) -> None:
        data = opened.part(packet.offset, _size(packet))
        if data:
            self._answer(handlers, frame, system, packet, Op.ACK, data)
        else:
            self._answer(handlers, frame, system, packet, Op.NAK, bytes((Nak.EOF,)))

    def _burst(self, handlers: RequestHandlers, frame: Frame, system: System, packet: Packet, opened: Opened) -> None:
        """All that is left of it, in turns with the client's other lists."""
        size = _size(packet)
        if not opened.part(packet.offset, size):
            self._read(handlers, frame, system, packet, opened)
            return
        offsets = range(packet.offset, len(opened.data), size)

        def part(offset: str) -> bytes:
            place = int(offset)
            number = packet.seq + 1 + (place - packet.offset) // size
            said = Packet(
                number, packet.session, Op.ACK, 0, packet.opcode, place == offsets[-1], place, opened.part(place, size)
            )
            return self._frame(frame, system, said)

        handlers.owe((Files, system.sysid), map(str, offsets), part)

    # Answers.

    def _answer(
        self, handlers: RequestHandlers, frame: Frame, system: System, asked: Packet, op: Op, data: bytes = b""
    ) -> None:
        said = Packet(asked.seq + 1, asked.session, op, 0, asked.opcode, False, asked.offset, data)
        handlers.answer(self._frame(frame, system, said))

    def _frame(self, asker: Frame, system: System, packet: Packet) -> bytes:
        payload = pack(packet._replace(size=len(packet.data)))
        return self._ground.pack(
            system.sysid,
            self._ground.component(system.sysid),
            "FILE_TRANSFER_PROTOCOL",
            target_network=0,
            target_system=asker.sysid,
            target_component=asker.compid,
            payload=payload,
        )


def _size(packet: Packet) -> int:
    """Of a read."""
    return min(packet.size, MOST_DATA) or MOST_DATA
