"""Two bearers and the air between their radios: real sockets on loopback, and each radio's air can be cut."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from mesh.bearer.bearer import Bearer, Far
from tests.ports import free_udp_ports
from zmav.config import Radio

FLEET = "demo"
PATIENCE_S = 30.0


def udp(port: int = 0) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", port))
    return made


class Air:
    """Between two radios: what one sends to its end comes out of the other end."""

    def __init__(self, left: int, right: int) -> None:
        self._ends = (udp(), udp())
        """the left radio sends to the first, and hears from it"""
        self._radios = (("127.0.0.1", left), ("127.0.0.1", right))
        self.cut = False
        self.carried: list[tuple[float, int, int]] = []
        """when, which way (0: from the left), bytes with IP and UDP headers"""
        self._selector = selectors.DefaultSelector()
        self._wake, self._waker = socket.socketpair()
        for way, end in enumerate(self._ends):
            end.setblocking(False)
            self._selector.register(end, selectors.EVENT_READ, way)
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self, side: int) -> tuple[str, int]:
        """Where the radio of that side sends to."""
        address: tuple[str, int] = self._ends[side].getsockname()
        return address

    def _run(self) -> None:
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is self._wake:
                    return
                with contextlib.suppress(OSError):
                    data, source = self._ends[key.data].recvfrom(65536)
                    if source == self._radios[key.data] and not self.cut:
                        self.carried.append((time.monotonic(), key.data, len(data) + 28))
                        self._ends[1 - key.data].sendto(data, self._radios[1 - key.data])

    def close(self) -> None:
        self._waker.close()
        self._thread.join()
        self._selector.close()
        for each in (self._wake, *self._ends):
            each.close()


@dataclass
class Pair:
    """``left`` opens links to ``right``; ``routers`` is where their routers should listen."""

    airs: list[Air]
    ports: tuple[list[int], list[int]]
    routers: list[int]
    budgets: tuple[str | None, ...]
    bearers: list[Bearer] = field(default_factory=list)

    def bearer(self, side: int) -> Bearer:
        names = ("left", "right")
        radios = [
            (Radio(address="127.0.0.1", budget=budget), port)
            for port, budget in zip(self.ports[side], self.budgets, strict=True)
        ]
        ways = [(place, air.end(side), 10 * (place + 1)) for place, air in enumerate(self.airs)]
        far = Far(names[1 - side], ways, opens=side == 0)
        return Bearer(FLEET, names[side], radios, [far], ("127.0.0.1", self.routers[side]), names)

    def start(self, side: int) -> Bearer:
        self.bearers.append(self.bearer(side).__enter__())
        return self.bearers[-1]

    def stop(self, bearer: Bearer) -> None:
        self.bearers.remove(bearer)
        bearer.__exit__(None, None, None)


@pytest.fixture
def pair() -> Iterator[Callable[..., Pair]]:
    """``pair(None, "60 kB/s")``: two radios a side with these budgets; neither bearer is started yet."""
    made: list[Pair] = []

    def make(*budgets: str | None) -> Pair:
        ports = [free_udp_ports(1) for _ in budgets], [free_udp_ports(1) for _ in budgets]
        airs = [Air(left, right) for left, right in zip(*ports, strict=True)]
        made.append(Pair(airs, ports, [free_udp_ports(1), free_udp_ports(1)], budgets))
        return made[-1]

    yield make
    for each in made:
        for bearer in list(each.bearers):
            each.stop(bearer)
        for air in each.airs:
            air.close()
