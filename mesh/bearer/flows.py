"""The flows between our router and a neighbour's: which socket on loopback belongs to which number on the radio.

Zenoh's link is one flow of datagrams. The side that opened it has one socket of the bearer's for each neighbour, and
knows a flow by the router's own port; the other side has a socket for each flow, connected to its router's listener.
"""

from __future__ import annotations

import contextlib
import secrets
import socket

Local = tuple[str, int]
MOST = 16
"""flows with one neighbour, each way; more are refused until one has been quiet for a while"""
QUIET = 10.0
"""s without a datagram after which a flow may be forgotten: a link's lease and more"""
BUFFER = 1 << 20


def loopback_socket() -> socket.socket:
    """A UDP socket on a free port of loopback."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    made.bind(("127.0.0.1", 0))
    return made


class Opened:
    """The flows that our router has opened to one neighbour, through ``self.socket``."""

    def __init__(self) -> None:
        self.socket = loopback_socket()
        self._next = secrets.randbits(16)
        self._numbers: dict[Local, int] = {}
        self._locals: dict[int, tuple[Local, float]] = {}

    def number(self, local: Local, now: float) -> int | None:
        """The flow of what came from a local port; None where there are too many."""
        number = self._numbers.get(local)
        if number is None:
            if len(self._numbers) >= MOST and not self._forget(now):
                return None
            self._next = (self._next + 1) & 0xFFFF
            number = self._numbers[local] = self._next
        self._locals[number] = (local, now)
        return number

    def deliver(self, number: int, payload: memoryview) -> bool:
        """Hand a datagram to our router; False for a flow that is none."""
        found = self._locals.get(number)
        if found is None:
            return False
        with contextlib.suppress(OSError):  # its queue is full, or it has gone: QUIC asks again
            self.socket.sendto(payload, found[0])
        return True

    def _forget(self, now: float) -> bool:
        number, (local, used) = min(self._locals.items(), key=lambda each: each[1][1])
        if now - used < QUIET:
            return False
        del self._locals[number], self._numbers[local]
        return True

    def close(self) -> None:
        self.socket.close()


class Taken:
    """The flows that one neighbour's router has opened to ours, which listens at ``router``."""

    def __init__(self, router: Local) -> None:
        self._router = router
        self.sockets: dict[int, socket.socket] = {}
        self._used: dict[int, float] = {}

    def deliver(self, number: int, payload: memoryview, now: float) -> socket.socket | None:
        """Hand a datagram to our router; a new flow's socket, where this has made one."""
        made, found = None, self.sockets.get(number)
        if found is None:
            if len(self.sockets) >= MOST:
                return None
            made = found = loopback_socket()
            found.connect(self._router)
            self.sockets[number] = found
        self._used[number] = now
        with contextlib.suppress(OSError):
            found.send(payload)
        return made

    def quiet(self, now: float) -> list[socket.socket]:
        """Sockets of flows that have been quiet for long: no longer ours, to be closed."""
        numbers = [number for number, used in self._used.items() if now - used > QUIET]
        for number in numbers:
            del self._used[number]
        return [self.sockets.pop(number) for number in numbers]

    def close(self) -> None:
        for each in self.sockets.values():
            each.close()
        self.sockets.clear()
