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

BITS_PER_BYTE = 10  # with start and stop bit
BUFFER_BYTES = 2048  # of a line's driver
USUAL_BAUD = 115200
LOOK_EVERY = 10  # ticks, for somebody who opens the terminal


class PtyEndpoint:
    """One pseudo-terminal. ``address.path``: a symbolic link to it; ``address.baud``: its speed in simulated time, in
    the vehicle's direction to the client.
    """

    def __init__(self, address: Address, vehicle: Switchboard, wiring: Wiring) -> None:
        self.link = address.kind
        self._vehicle = vehicle
        self._wiring = wiring
        self._bytes_per_s = address.baud / BITS_PER_BYTE
        self._buffer = BUFFER_BYTES if address.baud else BACKLOG_BYTES
        self._backlog = bytearray()
        self._credit, self._paid = 0.0, wiring.now()
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
        self.url = f"{self._link or self.device},{address.baud or USUAL_BAUD}"
        self._channel = vehicle.open_channel(self, self.link)
        wiring.waiting.add(self)

    def clients(self) -> int:
        return int(self._attached)

    def room(self) -> int:
        return self._buffer - len(self._backlog)

    def put(self, frame: bytes) -> None:
        self._backlog += frame
        self._wiring.waiting.add(self)

    def flush(self) -> bool:
        """Send what the line's speed allows; look whether somebody has opened it."""
        if not self._attached:
            self._look_in -= 1
            if self._look_in < 0:
                self._look_in = LOOK_EVERY
                if not self._hangup.poll(0):
                    self._attach()
        count = self._allowed()
        if not self._attached:
            del self._backlog[:count]
            return False
        try:
            sent = os.write(self._master, self._backlog[:count]) if count else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._detach()
            return False
        del self._backlog[:sent]
        if self._bytes_per_s:
            self._credit -= sent
        return not self._backlog

    def _allowed(self) -> int:
        """How many of the bytes that wait the line has had time for."""
        if not self._bytes_per_s:
            return len(self._backlog)
        now = self._wiring.now()
        # A line that was idle cannot make up for it: at most what it takes in a tenth of a second.
        most = max(self._bytes_per_s * 0.1, 1.0)
        self._credit = min(self._credit + (now - self._paid) * self._bytes_per_s, most)
        self._paid = now
        return min(len(self._backlog), int(self._credit))

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
    raise BadUrl(f"{wrong}; expected {expected}", field="endpoint", value=str(path), expected=expected)
