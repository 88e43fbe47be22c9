"""Where the bridge and those who answer in a vehicle's place meet.

A ground control station asks every vehicle for all its parameters and missions as soon as it sees it. The vehicle's
agent has them; an :class:`Answerer` gives them to the client in the vehicle's name, so that neither the mesh nor the
autopilot hears of it.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from typing import Any, Protocol

import zmav
from ground.feed import Origin
from ground.gcs.options import Options
from zmav.mavlink import Dialect, Frame


class GcsClient(Protocol):
    """One ground control station at one endpoint. Every method is thread-safe."""

    name: str
    """for people: ``udp 127.0.0.1:14550``"""
    options: Options
    """which vehicles it sees"""

    @property
    def ids(self) -> frozenset[tuple[int, int]]:
        """The (system, component) it speaks as."""

    @property
    def read_only(self) -> bool:
        """Nothing it says may change a vehicle."""

    @property
    def gone(self) -> bool:
        """It left, or was forgotten: nothing that is sent will arrive."""

    def send(self, data: bytes) -> bool:
        """Give it a frame in a vehicle's name; its sequence number is set here. What is given so must arrive: it goes
        before telemetry. False: too much waits already, try later.
        """


class Ground(Protocol):
    """What an answerer has of the bridge."""

    z: zmav.Client
    loop: asyncio.AbstractEventLoop
    dialect: Dialect

    def vehicle(self, sysid: int) -> zmav.Vehicle | None:
        """The vehicle that frames for that system go to; None where there is none, or two autopilots claim it."""

    def systems(self) -> list[int]:
        """The system ids of the autopilots that are there: who is meant by target 0. Any thread."""

    def component(self, sysid: int) -> int:
        """The component id of that system's autopilot; 1 where it is not known."""

    def pack(self, sysid: int, compid: int, name: str, **fields: Any) -> bytes:
        """A frame in a vehicle's name, fields left out are zero: for :meth:`GcsClient.send`. Any thread."""

    def put(self, client: GcsClient, frame: Frame) -> None:
        """Hand a frame that was taken on to the vehicles after all, as if nobody had taken it; a read-only client's
        goes nowhere. Any thread.
        """


class Answerer(ABC):
    """Takes what clients ask, and says which frames of vehicles they must not get.

    Called on carrying threads: it must be quick, must not wait, and must not raise (what it raises is said once, and
    counts as False). Slow work belongs on ``ground.loop``.
    """

    takes: frozenset[str]
    """names of the clients' messages that are offered"""
    watches: frozenset[str] = frozenset()
    """names of the vehicles' messages that :meth:`withhold` is asked about"""

    @abstractmethod
    def offer(self, client: GcsClient, frame: Frame) -> bool:
        """A client's frame; True: taken, it goes to no vehicle. On the thread of the client's endpoint."""

    def withhold(self, origin: Origin, data: bytes) -> bool:
        """A vehicle's frame; True: no client gets it. On Zenoh's thread."""
        return False

    def left(self, client: GcsClient) -> None:
        """The client is gone."""
        return

    def close(self) -> None:
        """The bridge ends. On the event loop."""
        return
