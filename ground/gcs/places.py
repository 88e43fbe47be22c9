"""What all endpoints share: whom they tell, and what one may count on of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ground.gcs.client import Client
from ground.gcs.options import Endpoint
from zmav.mavlink import Dialect, Frame

MOST_CLIENTS = 64
"""at one endpoint"""


class Hub(Protocol):
    """The bridge, as its endpoints see it. Every method is thread-safe and quick, and none raises."""

    dialect: Dialect

    def joined(self, client: Client) -> None:
        """Somebody is there, or may be: it gets frames from now on."""

    def left(self, client: Client, why: str) -> None: ...

    def said(self, client: Client, frame: Frame) -> None:
        """A frame of a client."""

    def news(self, text: str) -> None:
        """A line for anyone who watches the terminal."""


class Running(Protocol):
    """An endpoint at work."""

    endpoint: Endpoint
    turned_away: int
    """peers that were one too many, or not who may speak here"""

    def start(self) -> None:
        """Raises a typed error where it cannot be had; from then on it keeps itself open."""

    def close(self) -> None: ...

    @property
    def clients(self) -> Sequence[Client]: ...
