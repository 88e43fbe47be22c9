"""What a fault is, and what it happens to."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import msgspec

from zmav.errors import BadInput
from zmav.sim.fleets.base import Seat

if TYPE_CHECKING:
    from zmav.sim.camera.cameras import SimCamera
    from zmav.sim.vehicle import SimVehicle

Undo = Callable[[], None]


class Victim(NamedTuple):
    """A vehicle that faults can be put on.

    ``own_vehicle`` is None for one that a flight stack outside the simulator flies: its sensors, motors and battery can
    fail, its autopilot and its links are its own. ``camera`` likewise where it has none. ``seed`` differs from fault to
    fault and is the same in every run. ``end`` ends a fault of that kind that it has, ``now`` gives simulated seconds.
    """

    name: str
    seat: Seat
    own_vehicle: SimVehicle | None
    camera: SimCamera | None
    seed: str
    end: Callable[[str], None]
    now: Callable[[], float]

    @property
    def vehicle(self) -> SimVehicle:
        """The simulated autopilot and its links; :class:`BadInput` where there are none."""
        if self.own_vehicle is None:
            text = f"{self.name} is flown by a stack of its own: only its body can fail"
            raise BadInput(text, field="vehicle", value=self.name, expected="a vehicle with a simulated autopilot")
        return self.own_vehicle


class FaultStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One fault that is on: simulated seconds when it began and when it ends by itself (None: it does not)."""

    vehicle: str
    kind: str
    parameters: dict[str, Any]
    since_s: float
    until_s: float | None


class Fault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all kinds; the fields of one are its parameters, with their units in their names or descriptions."""

    KIND: ClassVar[str] = ""
    ONCE: ClassVar[bool] = False
    """It happens and is over."""

    def check(self, victim: Victim) -> None:
        """:class:`BadInput` where that vehicle cannot have it; nothing has happened then."""

    @abstractmethod
    def begin(self, victim: Victim) -> Undo:
        """Let it happen to one that can have it; gives what ends it."""


class AutopilotFault(Fault, frozen=True):
    """Base of what only an autopilot of the simulator's own can have."""

    def check(self, victim: Victim) -> None:
        _ = victim.vehicle  # refused where there is none
