"""The payload of FILE_TRANSFER_PROTOCOL, which both ends of MAVFTP share: https://mavlink.io/en/services/ftp.html"""

from __future__ import annotations

import enum
import os
import posixpath
import re
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from zmav.errors import BadInput

_HEADER = struct.Struct("<HBBBBBxI")
"""seq_number, session, opcode, size, req_opcode, burst_complete, padding, offset"""
PAYLOAD = 251
MOST_DATA = PAYLOAD - _HEADER.size
"""239: bytes of data that one packet holds"""


LONGEST_SIZE = 16
"""digits of a file's size, in a directory: more bytes no disk has"""


class Op(enum.IntEnum):
    """Opcodes. An answer is ACK or NAK; it names the request in ``req_opcode``."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    REMOVE_DIRECTORY = 10
    OPEN_FILE_WO = 11
    TRUNCATE_FILE = 12
    RENAME = 13
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


_WRITING = frozenset(
    {
        Op.CREATE_FILE,
        Op.REMOVE_FILE,
        Op.CREATE_DIRECTORY,
        Op.REMOVE_DIRECTORY,
        Op.OPEN_FILE_WO,
        Op.TRUNCATE_FILE,
        Op.RENAME,
    }
)
"""requests that change what they name. WRITE_FILE names a session: what has opened that is judged"""
_KEPT = re.compile(
    r"/fs/mtd.*|(/fs/microsd)?/(dataman|params|eeprom(/.*)?|param[^/]*\.bs[^/]*)"
    r"|.*\.stg|/apm/strg_bak/.*|/eeprom\.bin"
)
"""where PX4 keeps missions, fences and rally points (dataman; some boards: mtd_waypoints) and parameters (mtd_params,
params, parameters.bson, in older simulators eeprom/parameters) with their backups: on a board's card and flash, and at
the root of a simulated one. In lower case: the card's FAT makes no difference. Sources: PX4 1.16, dataman.cpp
(PX4_STORAGEDIR), ROMFS/px4fmu_common/init.d/rcS and init.d-posix/rcS (param select, param select-backup). And where
ArduPilot does on a card (HAL_STORAGE_FILE, AP_MISSION_SDCARD_FILENAME), their backups, and a simulated one's storage
"""


class Nak(enum.IntEnum):
    """Why a request failed: the first data byte of a NAK."""

    NONE = 0
    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    EOF = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


_WORDS = {
    Nak.FAIL: "it failed, for a reason the autopilot does not give",
    Nak.INVALID_DATA_SIZE: "the autopilot does not take so much or so little data",
    Nak.INVALID_SESSION: "another client is using the autopilot's file server",
    Nak.NO_SESSIONS_AVAILABLE: "another client is using the autopilot's file server",
    Nak.EOF: "there is no more",
    Nak.UNKNOWN_COMMAND: "the autopilot's file server cannot do that",
    Nak.FILE_EXISTS: "it exists already",
    Nak.FILE_PROTECTED: "it is write-protected",
    Nak.FILE_NOT_FOUND: "there is no such file or directory",
}


class Packet(NamedTuple):
    """One request or answer. ``size`` differs from ``len(data)`` only in reads, where it is the number asked for."""

    seq: int
    session: int
    opcode: int
    size: int = 0
    req_opcode: int = 0
    burst_complete: bool = False
    offset: int = 0
    data: bytes = b""

    @property
    def nak(self) -> Nak | None:
        """Why it failed; None: it did not. Codes of later protocols count as a plain failure."""
        if self.opcode != Op.NAK:
            return None
        code = self.data[0] if self.data else 0
        return Nak(code) if Nak.NONE < code <= Nak.FILE_NOT_FOUND else Nak.FAIL

    @property
    def errno(self) -> int | None:
        """The autopilot's errno of a FAIL_ERRNO."""
        return self.data[1] if self.nak is Nak.FAIL_ERRNO and len(self.data) > 1 else None

    @property
    def reason(self) -> str:
        """The NAK in words."""
        if self.errno is not None:
            return os.strerror(self.errno).lower()
        return _WORDS.get(self.nak or Nak.FAIL, _WORDS[Nak.FAIL])


