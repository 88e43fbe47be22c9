"""An open serial port: set up by pyserial, then read with one system call and written without blocking."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
import time

import serial

from zmav.errors import LinkDown

READ_WAKE_S = 0.1  # a read returns after so long at most, with nothing (the terminal driver counts tenths of a second)
DRAIN_S = 0.3  # closing lets what was written go out for so long, then throws the rest away
CHUNK = 4096


def open_port(path: str, baud: int, rtscts: bool) -> Port:
    """Open a serial device for this process alone; raises LinkDown that says why it cannot be and what to do."""
    try:
        port = serial.Serial(path, baud, timeout=READ_WAKE_S, write_timeout=READ_WAKE_S, exclusive=True, rtscts=rtscts)
    except (OSError, ValueError) as error:  # SerialException is an OSError; ValueError: a rate it cannot do
        raise LinkDown(_explain(path, error), path=path) from error
    # FTDI adapters otherwise collect bytes for up to 16 ms. Not every driver can.
    with contextlib.suppress(OSError, ValueError, NotImplementedError, AttributeError):
        port.set_low_latency_mode(True)
    try:
        return Port(port, path)
    except OSError as error:
        port.close()
        raise LinkDown(_explain(path, error), path=path) from error


def _explain(path: str, error: Exception) -> str:
    code = getattr(error, "errno", None)
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return f"no device {path}: is it plugged in?"
    if code in (errno.EACCES, errno.EPERM):
        return f"not permitted to open {path}: add the user to the group that owns it (often dialout)"
    if code in (errno.EBUSY, errno.EAGAIN):
        return f"{path} is held by another program: stop it first"
    if code == errno.EISDIR or "Inappropriate ioctl" in str(error):
        return f"{path} is not a serial port"
    return f"cannot open {path}: {error}"


class Port:
    """A POSIX terminal: blocking reads that the driver ends by itself (VMIN 0, VTIME), on one descriptor; a second,
    non-blocking one to write, because O_NONBLOCK would hold for both directions of one."""

    def __init__(self, port: serial.Serial, path: str) -> None:
        self._port = port
        self._rx: int = port.fileno()
        self._hangup = select.poll()
        self._hangup.register(self._rx, 0)
        os.set_blocking(self._rx, True)
        self._tx = os.open(path, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            self._set_timing()
            # pyserial's lock is advisory; this one keeps every unprivileged program out.
            self._exclusive(True)
        except OSError:
            os.close(self._tx)
            raise

    def read(self) -> bytes:
        """What is there, at once; b"" after about 0.1 s of silence. Raises OSError when the device is gone."""
        data = os.read(self._rx, CHUNK)
        if not data and self._hangup.poll(0):
            raise OSError(errno.ENODEV, "the device is gone (unplugged?)")
        return data

    def write(self, data: bytes) -> int:
        """Bytes taken, 0 when full; does not block. Raises OSError when the device is gone."""
        try:
            return os.write(self._tx, data)
        except BlockingIOError:
            return 0

    def set_baud(self, baud: int) -> None:
        """Go on at another rate; what was received at the old one and not read yet is forgotten.

        Raises ValueError for a rate it cannot do, OSError when the device is gone.
        """
        try:
            self._port.baudrate = baud
            self._set_timing()
            self._port.reset_input_buffer()
        except termios.error as error:  # not an OSError
            raise (ValueError if error.args[0] == errno.EINVAL else OSError)(*error.args) from error

    def close(self) -> None:
        # The last close of a UART may wait 30 s for what nobody takes: let it go out for a moment, then drop it.
        with contextlib.suppress(OSError, termios.error):
            end = time.monotonic() + DRAIN_S
            while self._port.out_waiting and time.monotonic() < end:
                time.sleep(0.01)
            if self._port.out_waiting:
                self._port.reset_output_buffer()
        self._exclusive(False)
        os.close(self._tx)
        self._port.close()

    def _set_timing(self) -> None:
        try:
            attributes = termios.tcgetattr(self._rx)
            attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 0, round(READ_WAKE_S * 10)
            termios.tcsetattr(self._rx, termios.TCSANOW, attributes)
        except termios.error as error:  # not an OSError
            raise OSError(*error.args) from error

    def _exclusive(self, on: bool) -> None:
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._rx, termios.TIOCEXCL if on else termios.TIOCNXCL)
