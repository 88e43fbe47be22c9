"""Where a router with credentials has a unix socket for programs of its own computer, and where those look for it.

Anyone who may write to the socket may say what the host itself may: the folder's owner and group decide. Plain TCP on
loopback, open to every program of the computer, gets less (:mod:`mesh.credentials.acl`).
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

VARIABLE = "ZMAV_RUN"
"""environment variable: the only folder that is looked at"""
SYSTEM = Path("/run/zmav")
PROTOCOL = "unixsock-stream"
LONGEST = 100
"""bytes of a socket's path: the kernel takes 107, and Zenoh's lock beside it has a longer name"""


def socket_to_listen(port: int) -> str | None:
    """The endpoint of the router whose TCP port on loopback is ``port``; None where no folder can be written."""
    for folder in _folders():
        there = folder if folder.exists() else folder.parent
        if os.access(there, os.W_OK | os.X_OK) and len(os.fsencode(_path(folder, port))) <= LONGEST:
            return f"{PROTOCOL}/{_path(folder, port)}"
    return None


def sockets_to_call(port: int) -> list[str]:
    """The endpoints of that router's sockets which are there and which we may use."""
    paths = (_path(folder, port) for folder in _folders())
    return [f"{PROTOCOL}/{path}" for path in paths if os.access(path, os.R_OK | os.W_OK)]


def is_held(path: Path) -> bool:
    """Another process listens there: Zenoh locks a file beside the socket."""
    try:
        with path.with_name(f"{path.name}.lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def path_of(endpoint: str) -> Path | None:
    """The file of a unix socket's endpoint; None: another kind."""
    protocol, _, path = endpoint.partition("/")
    return Path(path) if protocol == PROTOCOL else None


def _folders() -> Iterator[Path]:
    named, users = os.environ.get(VARIABLE), os.environ.get("XDG_RUNTIME_DIR")
    if named:
        yield Path(named)
        return
    yield SYSTEM
    if users:
        yield Path(users) / "zmav"


def _path(folder: Path, port: int) -> Path:
    return folder / f"{port}.sock"
