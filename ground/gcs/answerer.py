"""Where the bridge and those who answer in a vehicle's place meet.

A ground control station asks every vehicle for all its parameters and missions as soon as it sees it. The vehicle's
agent has them; an :class:`Answerer` gives them to the client in the vehicle's name, so that neither the mesh nor the
autopilot hears of it.
"""

from __future__ import annotations

import asyncio
import itertools
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

import zmav
from ground.feed import Origin
from ground.gcs.client import Client
from ground.gcs.routes import Routes
from zmav import wire
from zmav.errors import Clash, NoSuchVehicle
from zmav.mavlink import Frame, Packer, targets
from zmav.services.status.events import SEVERITIES

MOST_PACKERS = 4096
COMPANION = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: so that the autopilot's own words and numbers stay its own"""
PIECE, LONGEST = 50, 200
"""characters of one STATUSTEXT, and of a text"""


class Ground:
    """What an answerer has of the bridge. Any thread."""

    def __init__(self, z: zmav.Client, loop: asyncio.AbstractEventLoop, routes: Routes) -> None:
        self.z, self.loop, self.dialect, self._routes = z, loop, z.dialect, routes
        self._packers: dict[tuple[int, int], Packer] = {}
        self._packing = threading.Lock()
        self._texts = itertools.count(1)

    def vehicle(self, sysid: int, sees: Callable[[str], bool] = lambda name: True) -> zmav.Vehicle | None:
        """The vehicle that frames for that system go to, as :meth:`Routes.way_to`; None where there is none, or two
        autopilots claim it.
        """
        try:
            fleet, name = self._routes.way_to(sysid, sees)
        except (Clash, NoSuchVehicle):
            return None
        return zmav.Vehicle(self.z, name, fleet)

    def is_autopilot(self, sysid: int, compid: int) -> bool:
        return sysid in self._routes.systems and compid == self.component(sysid)

    def component(self, sysid: int) -> int:
        """The component id of that system's autopilot; 1 where it is not known."""
        known = self._routes.systems.get(sysid)
        return known[0].compid if known else 1

    def is_for_autopilots(self, client: Client, frame: Frame) -> bool:
        """A frame of the client's is for one autopilot that it may see, or for all of them."""
        system, component = targets(frame, self.dialect)
        if not system:
            return bool(self._routes.systems)
        return component in (0, self.component(system)) and bool(self.vehicles(client, frame))

    def vehicles(self, client: Client, frame: Frame) -> list[tuple[int, zmav.Vehicle]]:
        """The vehicles whose autopilots are meant, by system id; none that the client does not see, nor any of those
        that share an id.
        """
        system, _ = targets(frame, self.dialect)
        present = list(self._routes.systems)
        wanted, sees = [system] if system in present else [] if system else present, client.options.sees
        found = [(sysid, vehicle) for sysid in wanted if (vehicle := self.vehicle(sysid, sees)) is not None]
        return [(sysid, vehicle) for sysid, vehicle in found if sees(vehicle.name)]

    def pack(self, sysid: int, compid: int, name: str, **fields: Any) -> bytes:
        """A frame in a vehicle's name, fields left out are zero: for :meth:`Client.send`."""
        with self._packing:
            packer = self._packers.get((sysid, compid))
            if packer is None:
                if len(self._packers) >= MOST_PACKERS:
                    self._packers.clear()
                packer = self._packers[sysid, compid] = Packer(self.dialect, sysid, compid)
        return packer.pack(name, **fields)

    def words(self, sysid: int, severity: wire.Severity, text: str) -> Iterator[bytes]:
        """A text in a vehicle's name, from its companion's component, as STATUSTEXTs of 50 bytes
        (https://mavlink.io/en/messages/common.html#STATUSTEXT).
        """
        plain = text.replace("µ", "u").replace("—", "-").encode("ascii", "replace").decode()[:LONGEST]
        # A text of several ends with a piece that is not full: one of 100 characters has a third, empty piece.
        pieces = [plain[at : at + PIECE] for at in range(0, len(plain) + 1, PIECE)] if len(plain) > PIECE else [plain]
        number = next(self._texts) % 0xFFFF + 1 if len(pieces) > 1 else 0
        for seq, piece in enumerate(pieces):
            fields = {"severity": SEVERITIES.index(severity), "text": piece, "id": number, "chunk_seq": seq}
            yield self.pack(sysid, COMPANION, "STATUSTEXT", **fields)


class Answerer(ABC):
    """Takes what clients ask, and says which frames of vehicles they must not get.

    Called on carrying threads: it must be quick, must not wait, and must not raise (what it raises is said once: a
    client's frame is then refused, a vehicle's passes). Slow work belongs on ``ground.loop``.
    """

    takes: frozenset[str]
    """names of the clients' messages that are offered"""
    watches: frozenset[str] = frozenset()
    """names of the vehicles' messages that :meth:`withhold` is asked about"""

    @abstractmethod
    def offer(self, client: Client, frame: Frame) -> bool:
        """A client's frame; True: taken, it goes to no vehicle. On the thread of the client's endpoint."""

    def withhold(self, origin: Origin, data: bytes) -> bool:
        """A vehicle's frame; True: no client gets it. On Zenoh's thread."""
        return False

    @abstractmethod
    def close(self) -> None:
        """The bridge ends. On the event loop."""
