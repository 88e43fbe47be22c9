"""Pseudo-terminals: a vehicle as a serial autopilot, which speaks whether anybody listens or not.

While no program has the terminal open, what the vehicle says is lost, as on a line that leads nowhere; who opens it
hears only what is said from then on. See pty(7).
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import tty
from pathlib import Path

from zmav.errors import BadUrl, PortInUse
from zmav.sim.endpoints.address import Address
from zmav.sim.endpoints.base import BACKLOG_BYTES, ByteLine, Switchboard, Wiring

USUAL_BAUD = 115200
LOOK_EVERY = 10  # ticks, for somebody who opens the terminal


class PtyEndpoint:
    """One pseudo-terminal. ``address.path``: a symbolic link to it."""

    def __init__(self, address: Address, vehicle: Switchboard, wiring: Wiring) -> None:
        self.link = address.kind
        self._vehicle = vehicle
        self._wiring = wiring
        self._line: ByteLine | None = None  # to who has it open
        self._look_in = 0
        self._master, slave = os.openpty()
        try:
            tty.setraw(slave)  # or it would echo
            os.set_blocking(self._master, False)
            self.device = os.ttyname(slave)
            self._link = _link(Path(address.path), self.device) if address.path else None
        except BaseException:
            os.close(self._master)
            raise
        finally:
            os.close(slave)  # held open here, nobody could tell whether a client is there
        self._hangup = select.poll()
        self._hangup.register(self._master, 0)
        self.url = f"{self._link or self.device},{USUAL_BAUD}"
        self._channel = vehicle.open_channel(self, self.link)
        wiring.waiting.add(self)

    def clients(self) -> int:
        return int(self._line is not None)

    def room(self) -> int:
        return BACKLOG_BYTES if self._line is None else self._line.room()

    def put(self, frame: bytes) -> None:
        if self._line is not None:  # else nobody can hear it
            self._line.put(frame)
            self._wiring.waiting.add(self)

    def flush(self) -> bool:
        """Send what there is; look whether somebody has opened it."""
        if self._line is None:
            self._look_in -= 1
            if self._look_in < 0:
                self._look_in = LOOK_EVERY
                if not self._hangup.poll(0):
                    # A descriptor of its own, which the line closes; the terminal stays for the next one. Where no
                    # descriptor is left it looks again.
                    with contextlib.suppress(OSError):
                        self._line = ByteLine(os.dup(self._master), self._wiring.selector, self._hear, self._detach)
            return False
        sent = self._line.flush()
        return sent and self._line is not None

    def _hear(self, data: bytes) -> None:
        self._vehicle.receive(self._channel, data)
        self.flush()

    def _detach(self, why: str) -> None:
        """The client has closed the terminal: what it did not read is not for the next one."""
        self._line = None
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)
        self._wiring.waiting.add(self)

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
        self._wiring.waiting.discard(self)
        if self._link is not None:
            with contextlib.suppress(OSError):
                if str(self._link.readlink()) == self.device:
                    self._link.unlink()
        os.close(self._master)
        self._vehicle.close_channel(self._channel)


def _link(path: Path, device: str) -> Path:
    """Make ``path`` lead to ``device``; replaces a link that leads nowhere any more, or to a terminal of that name
    which is gone: terminals' numbers are given out again.
    """
    try:
        if path.is_symlink() and (not path.exists() or str(path.readlink()) == device):
            path.unlink()
        path.symlink_to(device)
        return path
    except FileExistsError:
        if path.is_symlink():
            text = f"{path} leads to {path.readlink()}, which is in use; remove it, or name another path"
            raise PortInUse(text, path=str(path)) from None
        wrong, expected = f"{path} is there, and is no link to a terminal", "a path where there is nothing yet"
    except OSError as error:
        wrong = f"no link {path} to the pseudo-terminal: {error.strerror}"
        expected = "a path in a directory that is there and may be written to"
    raise BadUrl.wrong("endpoint", str(path), expected, f"{wrong}")
