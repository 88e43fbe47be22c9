"""What a kind of ArduPilot does when one of its failsafes or its fence trips: tables of its parameters' values.
:mod:`.failsafe` and :mod:`.fence` say when.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

WARNING = 4
DISARM = -1
Steps = tuple[int | str, ...]
"""modes that are tried until one is entered, what is said before them, or :data:`DISARM`"""


class Reactions(ABC):
    """One vehicle's answers, with its own texts, parameters and modes."""

    BATTERY_URGENCY: ClassVar[tuple[int, ...]]
    """the values of BATT_FS_LOW_ACT, the one that others give way to first"""
    ACTIONS: ClassVar[Mapping[int, Steps]]
    """what the failsafes' actions are, by the values of BATT_FS_LOW_ACT; others do nothing"""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle

    def act(self, action: int) -> None:
        """Carry out one of :attr:`ACTIONS`."""
        self.attempt(self.ACTIONS.get(action, ()))

    def attempt(self, steps: Steps, *, by_fence: bool = False) -> bool:
        """Take the steps until a mode is entered; False where none is."""
        for step in steps:
            if isinstance(step, str):
                self._vehicle.say(WARNING, step)
            elif self._vehicle.disarm(forced=True) if step == DISARM else self.enter(step, by_fence=by_fence):
                return True
        return False

    def enter(self, mode: int, *, by_fence: bool) -> bool:
        """Change to a mode; False where it is refused."""
        return self._vehicle.set_mode(mode, by_fence=by_fence)

    def gcs_lost(self) -> None:  # noqa: B027 - a rover's machine looks for itself
        """The ground station is silent. Its overrides are dropped already."""

    def gcs_back(self) -> None:  # noqa: B027 - likewise
        """The ground station is heard again."""

    def radio_changed(self, lost: bool) -> None:  # noqa: B027 - likewise
        """The radio was lost, or is back."""

    def battery_failed(self, action: int) -> None:
        """The battery is low or critical; ``action``: BATT_FS_LOW_ACT or BATT_FS_CRT_ACT."""
        self.act(action)

    def estimate_lost(self) -> None:  # noqa: B027 - a plane goes on flying by what it has
        """The position estimate is gone ("EKF variance" was said)."""

    @abstractmethod
    def fence_breached(self, new: int, beyond_m: float) -> None:
        """Fences of those types (FENCE_TYPE) were breached, by at most so many metres; FENCE_ACTION asks for
        something.
        """

    def gps_glitched(self, on: bool) -> None:  # noqa: B027 - not every kind says anything
        """The filter has come to doubt the GPS, or trusts it again."""

    def lane_switched(self, lane: int) -> None:  # noqa: B027 - likewise
        """The filter of another inertial sensor was chosen."""
