"""Files and logs of an autopilot, and how their bytes cross the key space.

A file is fetched in two steps: an order (``do/file_get``, ``do/log_get``) brings it from the autopilot to the vehicle's
computer, whose answer is a :class:`StoredFile`; its bytes are then asked for on ``file/{file}/*`` as often as the
network needs. The other way an order (``do/file_put``) has the file in it. Checksums are MAVFTP's CRC-32
(:func:`zmav.mavlink.ftp.crc32`).
"""

from __future__ import annotations

from zmav.errors import BadInput
from zmav.wire.base import Told, Wire
from zmav.wire.orders import Order

CHUNK = 1100
"""bytes of one chunk at most: bulk goes best effort, and a larger sample would be cut up on the way"""
MOST_CHUNKS = 200
"""chunks in the answer to one query: more than 256 replies stop a session that asks itself"""
MOST_PUT = 1 << 20
"""bytes of a file that an order can have in it"""


class FileEntry(Told, kw_only=True):
    """One line of a directory."""

    name: str
    size: int | None = None
    """bytes; None for a directory"""
    directory: bool = False


class LogEntry(Told, kw_only=True):
    """One log on the autopilot. ``t``: UTC seconds of its end, None where the autopilot had no clock; ``name``: what to
    call it here.
    """

    id: int
    size: int
    t: float | None = None
    name: str = ""


class FilePath(Order, kw_only=True):
    """A path on the autopilot (MAVFTP): ``do/file_list``, ``file_remove``, ``file_mkdir``, ``file_rmdir``."""

    path: str = "/"


class FileGet(Order, kw_only=True):
    """``do/file_get``: fetch a file to the vehicle's computer. Its result is a :class:`StoredFile`."""

    path: str


class FilePut(Order, kw_only=True):
    """``do/file_put``: write ``data`` (base64 in JSON) to ``path`` on the autopilot. What an ArduPilot makes of its
    plans and parameters (``@MISSION/mission.dat``) is not written so: ``mission_upload`` and ``param_set`` do that.
    """

    path: str
    data: bytes

    def check(self) -> None:
        """Raise :class:`BadInput` for more than an order can have in it."""
        size = len(self.data)
        if size > MOST_PUT:
            text = f"{size} bytes are too many to be written at once; at most {MOST_PUT} are"
            raise BadInput(text, field="data", value=size, expected=f"at most {MOST_PUT} bytes")


class LogList(Order, kw_only=True):
    """``do/log_list``."""


class LogGet(Order, kw_only=True):
    """``do/log_get``: fetch a log to the vehicle's computer. Its result is a :class:`StoredFile`."""

    log: int


class LogErase(Order, kw_only=True):
    """``do/log_erase``: all logs of the autopilot."""


class StoredFile(Told, kw_only=True):
    """A file on the vehicle's computer; ``file`` is its part of the key.

    ``verified``: its checksum is the one the autopilot gave. ``by``: how it came; ``rate`` in bytes/s, and ``resumed``
    the bytes that were there before.
    """

    file: str
    path: str
    size: int
    crc32: int
    t: float
    verified: bool = False
    by: str = ""
    rate: float = 0.0
    resumed: int = 0


class FileQuery(Wire, kw_only=True):
    """Payload of a query on ``file/{file}/*``: answered by chunks, each under ``file/{file}/{offset}``.

    ``length`` bytes from ``offset``, or as many as :data:`MOST_CHUNKS` chunks hold.
    """

    offset: int = 0
    length: int = CHUNK * MOST_CHUNKS


def read_offset(text: str) -> int | None:
    """Where a chunk begins, by the last part of its key; None: that is no place in a file."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 12 else None
