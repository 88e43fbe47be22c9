"""The file server of a simulated autopilot, with ArduPilot's rules: https://mavlink.io/en/services/ftp.html

One session for all links. The client chooses its number; another one is refused with INVALID_SESSION until the first
has been idle for three seconds. A request that repeats the one answered last gets that answer again. A burst is at most
500 packets, and nothing else is answered while it lasts.
"""

from __future__ import annotations

import collections
import errno
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from zmav.mavlink.ftp import MOST_DATA, Nak, Op, Packet, crc32, pack, pack_entry, unpack
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender
from zmav.sim.protocol.filesystem import FileError, FileSystem, Readable

QUEUE = 5
"""requests that wait while another is served; more are lost"""
IDLE_S = 3.0
PER_TICK = 64
"""packets of a burst in one tick, where the link has room"""


@dataclass
class Open:
    """The open file; ``data`` is read when the first read says how large the reads are."""

    session: int
    path: str
    writing: bool
    data: Readable | None = None
    read_size: int = 0


class Request(NamedTuple):
    packet: Packet
    channel: Channel
    sender: Sender


@dataclass
class Burst:
    request: Request
    offset: int
    seq: int
    left: int


@dataclass
class FtpFaults:
    """What goes wrong on purpose: operations that are never answered, and those that are refused."""

    mute: set[Op] = field(default_factory=set)
    refuse: dict[Op, Nak] = field(default_factory=dict)


