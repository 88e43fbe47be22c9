"""What a world needs to know of vehicles that flight stacks outside the simulator fly. :mod:`zmav.hil` has them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import ClassVar, Protocol

from zmav.sim.endpoints import Wiring
from zmav.sim.fleets.base import Fleet
from zmav.sim.status import VehicleStatus


class External(Protocol):
    """One such vehicle."""

    name: str
    sysid: int
    feels: ClassVar[frozenset[str]]
    """kinds of faults (:mod:`zmav.sim.faults`) of its body and sensors that reach the stack"""

    @property
    def plant(self) -> Fleet:
        """A fleet of this vehicle alone."""

    @property
    def urls(self) -> tuple[str, ...]:
        """First where MAVLink clients reach the stack, where that is known."""


class Externals:
    """All such vehicles of one world; these are none. Everything is called in the world's thread."""

    vehicles: Sequence[External] = ()
    notes: Collection[str] = ()
    """what was said where nobody is to be told"""

    def open(self, wiring: Wiring) -> None:
        """Open everything; nothing where that is done. Raises :class:`PortInUse`, :class:`BadUrl`,
        :class:`BadConfig`; :meth:`close` is for the caller to call then.
        """

    def close(self) -> None:
        """Let go of everything."""

    def grant(self, now: float) -> None:
        """The world has come to ``now``, seconds."""

    def behind(self) -> bool:
        """The world has to wait for one of them."""
        return False

    def flush(self) -> None:
        """Send what waits to be sent."""

    def pids(self) -> dict[str, int]:
        """Process ids of the programs that run, by vehicle."""
        return {}

    def status(self) -> tuple[VehicleStatus, ...]:
        return ()


MakeExternals = Callable[..., Externals]
"""Makes those of a world's vehicles that have a ``stack``, as :class:`zmav.hil.externals.Externals` does."""
