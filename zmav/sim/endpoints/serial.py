"""Pseudo-terminals: a vehicle as a serial autopilot, which speaks whether anybody listens or not.

While no program has the terminal open, what the vehicle says is lost, as on a line that leads nowhere; who opens it
hears only what is said from then on. See pty(7).
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import selectors
import termios
import tty
from pathlib import Path

from zmav.errors import BadUrl, PortInUse
from zmav.sim.endpoints.address import Address
from zmav.sim.endpoints.base import BACKLOG_BYTES, READ_BYTES, READS_PER_TURN, Switchboard, Wiring

USUAL_BAUD = 115200
LOOK_EVERY = 10  # ticks, for somebody who opens the terminal


class PtyEndpoint:
    """One pseudo-terminal. ``address.path``: a symbolic link to it."""

    def __init__(self, address: Address, vehicle: Switchboard, wiring: Wiring) -> None:
        self.link = address.kind
        self._vehicle = vehicle
        self._wiring = wiring
        self._backlog = bytearray()
        self._attached = False
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
        return int(self._attached)

    def room(self) -> int:
        return BACKLOG_BYTES - len(self._backlog)

    def put(self, frame: bytes) -> None:
        self._backlog += frame
        self._wiring.waiting.add(self)

    def flush(self) -> bool:
        """Send what there is; look whether somebody has opened it."""
        if not self._attached:
            self._look_in -= 1
            if self._look_in < 0:
                self._look_in = LOOK_EVERY
                if not self._hangup.poll(0):
                    self._attach()
        if not self._attached:
            self._backlog.clear()
            return False
        try:
            # A copy: one that a failed write's traceback still holds could not be cut.
            sent = os.write(self._master, bytes(self._backlog)) if self._backlog else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._detach()
            return False
        del self._backlog[:sent]
        return not self._backlog

    def _attach(self) -> None:
        self._attached = True
        self._backlog.clear()  # said before anybody could hear it
        self._wiring.selector.register(self._master, selectors.EVENT_READ, self._read)

    def _detach(self) -> None:
        """The client has closed the terminal: what it did not read is not for the next one."""
        if not self._attached:
            return
        self._attached = False
        self._wiring.selector.unregister(self._master)
        self._backlog.clear()
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)
        self._wiring.waiting.add(self)

    def _read(self) -> None:
        for _ in range(READS_PER_TURN):
            try:
                data = os.read(self._master, READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
                self._detach()
                return
            self._vehicle.receive(self._channel, data)
        self.flush()

    def close(self) -> None:
        if self._attached:
            self._wiring.selector.unregister(self._master)
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
