"""A bearer's socket on one radio: it waits for the radio where it must, and keeps its budget where it has one."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from mesh.bearer.header import overhead
from mesh.bearer.shaper import Shaper
from zmav.config import Radio
from zmav.config.mesh import parse_budget

Address = tuple[str, int]
RETRY = 1.0
"""s between attempts to open a radio's socket"""
AT_ONCE = 64
"""datagrams read in one turn, so that no radio keeps the others waiting"""
BUFFER = 1 << 20
"""bytes that may wait in the kernel for us: what is carried comes in bursts"""
_IP_MTU_DISCOVER, _IP_PMTUDISC_DO = 10, 2  # from linux/in.h: Python has no names for them before 3.12
_SIOCGIFMTU = 0x8921  # from linux/sockios.h
_SO_BINDTODEVICE = getattr(socket, "SO_BINDTODEVICE", None)
_GONE = (errno.ENODEV, errno.EADDRNOTAVAIL, errno.EINVAL, errno.EBADF)
log = logging.getLogger(__name__)


@dataclass
class Counters:
    """What went through a radio, and what did not."""

    sent_bytes: int = 0
    """with IP and UDP headers"""
    dropped: int = 0
    """datagrams without room within the budget, or in the kernel"""
    too_big: int = 0
    """larger than the radio carries: QUIC finds that out, and sends smaller ones"""
    foreign: int = 0
    """from somebody unknown, or nothing a bearer sends"""


class RadioPort:
    """``open`` tries to listen at the radio's own address; ``send`` queues or sends; ``flush`` sends what is due."""

    def __init__(self, radio: Radio, port: int, now: float) -> None:
        assert radio.address is not None  # one that is not there yet has no bearer until it is
        self.radio, self.address = radio, (radio.address, port)
        self.budget = parse_budget(radio.budget) if radio.budget else None
        self.counters = Counters()
        self.largest = 65535
        """bytes of a datagram that the radio carries in one piece, as far as its interface tells"""
        self.socket: socket.socket | None = None
        self.gone = False
        """the radio of the open socket is not there any more: to be closed and opened again"""
        self._shaper: Shaper[tuple[bytes, Address]] | None = Shaper(self.budget, now) if self.budget else None
        self._overhead = overhead(radio.address)
        self._again, self._said = now, False

    @property
    def name(self) -> str:
        return self.radio.interface or str(self.radio.address)

    def open(self, now: float) -> bool:
        """True where it has just been opened; a radio that is not there is tried again later."""
        if self.socket is not None or now < self._again:
            return False
        self._again = now + RETRY
        family = socket.AF_INET6 if ":" in self.address[0] else socket.AF_INET
        made = socket.socket(family, socket.SOCK_DGRAM)
        try:
            made.setblocking(False)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            if family == socket.AF_INET:
                made.setsockopt(socket.IPPROTO_IP, _IP_MTU_DISCOVER, _IP_PMTUDISC_DO)
            if self.radio.interface and _SO_BINDTODEVICE is not None:
                with contextlib.suppress(PermissionError):  # the routing table then has to be right
                    made.setsockopt(socket.SOL_SOCKET, _SO_BINDTODEVICE, self.radio.interface.encode() + b"\0")
            made.bind(self.address)
        except OSError as e:
            made.close()
            if e.errno == errno.EADDRINUSE and not self._said:
                self._said = True
                text = "%s: port %d is in use by another program: no neighbour is reached through it until that ends"
                log.warning(text, self.name, self.address[1])
            log.debug("%s: %s", self.name, e)
            return False
        self.socket, self.largest, self._said = made, self._mtu(made) - self._overhead, False
        return True

    def _mtu(self, made: socket.socket) -> int:
        if not self.radio.interface or not sys.platform.startswith("linux"):
            return 65535
        try:
            found = fcntl.ioctl(made, _SIOCGIFMTU, struct.pack("16si12x", self.radio.interface.encode()[:15], 0))
        except OSError:
            return 65535
        return int(struct.unpack_from("16si", found)[1])

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket, self.gone = None, False

    # Sending.

    def send(self, neighbour: object, data: bytes, to: Address, now: float, *, first: bool = False) -> None:
        """``first``: before whatever waits. What does not fit is dropped and counted."""
        if self._shaper is None:
            self._send(data, to)
            return
        size, item = len(data) + self._overhead, (data, to)
        if not (self._shaper.put_first(item, size) if first else self._shaper.put(neighbour, item, size)):
            self.counters.dropped += 1
        self.flush(now)

    def flush(self, now: float) -> None:
        """Send what the budget allows now."""
        if self._shaper is not None:
            for data, to in self._shaper.take(now):
                self._send(data, to)

    def wait(self, now: float) -> float | None:
        """Seconds until something that waits may leave."""
        return self._shaper.wait(now) if self._shaper is not None else None

    def _send(self, data: bytes, to: Address) -> None:
        if self.socket is None:
            return
        try:
            self.socket.sendto(data, to)
        except BlockingIOError:
            self.counters.dropped += 1
        except OSError as e:
            if e.errno == errno.EMSGSIZE:
                self.counters.too_big += 1
                return
            if e.errno in _GONE:
                log.debug("%s is gone: %s", self.name, e)
                self.gone = True
        else:
            self.counters.sent_bytes += len(data) + self._overhead

    # Receiving.

    def receive(self, buffer: bytearray) -> Iterator[tuple[memoryview, Address]]:
        """What has come, a turn's worth; each is good until the next is asked for."""
        view = memoryview(buffer)
        for _ in range(AT_ONCE):
            if self.socket is None:
                return
            try:
                size, source = self.socket.recvfrom_into(buffer)
            except BlockingIOError:
                return
            except OSError as e:
                log.debug("%s: %s", self.name, e)
                return
            yield view[:size], (source[0], source[1])
