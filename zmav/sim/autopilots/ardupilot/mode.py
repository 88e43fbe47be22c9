"""A flight mode of an ArduPilot: one object per mode and vehicle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle


class Mode(ABC):
    """``update`` runs at every tick while armed."""

    number: int
    name: str
    needs_position: ClassVar[bool] = True
    armable: ClassVar[bool] = False
    by_pilot: ClassVar[bool] = False
    manual_throttle: ClassVar[bool] = False
    throttle_to_arm: ClassVar[float] = 0.5  # the highest throttle stick that it may be armed with
    changes_speed: ClassVar[bool] = False  # takes DO_CHANGE_SPEED

    def __init__(self, vehicle: ArduVehicle) -> None:
        self.vehicle = vehicle

    def allows_arming(self) -> bool:
        return self.armable

    @property
    def is_landing(self) -> bool:
        """On its way down to the ground."""
        return False

    def refusal(self) -> str:
        """Why an armed vehicle cannot enter; empty where it can."""
        return ""

    def enter(self) -> None:  # noqa: B027 - most modes have nothing to do then
        """Called when the mode is taken up, armed or not."""

    def on_arming(self) -> None:
        """The motors were just armed in it."""
        self.enter()

    def leave(self) -> None:  # noqa: B027 - as above
        """Another mode is about to be taken up."""

    def idle(self) -> None:  # noqa: B027 - as above
        """Called instead of :meth:`update` while disarmed."""

    @abstractmethod
    def update(self) -> None:
        """Set this moment's targets."""