class FtpServer(Part):
    """Serves ``files`` to all who ask. ``session``: the only one there is (PX4's is 0); None: the client chooses."""

    BURST: ClassVar[int] = 500

    def __init__(self, files: FileSystem, session: int | None = None) -> None:
        self.files = files
        self.faults = FtpFaults()
        self._fixed = session
        self._open: Open | None = None
        self._used = 0.0
        self._now = 0.0
        self._queue: collections.deque[Request] = collections.deque()
        self._burst: Burst | None = None
        self._last: tuple[Sender, Packet] | None = None
        self._operations: dict[int, Callable[[Packet], tuple[bytes, int]]] = {
            Op.NONE: lambda p: (b"", 0),
            Op.TERMINATE_SESSION: self._reset,
            Op.RESET_SESSIONS: self._reset,
            Op.LIST_DIRECTORY: self._list,
            Op.OPEN_FILE_RO: self._open_read,
            Op.OPEN_FILE_WO: self._open_write,
            Op.CREATE_FILE: self._open_write,
            Op.READ_FILE: self._read,
            Op.WRITE_FILE: self._write,
            Op.CREATE_DIRECTORY: lambda p: self._change(p, self.files.mkdir),
            Op.REMOVE_DIRECTORY: lambda p: self._change(p, self.files.rmdir),
            Op.REMOVE_FILE: lambda p: self._change(p, self.files.remove),
            Op.RENAME: self._rename,
            Op.CALC_FILE_CRC32: self._crc,
        }

    @property
    def open_path(self) -> str | None:
        """The file that is open."""
        return None if self._open is None else self._open.path

    def answers(self) -> Mapping[str, Answer]:
        return {"FILE_TRANSFER_PROTOCOL": self._receive}

    @property
    def sending(self) -> bool:
        return self._burst is not None or bool(self._queue)

    def tick(self, now: float) -> None:
        self._now = now
        for _ in range(PER_TICK):
            if self._burst is None or not self._burst_on():
                break
        self._serve_waiting()

    def closed(self, channel: Channel) -> None:
        self._queue = collections.deque(r for r in self._queue if r.channel is not channel)
        if self._burst is not None and self._burst.request.channel is channel:
            self._burst = None

    # ---- requests

    def _receive(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        packet = unpack(msg["payload"])
        if packet.opcode in (Op.ACK, Op.NAK):
            return
        if len(self._queue) < QUEUE:
            self._queue.append(Request(packet, channel, sender))
        self._serve_waiting()

    def _serve_waiting(self) -> None:
        while self._queue and self._burst is None and self._queue[0].channel.has_room():
            self._serve(self._queue.popleft())

    def _serve(self, request: Request) -> None:
        packet = request.packet
        again = (request.sender, self._session(packet), (packet.seq + 1) & 0xFFFF)
        if self._last is not None and again == (self._last[0], self._last[1].session, self._last[1].seq):
            self._send(request, self._last[1])
            return
        if packet.opcode in self.faults.mute:
            return
        try:
            self._check(packet)
            if packet.opcode == Op.BURST_READ_FILE:
                self._begin_burst(request)
                return
            operation = self._operations.get(packet.opcode)
            if operation is None:
                raise FileError(Nak.FAIL if self._fixed is None else Nak.UNKNOWN_COMMAND)
            data, offset = operation(packet)
        except FileError as error:
            self._refuse(request, error)
        else:
            self._send(request, _answer(request, Op.ACK, data, offset, self._session(packet)))

    def _check(self, packet: Packet) -> None:
        if packet.opcode in self.faults.refuse:
            raise FileError(self.faults.refuse[Op(packet.opcode)])
        if packet.size > MOST_DATA:
            raise FileError(Nak.INVALID_DATA_SIZE)
        if self._open is None or self._fixed is not None or packet.session == self._open.session:
            return
        if packet.opcode in (Op.TERMINATE_SESSION, Op.RESET_SESSIONS):
            return
        if self._now - self._used < IDLE_S:
            raise FileError(Nak.INVALID_SESSION)
        self._close()

    def _close(self) -> None:
        if self._open is not None:
            path, self._open = self._open.path, None
            self.files.close(path)

    def _session(self, packet: Packet) -> int:
        return packet.session if self._fixed is None else self._fixed

    def _refuse(self, request: Request, error: FileError, seq: int | None = None, offset: int = 0) -> None:
        data = bytes((error.nak, error.number)) if error.number else bytes((error.nak,))
        packet = _answer(request, Op.NAK, data, offset, self._session(request.packet))
        self._send(request, packet if seq is None else packet._replace(seq=seq & 0xFFFF))

    def _send(self, request: Request, packet: Packet) -> None:
        self._used = self._now
        self._last = (request.sender, packet)
        system, component = request.sender
        request.channel.send(
            "FILE_TRANSFER_PROTOCOL", target_system=system, target_component=component, payload=pack(packet)
        )

    # ---- operations: each gives its answer's data and offset

    def _reset(self, packet: Packet) -> tuple[bytes, int]:
        if self._open is not None and (self._fixed is not None or packet.session == self._open.session):
            self._close()
        return b"", 0

    def _list(self, packet: Packet) -> tuple[bytes, int]:
        entries = self.files.list(_path(packet))[packet.offset :]
        data = b""
        for entry in entries:
            line = pack_entry(entry)
            if len(data) + len(line) > MOST_DATA:
                break
            data += line
        if not data:
            raise FileError(Nak.EOF)
        return data, packet.offset

    def _open_read(self, packet: Packet) -> tuple[bytes, int]:
        path = _path(packet)
        self._check_free()
        size = self.files.size(path)
        self._open = Open(self._session(packet), path, writing=False)
        return size.to_bytes(4, "little"), 0

    def _open_write(self, packet: Packet) -> tuple[bytes, int]:
        path = _path(packet)
        self._check_free()
        if packet.opcode == Op.CREATE_FILE or path.startswith("@"):
            self.files.create(path)
        else:
            self.files.size(path)
        self._open = Open(self._session(packet), path, writing=True)
        return b"", 0

    def _check_free(self) -> None:
        if self._open is not None:
            raise FileError(Nak.FAIL if self._fixed is None else Nak.NO_SESSIONS_AVAILABLE)

    def _bytes(self, packet: Packet, offset: int) -> bytes:
        """Bytes of the open file; none at its end."""
        file = self._open
        if file is None:
            raise FileError(Nak.FILE_NOT_FOUND if self._fixed is None else Nak.INVALID_SESSION)
        if file.writing:
            raise FileError(Nak.FAIL)
        size = packet.size or MOST_DATA
        if file.data is None:
            file.read_size, file.data = size, self.files.open(file.path, size)
        if file.path.startswith("@PARAM") and size != file.read_size:
            raise FileError(Nak.FAIL_ERRNO, errno.EINVAL)
        return file.data[offset : offset + size]

    def _read(self, packet: Packet) -> tuple[bytes, int]:
        data = self._bytes(packet, packet.offset)
        if not data:
            raise FileError(Nak.EOF)
        return data, packet.offset

    def _write(self, packet: Packet) -> tuple[bytes, int]:
        if self._open is None:
            raise FileError(Nak.FILE_NOT_FOUND)
        if not self._open.writing:
            raise FileError(Nak.FAIL)
        self.files.write(self._open.path, packet.offset, packet.data)
        return b"", packet.offset

    def _change(self, packet: Packet, change: Callable[[str], None]) -> tuple[bytes, int]:
        change(_path(packet))
        return b"", 0

    def _rename(self, packet: Packet) -> tuple[bytes, int]:
        old, end, new = packet.data.rstrip(b"\0").partition(b"\0")
        if not end or not new:
            raise FileError(Nak.INVALID_DATA_SIZE)
        self.files.rename(old.decode("utf-8", "replace"), new.decode("utf-8", "replace"))
        return b"", 0

    def _crc(self, packet: Packet) -> tuple[bytes, int]:
        path = _path(packet)
        if path.startswith("@"):
            raise FileError(Nak.FAIL)
        return crc32(self.files.open(path, MOST_DATA)[:]).to_bytes(4, "little"), 0

    # ---- bursts

    def _begin_burst(self, request: Request) -> None:
        self._bytes(request.packet, 0)  # or it is refused
        self._burst = Burst(request, request.packet.offset, request.packet.seq + 1, self.BURST)

    def _burst_on(self) -> bool:
        """The next packet of the burst; False where the link is full or the burst over."""
        burst = self._burst
        assert burst is not None
        request = burst.request
        if not request.channel.has_room(2):
            return False
        data = self._bytes(request.packet, burst.offset)
        if not data:
            self._burst = None
            self._refuse(request, FileError(Nak.EOF), burst.seq, burst.offset)
            return False
        burst.left -= 1
        short = len(data) < (request.packet.size or MOST_DATA)
        packet = _answer(request, Op.ACK, data, burst.offset, self._session(request.packet))
        self._send(request, packet._replace(seq=burst.seq & 0xFFFF, burst_complete=short or burst.left == 0))
        burst.offset, burst.seq = burst.offset + len(data), burst.seq + 1
        if burst.left == 0:
            self._burst = None
        return True


def _answer(request: Request, opcode: Op, data: bytes, offset: int, session: int) -> Packet:
    asked = request.packet
    seq = (asked.seq + 1) & 0xFFFF
    return Packet(seq, session, opcode, len(data), req_opcode=asked.opcode, offset=offset, data=data)


def _path(packet: Packet) -> str:
    """The path a request names; its size counts the name, with or without a NUL at its end."""
    name = packet.data.partition(b"\0")[0]
    if not name or packet.size - len(name) > 1:
        raise FileError(Nak.INVALID_DATA_SIZE)
    return name.decode("utf-8", "replace")
