"""A datagram relay on one link that counts what goes through.

Routers of a study all sit on loopback, where no interface counts a link's bytes. Zenoh's 1.10 Python wheel keeps no
counters of its links, so the link leads through here.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading

HEADERS = 28
"""bytes of IPv4 and UDP that every datagram has on top"""
_MTU = 65_535
_BUFFER = 4 << 20


class Meter:
    """``with Meter(port) as meter``: datagrams to ``127.0.0.1:meter.port`` go to ``127.0.0.1:port``, answers go back.

    ``up`` and ``down`` are bytes towards ``port`` and from it, headers included.
    """

    def __init__(self, port: int) -> None:
        self._to = ("127.0.0.1", port)
        self.up = self.down = 0
        self._front = _udp()
        self._front.bind(("127.0.0.1", 0))
        self.port: int = self._front.getsockname()[1]
        self._backs: dict[tuple[str, int], socket.socket] = {}
        self._selector = selectors.DefaultSelector()
        self._wake, self._end = os.pipe()
        self._thread = threading.Thread(target=self._run, name="meter", daemon=True)

    @property
    def bytes(self) -> int:
        return self.up + self.down

    def __enter__(self) -> Meter:
        self._selector.register(self._front, selectors.EVENT_READ, None)
        self._selector.register(self._wake, selectors.EVENT_READ, None)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._end, b"x")
        self._thread.join()
        self._selector.close()
        for each in (self._front, *self._backs.values()):
            each.close()
        os.close(self._wake)
        os.close(self._end)

    def _run(self) -> None:
        while True:
            for key, _ in self._selector.select():
                if key.fileobj == self._wake:
                    return
                with contextlib.suppress(
                    OSError
                ):  # nobody listens there yet or any more: as on any network, it is lost
                    if key.data is None:
                        self._towards()
                    else:
                        self._back(key.fileobj, key.data)  # type: ignore[arg-type]  # we registered sockets

    def _towards(self) -> None:
        for _ in range(64):
            try:
                data, source = self._front.recvfrom(_MTU)
            except BlockingIOError:
                return
            back = self._backs.get(source)
            if back is None:
                back = self._backs[source] = _udp()
                back.connect(self._to)
                self._selector.register(back, selectors.EVENT_READ, source)
            self.up += len(data) + HEADERS
            back.send(data)

    def _back(self, back: socket.socket, source: tuple[str, int]) -> None:
        for _ in range(64):
            try:
                data = back.recv(_MTU)
            except BlockingIOError:
                return
            self.down += len(data) + HEADERS
            self._front.sendto(data, source)


def _udp() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        made.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
    return made
