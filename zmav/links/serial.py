"""Serial links: a device at a given baud rate, or at the one at which MAVLink is heard.

MAVLink is either one HEARTBEAT whose checksum is right, or several frames in a row, each beginning where the one before
it ends. Frames: https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

import os
import time

from fastcrc import crc16

from zmav.errors import LinkDown
from zmav.links.base import LinkState
from zmav.links.stream import StreamLink
from zmav.links.tlog import V1, V2, frame_length
from zmav.links.ttyport import Port, open_port
from zmav.links.url import SerialUrl

CANDIDATES = (115200, 57600, 921600, 460800, 230400, 38400, 1500000, 500000, 1000000, 2000000, 3000000, 19200, 9600)
CHAIN = 3  # so many whole frames in a row, and the beginning of the next if there is more
NOISE = 1200  # bytes without MAVLink that settle it: at least four times the longest frame (280)

_HEARTBEAT_EXTRA, _HEARTBEAT_LENGTH = 50, 9


class MavlinkDetector:
    """Listens to a piece of a stream: ``hear`` says True (MAVLink), False (enough heard: noise) or None (not yet)."""

    def __init__(self) -> None:
        self.heard = bytearray()  # so that the frames already heard are not lost

    def hear(self, data: bytes) -> bool | None:
        self.heard += data
        if is_mavlink(self.heard):
            return True
        if len(self.heard) < NOISE:
            return None
        return False


def is_mavlink(data: bytes | bytearray) -> bool:
    """Whether a true HEARTBEAT, or ``CHAIN`` frames in a row, stand anywhere in ``data``."""
    return any(data[at] in (V1, V2) and (_is_heartbeat(data, at) or _chains(data, at)) for at in range(len(data)))


def _chains(data: bytes | bytearray, at: int) -> bool:
    """``CHAIN`` whole frames of one version follow one another, and the sequence of each source is unbroken."""
    version = data[at]
    last_seq: dict[bytes, int] = {}
    for _ in range(CHAIN):
        length = frame_length(data, at) if at < len(data) else -1
        if length <= 0 or at + length > len(data) or data[at] != version:
            return False
        head = at + (2 if version == V1 else 4)
        seq, source = data[head], bytes(data[head + 1 : head + 3])
        if source[0] == 0 or (source in last_seq and seq != (last_seq[source] + 1) % 256):
            return False
        last_seq[source] = seq
        at += length
    # Different sources need not agree in anything; some source must have been met twice.
    return len(last_seq) < CHAIN and (at >= len(data) or data[at] == version)


def _is_heartbeat(data: bytes | bytearray, at: int) -> bool:
    header = 6 if data[at] == V1 else 10
    msgid = data[at + 5 : at + 6] if data[at] == V1 else data[at + 7 : at + 10]
    end = at + header + _HEARTBEAT_LENGTH
    if end + 2 > len(data) or data[at + 1] != _HEARTBEAT_LENGTH or any(msgid):
        return False
    body = bytes(data[at + 1 : end]) + bytes([_HEARTBEAT_EXTRA])
    return crc16.mcrf4xx(body) == int.from_bytes(data[end : end + 2], "little")


WATCH = 8192  # bytes without a single sign of MAVLink, after which a rate found by listening is doubted
QUEUE_S = 0.5  # so much line time may wait to be sent


class SerialLink(StreamLink):
    """A serial device; reopened when it was unplugged and came back, also behind a symlink that points elsewhere now.

    With a baud rate given it is UP once it is open. Without one, each of :data:`CANDIDATES` is listened to in turn,
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
