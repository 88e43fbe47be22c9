"""What all endpoints share: whom they tell, and what one may count on of each."""

from __future__ import annotations

import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

import zmav
from ground.gcs.client import Client
from ground.gcs.options import Endpoint
from zmav import wire
from zmav.links.sockets import Address
from zmav.mavlink import Dialect, Frame

MOST_CLIENTS = 64
"""at one endpoint"""


class Hub(Protocol):
    """The bridge, as its endpoints and what comes from them see it. Every method is thread-safe and quick, and none
    raises.
    """

    z: zmav.Client
    dialect: Dialect
    news: Callable[[str], None]
    """a line for anyone who watches the terminal"""

    def joined(self, client: Client) -> None:
        """Somebody is there, or may be: it gets frames from now on."""

    def left(self, client: Client, why: str) -> None: ...

    def said(self, client: Client, frame: Frame) -> None:
        """A frame of a client."""

    def tell(self, client: Client, sysid: int, severity: wire.Severity, text: str) -> None:
        """A STATUSTEXT about that system, 0: whichever vehicle the client knows."""

    def ack(self, client: Client, frame: Frame, result: int) -> None:
        """Answer a command in the vehicle's place."""

    def identified(self, client: Client) -> None:
        """It speaks as another system and component, or said what it is."""


class StationEndpoint(ABC):
    """An endpoint at work: where one ground control station is, or several."""

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        self.endpoint, self._hub = endpoint, hub
        self.turned_away = 0
        """peers that were one too many, or not who may speak here"""

    @abstractmethod
    def start(self) -> None:
        """Raises a typed error where it cannot be had; from then on it keeps itself open."""

    @abstractmethod
    def close(self) -> None: ...

    @property
    @abstractmethod
    def clients(self) -> Sequence[Client]: ...

    def _take(self, client: Client, data: bytes) -> None:
        """What came from it."""
        for frame in client.feed(data):
            self._hub.said(client, frame)


class SocketEndpoint(StationEndpoint):
    """One with a socket, and a thread that reads it."""

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        super().__init__(endpoint, hub)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"gcs {endpoint}", daemon=True)
        self._sock: socket.socket | None = None

    @property
    def address(self) -> Address:
        """Where its socket is bound, once it is started."""
        assert self._sock is not None
        return self._sock.getsockname()  # type: ignore[no-any-return]

    def close(self) -> None:
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join(1.0)
        for client in self.clients:
            client.close()
        if self._sock is not None:
            self._sock.close()

    @abstractmethod
    def _run(self) -> None:
        """Read until :attr:`_closing`."""
