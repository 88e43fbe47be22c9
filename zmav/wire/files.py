"""Files and logs of an autopilot, and how their bytes cross the key space."""

from __future__ import annotations

from zmav.wire.base import Wire
from zmav.wire.orders import Order


class FileEntry(Wire, kw_only=True):
    """One line of a directory."""

    name: str
    size: int | None = None
    """bytes; None for a directory"""
    directory: bool = False


class LogEntry(Wire, kw_only=True):
    """One log on the autopilot. ``t``: UTC seconds of its end, None where the autopilot had no clock."""

    id: int
    size: int
    t: float | None = None


class FilePath(Order, kw_only=True):
    """A path on the autopilot (MAVFTP): ``do/file_list``, ``do/file_remove``, ``do/file_mkdir``, ``do/file_crc``."""

    path: str = "/"


class FileGet(Order, kw_only=True):
    """``do/file_get``: fetch a file to the vehicle's computer; it is then read from the key ``file/{result.file}``."""

    path: str


class FilePut(Order, kw_only=True):
    """``do/file_put``: write what was put in chunks on ``file/{file}`` to ``path`` on the autopilot."""

    path: str
    file: str
    size: int
    crc32: int


class LogList(Order, kw_only=True):
    """``do/log_list``."""


class LogGet(Order, kw_only=True):
    """``do/log_get``: fetch a log to the vehicle's computer; it is then read from the key ``file/{result.file}``."""

    log: int


class LogErase(Order, kw_only=True):
    """``do/log_erase``: all logs of the autopilot."""


class FileQuery(Wire, kw_only=True):
    """Payload of a query on ``file/{file}``: answered by chunks, each under ``file/{file}/{offset}``."""

    offset: int = 0
    length: int = 256_000
