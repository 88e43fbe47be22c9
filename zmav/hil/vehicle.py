"""A vehicle that a flight stack outside the simulator flies: its place in the world, and its time beside it."""

from __future__ import annotations

import errno
import math
import selectors
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

from zmav.errors import BadUrl, PortInUse
from zmav.hil.plant import Plant
from zmav.sim.endpoints import Wiring
from zmav.sim.status import VehicleStatus

LOOPBACK = "127.0.0.1"
PATIENCE_S = 0.5  # of wall time: for so long the world waits for a stack that was heard of
TURNING = 0.02  # throttle from which rotors count as turning


class External(ABC):
    """Base of all of them. Everything is called in the world's thread.

    Its time follows the stack, and never runs ahead of the world's: :meth:`grant` lets it go on to the world's time,
    and while :meth:`behind` says so the world waits for it. A stack that is silent is left out, and goes on from the
    world's time of then.

    ``say``: takes what a person should know, a line at a time.
    """

    autopilot = "external"
    feels: ClassVar[frozenset[str]] = frozenset()
    """kinds of faults (:mod:`zmav.sim.faults`) of its body and sensors that reach the stack"""

    def __init__(self, name: str, sysid: int, plant: Plant, say: Callable[[str], None]) -> None:
        self.name = name
        self.sysid = sysid
        self.plant = plant
        self.say = say
        self.connected = False
        self.reached: tuple[str, ...] = ()
        """where the stack's own MAVLink is found, as far as that is known"""
        self._ended = ""
        self._now = 0.0  # the world's time granted
        self._offset = 0.0  # what the world's time is ahead of the plant's
        self._heard = -math.inf  # wall time

    @abstractmethod
    def open(self, wiring: Wiring) -> None:
        """Open what the stack connects to. Raises :class:`PortInUse`, :class:`BadUrl`."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""

    @property
    @abstractmethod
    def url(self) -> str:
        """Where the stack connects to, or is found."""

    @property
    def urls(self) -> tuple[str, ...]:
        """First where MAVLink clients reach the stack, where that is known."""
        return self.reached or tuple(filter(None, [self.url]))

    @property
    @abstractmethod
    def waits(self) -> bool:
        """The stack waits for time to pass."""

    @abstractmethod
    def proceed(self) -> None:
        """Make what steps are granted by now."""

    # ---- time

    def heard(self) -> None:
        """The stack has just spoken."""
        self._heard = time.monotonic()
        if not self.connected:
            self.connected = True
            self.restarted()

    def restarted(self) -> None:
        """The plant's clock has started again."""
        self._offset = self._now - self.plant.time_s

    def granted(self, seconds: float) -> bool:
        """May the plant go on by ``seconds``?"""
        return self.plant.time_s + seconds + self._offset <= self._now + 1e-9

    def grant(self, now: float) -> None:
        """The world has come to ``now``."""
        self._now = now
        if not self.connected:
            return
        if not self.waits and self._stalled():
            self._offset = now - self.plant.time_s
            return
        self.proceed()

    def behind(self) -> bool:
        """Time that is granted has not passed here, and the stack can be expected to use it."""
        return self.connected and not self.waits and not self._stalled()

    def _stalled(self) -> bool:
        return time.monotonic() - self._heard > PATIENCE_S

    # ---- what there is to see

    def flush(self) -> None:  # noqa: B027 - not every stack has something waiting
        """Send what waits to be sent."""

    @property
    def armed(self) -> bool:
        """As far as its actuators tell: something turns."""
        return any(abs(value) > TURNING for value in self.plant.values)

    @property
    def links(self) -> int:
        return int(self.connected)

    def lost(self, how: str) -> None:
        """The stack's program has ended."""
        self._ended = how
        self.connected = False
        self.plant.drive([0.0] * len(self.plant.values))

    def status(self) -> VehicleStatus:
        now = self.plant.truth()
        north, east, down = now.pos
        urls = self.urls
        return VehicleStatus(
            name=self.name,
            sysid=self.sysid,
            autopilot=self.autopilot,
            airframe=self.plant.craft.name,
            url=urls[0] if urls else "",
            urls=urls,
            mode="ended" if self._ended else "external" if self.connected else "waiting",
            armed=self.armed,
            landed=now.contact,
            ready=self.connected,
            ned_m=(north, east, down),
            height_m=self.plant.start[2] - down,
            speed_mps=math.sqrt(sum(v * v for v in now.vel)),
            heading_deg=math.degrees(now.euler[2]) % 360.0,
            battery_pct=max(round(100.0 * float(self.plant.battery.charge[0])), 0),
            links=self.links,
            failed=self._ended or None,
        )


class Served(External):
    """One whose stack comes to us, at ``port`` of loopback (0: any free one)."""

    transport: ClassVar[str]
    """tcp or udp"""
    scheme: ClassVar[str]
    """of its URL"""

    def __init__(self, name: str, sysid: int, plant: Plant, say: Callable[[str], None], port: int) -> None:
        super().__init__(name, sysid, plant, say)
        self.port = port
        self.bad = 0
        self._socket: socket.socket | None = None
        self._selector: selectors.BaseSelector | None = None

    @abstractmethod
    def _opened(self) -> socket.socket:
        """The socket at :attr:`port`; raises :class:`OSError`."""

    @abstractmethod
    def _ready(self) -> None:
        """It can be read."""

    def open(self, wiring: Wiring) -> None:
        where = f"{self.transport}:{LOOPBACK}:{self.port}"
        try:
            opened = self._opened()
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise PortInUse(f"{where} is in use by another program", port=self.port) from error
            expected = "an address of this machine"
            raise BadUrl(f"{where}: {error}", field="host", value=LOOPBACK, expected=expected) from error
        opened.setblocking(False)
        self.port = int(opened.getsockname()[1])
        self._socket, self._selector = opened, wiring.selector
        wiring.selector.register(opened, selectors.EVENT_READ, self._ready)

    def close(self) -> None:
        if self._socket is not None and self._selector is not None:
            self._selector.unregister(self._socket)
            self._socket.close()
            self._socket = None

    @property
    def url(self) -> str:
        return f"{self.scheme}:{LOOPBACK}:{self.port}"
