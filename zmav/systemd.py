"""What systemd is told by a program that it started with ``Type=notify``; without systemd, nobody is told anything.

The protocol is sd_notify(3): datagrams of ``NAME=VALUE`` lines to the socket that ``$NOTIFY_SOCKET`` names, a path or,
where it begins with ``@``, a name in Linux's abstract namespace.
"""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

RUNS = Path("/run/systemd/system")
"""sd_booted(3): the directory is there where systemd is the system's first process"""


def runs() -> bool:
    """Whether systemd looks after this computer's services."""
    return RUNS.is_dir()


def state_directory() -> Path | None:
    """Where a service keeps what it is to know when it starts again (``StateDirectory=``); None: it is no service."""
    found = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(found) if found else None


def journals() -> bool:
    """Whether standard error goes into the journal, as systemd.exec(5) has it told: ``$JOURNAL_STREAM`` is inherited by
    programs whose output goes elsewhere, too.
    """
    with contextlib.suppress(OSError):
        found = os.fstat(2)
        return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
    return False


def notify(*lines: str) -> bool:
    """Tell it ``lines``: ``READY=1``, ``STATUS=...``, ``WATCHDOG=1``, ``STOPPING=1``. Any thread; it never waits.

    False where nobody listens: no ``$NOTIFY_SOCKET``, or one whose reader is gone or busy. That is no fault of ours.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    text = "\n".join(line.replace("\n", " ") for line in lines)
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        out.sendto(text.encode("utf-8", errors="replace"), address)
        return True
    return False
