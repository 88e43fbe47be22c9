"""Serial devices: which are meant, how fast they go, and opening them raw."""

from __future__ import annotations

import os
import termios

from zmav.errors import BadUrl

USUAL_BAUD = 921600
_EXPECTED = "PATH[:BAUD] of a serial device, such as /dev/ttyACM0 or /dev/ttyUSB0:921600"


def parse_device(text: str) -> tuple[str, int]:
    """``PATH[:BAUD]``; :class:`BadUrl` says what is wrong."""
    path, colon, rate = text.rpartition(":")
    if not colon:
        path, rate = text, str(USUAL_BAUD)
    if not path or not rate.isdigit() or not hasattr(termios, f"B{rate}") or rate == "0":
        raise BadUrl(f"no serial device {text!r}; expected {_EXPECTED}", field="hil", value=text, expected=_EXPECTED)
    return path, int(rate)


def is_usb(path: str) -> bool:
    """A USB device whose line speed means nothing."""
    return "ttyACM" in os.path.realpath(path)


def open_device(path: str, baud: int) -> int:
    """An open descriptor, raw, 8N1. Raises :class:`OSError` while it cannot be opened, and :class:`BadUrl` where it is
    no serial device.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        settings = termios.tcgetattr(descriptor)
    except termios.error:
        os.close(descriptor)
        raise BadUrl(f"{path} is no serial device", field="hil", value=path, expected=_EXPECTED) from None
    speed = getattr(termios, f"B{baud}")
    settings[0] = settings[1] = settings[3] = 0
    settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    settings[4] = settings[5] = speed
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)
    termios.tcflush(descriptor, termios.TCIOFLUSH)
    return descriptor