def pack(packet: Packet) -> bytes:
    """The message's payload field; zeros at its end are left to who encodes the message."""
    head = packet._replace(seq=packet.seq & 0xFFFF)[:-1]
    return _HEADER.pack(*head) + packet.data


def unpack(payload: bytes | Sequence[int]) -> Packet:
    """A payload field, or what is left of it without zeros at its end; its data is cut to its own size.

    A request for a read has no data, and a ``size`` of up to 255.
    """
    whole = bytes(payload).ljust(PAYLOAD, b"\0")
    seq, session, opcode, size, req_opcode, burst_complete, offset = _HEADER.unpack_from(whole)
    data = whole[_HEADER.size : _HEADER.size + size]
    return Packet(seq, session, opcode, size, req_opcode, bool(burst_complete), offset, data)


def is_generated(path: str) -> bool:
    """An ArduPilot file that is made as it is read (``@PARAM/param.pck``). Its size is a guess, and it is laid out for
    reads of one size: its checksum is that of other reads than ours.
    """
    return path.lstrip("/").startswith("@") and not path.lstrip("/").startswith("@ROMFS")


def check_written(path: str) -> None:
    """Raise :class:`BadInput` where nobody may write ``path``, on whatever autopilot: ArduPilot takes what is written
    to a generated file for a plan or for parameters, and PX4 reads its own from files. Nobody would have judged them.
    """
    plain = posixpath.normpath("/" + path.lstrip("/"))
    if ".." in path.split("/"):  # a simulated PX4 follows it out of its own root, and back in
        what = "climbs, and what it leads to is not known here"
    elif is_generated(path) or is_generated(plain):  # ArduPilot looks at how a path begins, and normalises none
        what = "is no file on the autopilot's disk"
    elif _KEPT.fullmatch(plain.casefold().rstrip(". ")):
        what = "is where an autopilot keeps plans or parameters"
    else:
        return
    text = f"{path} {what}: mission_upload writes plans, and param_set parameters"
    raise BadInput(text, field="path", value=path, expected="another file")


def check_request(payload: bytes | Sequence[int]) -> None:
    """:func:`check_written` for all that a request would write, whatever size it says that its names have."""
    whole = bytes(payload)
    if unpack(whole).opcode in _WRITING:
        for name in whole[_HEADER.size :].split(b"\0"):  # RENAME has two
            check_written(name.decode("utf-8", "replace"))


class DirectoryEntry(NamedTuple):
    """A line of a directory; ``size`` is None for a directory."""

    name: str
    size: int | None


def pack_entry(entry: DirectoryEntry) -> bytes:
    """As a LIST_DIRECTORY answer holds it, with its end mark."""
    text = f"D{entry.name}" if entry.size is None else f"F{entry.name}\t{entry.size}"
    return text.encode("utf-8", "replace") + b"\0"


def unpack_entries(data: bytes) -> list[DirectoryEntry | None]:
    """The entries of a LIST_DIRECTORY answer; None stands for one that the server skipped, or that nobody can read."""
    return [_entry(part.decode("utf-8", "replace")) for part in data.split(b"\0") if part]


def _entry(text: str) -> DirectoryEntry | None:
    kind, rest = text[:1], text[1:]
    name, _, size = rest.partition("\t")
    if kind == "D":
        return DirectoryEntry(name, None)
    known = size.isdecimal() and len(size) < LONGEST_SIZE
    return DirectoryEntry(name, int(size) if known else 0) if kind == "F" else None


def crc32(data: bytes, crc: int = 0) -> int:
    """CALC_FILE_CRC32's: the usual polynomial, begun with 0 and not inverted at the end. ``crc``: of what precedes."""
    return zlib.crc32(data, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


def crc32_of_file(path: Path) -> int:
    """:func:`crc32` of a file on this machine."""
    crc = 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            crc = crc32(block, crc)
    return crc
