"""Talking to a lab that runs by its control socket: ``zmav lab cut 2-3`` and its like do, and so may scripts.

with Remote() as lab:
    lab.call("cut", link="2-3")

Each lab has a directory of its own in :func:`directory_of_labs`, and in it a Unix socket that only its owner may open.
It takes JSON, one request a line, as the simulator's does (:mod:`zmav.sim.remote`).
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from mesh.lab.status import LabStatus
from zmav import keys
from zmav.errors import BadConfig, LinkDown
from zmav.process import own_directory
from zmav.sim.remote import LONGEST_PATH, ControlClient, answers

SOCKET = "control.sock"
ANSWER_S = 30.0


def directory_of_labs() -> Path:
    """Where this user's labs have their directories; raises :class:`BadConfig` where nobody should."""
    return own_directory("zmav-lab", "set XDG_RUNTIME_DIR")


def running() -> list[str]:
    """The names of this user's labs that run now."""
    return [path.name for path in sorted(directory_of_labs().iterdir()) if answers(path / SOCKET)]


@contextlib.contextmanager
def claimed(name: str, patience: float = 10.0) -> Iterator[tuple[Path, int]]:
    """A directory, not made yet, for a lab called ``name``, which no other lab gets meanwhile.

    Also gives a descriptor: while any process has it open, the name is taken. The relay keeps it, because it outlives a
    lab that is killed, and removes that directory. :class:`BadConfig` where such a lab runs, or still ends after
    ``patience`` s, or the name cannot be one.
    """
    directory = directory_of_labs() / keys.check_name(name)
    if len(os.fsencode(directory / SOCKET)) > LONGEST_PATH:
        text = f"the path {directory / SOCKET} is too long for a socket; take a shorter name"
        raise BadConfig(text, field="name", value=name, expected=f"a path of at most {LONGEST_PATH} bytes")
    for other in running():
        if other != name:
            text = f"a lab {other!r} runs already, and there is one at a time: end it with 'zmav lab down'"
            raise BadConfig(text, field="name", value=name, expected="no other lab")
    with socket.socket(socket.AF_UNIX) as claim:
        end = time.monotonic() + patience
        while not _bound(claim, directory):
            if answers(directory / SOCKET) or time.monotonic() > end:
                text = f"a lab {name!r} runs already: end it with 'zmav lab down'"
                raise BadConfig(text, field="name", value=name, expected="a name that no other lab has")
            time.sleep(0.05)  # it begins, or ends
        shutil.rmtree(directory, ignore_errors=True)  # of one that was killed together with its relay
        yield directory, claim.fileno()


def _bound(claim: socket.socket, directory: Path) -> bool:
    try:
        claim.bind(b"\0" + os.fsencode(directory))  # a name without a file: the kernel forgets it with the last holder
    except OSError as e:
        if e.errno != errno.EADDRINUSE:
            raise
        return False
    return True


def _choose() -> Path:
    found = running()
    if not found:
        whose = "" if os.getuid() == 0 else f" as user {os.getuid()} (with sudo, as it was started?)"
        raise LinkDown(f"no lab runs{whose}: start one with 'sudo zmav lab up FILE'")
    return directory_of_labs() / found[0]


class Remote(ControlClient):
    """A connection to the lab that runs. Raises :class:`LinkDown` where none does, and what the lab says."""

    def __init__(self) -> None:
        self.directory = _choose()
        what = f"the lab {self.directory.name}"
        try:
            super().__init__(self.directory / SOCKET, what, ANSWER_S)
        except OSError as e:
            raise LinkDown(f"{what} has ended: {e.strerror}") from e

    def status(self) -> LabStatus:
        """Everything at this moment."""
        return msgspec.convert(self.call("status"), LabStatus)

    def wait(self) -> None:
        """Return when the lab has ended."""
        self._socket.settimeout(None)
        with contextlib.suppress(OSError):
            while self._socket.recv(4096):
                pass
