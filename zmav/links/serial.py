"""Serial links: a device at a given baud rate, or at the one at which MAVLink is heard."""

from __future__ import annotations

import os
import time

from zmav.errors import LinkDown
from zmav.links.base import LinkState
from zmav.links.baud import CANDIDATES, MavlinkDetector, is_mavlink
from zmav.links.stream import StreamLink
from zmav.links.ttyport import Port, open_port
from zmav.links.url import SerialUrl

WATCH = 8192  # bytes without a single sign of MAVLink, after which a rate found by listening is doubted
QUEUE_S = 0.5  # so much line time may wait to be sent


class SerialLink(StreamLink):
    """A serial device; reopened when it was unplugged and came back, also behind a symlink that points elsewhere now.

    With a baud rate given it is UP once it is open. Without one, each of ``baud.CANDIDATES`` is listened to in turn,
    the last good one first, round and round until MAVLink is heard; a rate at which nothing but noise comes later is
    given up again. While listening ``send`` returns False, except on USB devices that are called ttyACM: there the rate
    mostly means nothing, and some autopilots (PX4) are silent until they are spoken to.
    """

    listen = 1.5
    """s at one baud rate: longer than the second between two HEARTBEATs"""
    candidates: tuple[int, ...] = CANDIDATES

    def __init__(self, target: SerialUrl) -> None:
        super().__init__(str(target), _queue(target.baud or CANDIDATES[0]))
        self._target = target
        self._port: Port | None = None
        self._listening = False
        self._speak_first = False
        self._last_good: int | None = None
        self._rounds = 0
        self._early = b""  # heard while listening, to be delivered first
        self._watched = bytearray()

    @property
    def capacity(self) -> float | None:
        """A tenth of the baud rate: a byte has a start and a stop bit. USB is not slowed by what its rate is set to."""
        return None if self.baud is None or self._is_usb() else self.baud / 10

    @property
    def baud(self) -> int | None:
        """The rate: as given, or the last one at which MAVLink was heard; None: none yet."""
        return self._target.baud or self._last_good

    def _is_usb(self) -> bool:
        return "ttyACM" in self._target.path or "ttyACM" in os.path.realpath(self._target.path)

    def _open(self) -> str:
        target = self._target
        if target.baud is not None:
            self._port = open_port(target.path, target.baud, target.rtscts)
            return f"{target.path} at {target.baud} baud"
        first = [self._last_good] if self._last_good else []
        rates = first + [rate for rate in self.candidates if rate not in first]
        self._speak_first = self._is_usb()
        self._listening, self._rounds = True, 0
        self._port = port = open_port(target.path, rates[0], target.rtscts)
        found = None
        while found is None:
            found = self._go_round(port, rates)
            self._rounds += 1
        self._listening = False
        self._last_good = found
        self._watched.clear()
        self._outbox.limit = _queue(found)
        return f"{target.path} at {found} baud, found by listening"

    def _go_round(self, port: Port, rates: list[int]) -> int | None:
        for rate in rates:
            try:
                port.set_baud(rate)
            except ValueError:
                continue  # a rate this adapter cannot do
            self._say_listening(rate)
            if self._hears(port):
                return rate
        return None

    def _say_listening(self, rate: int) -> None:
        if self._rounds == 0:
            self._set_state(LinkState.CONNECTING, f"{self._target.path}: listening for MAVLink at {rate} baud")
        else:  # said once, not every second for ever
            self._set_state(
                LinkState.CONNECTING,
                f"{self._target.path}: no MAVLink heard at any of {', '.join(map(str, self.candidates))} baud;"
                " still listening, round and round: is the autopilot on, and the port set to MAVLink?",
            )

    def _hears(self, port: Port) -> bool:
        detector, end = MavlinkDetector(), time.monotonic() + self.listen
        while time.monotonic() < end:
            if self._closing.is_set():
                raise LinkDown("closing", url=self.url)
            verdict = detector.hear(port.read())
            self._flush()
            if verdict is not None:
                self._early = bytes(detector.heard) if verdict else b""
                return verdict
        return False

    def _read(self) -> bytes:
        if self._port is None:
            raise LinkDown("not open", url=self.url)
        if self._early:
            data, self._early = self._early, b""
            return data
        self._flush()
        data = self._port.read()
        if data and self._target.baud is None:
            self._watch(data)
        return data

    def _watch(self, data: bytes) -> None:
        """A rate found by listening may be wrong by now: another autopilot, or its setting was changed."""
        self._watched += data
        if len(self._watched) >= WATCH:
            good = is_mavlink(self._watched)
            self._watched.clear()
            if not good:
                raise LinkDown(f"{self._target.path}: only noise at {self._last_good} baud by now", url=self.url)

    def _write(self, data: bytes) -> int:
        if self._port is None or (self._listening and not self._speak_first):
            return 0
        return super()._write(data)

    def _write_some(self, data: bytes) -> int:
        if self._port is None:
            raise LinkDown("not open", url=self.url)
        return self._port.write(data)

    def _release(self) -> None:
        # Under the lock: the descriptor's number may belong to another file the moment it is closed.
        with self._tx_lock:
            port, self._port = self._port, None
            self._outbox.clear()
        self._early, self._listening = b"", False
        if port is not None:
            port.close()


def _queue(baud: int) -> int:
    """Bytes that may wait: half a second of the line, at least four of the longest frames."""
    return max(1120, int(baud / 10 * QUEUE_S))
