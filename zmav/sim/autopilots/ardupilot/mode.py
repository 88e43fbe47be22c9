"""A flight mode of an ArduPilot: one object per mode and vehicle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots.ardupilot.mission import Performer
from zmav.sim.autopilots.ardupilot.targets import AttitudeTarget, Doing, Target
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

CHANGE_SPEED, SET_HOME, LAND_START = 178, 179, 189  # MAV_CMD
REGIONS = (195, 197, 201)  # of interest
# What the mission library carries out by itself: done at once, and no item is reported reached.
UNREPORTED = frozenset((181, 183, 203, 206, 1000, 2000, 2001))


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


class GuidedMode(Mode):
    """GUIDED, as the protocol sees it."""

    doing = Doing.HOLD
    target = Target()

    def hold(self) -> None:
        """Stop: what a target that makes no sense leads to as well."""

    @abstractmethod
    def aim(self, target: Target) -> None:
        """Take a target."""

    def lean(self, target: AttitudeTarget) -> None:
        """Take an attitude target."""


class AutoMode(Mode, Performer):
    """AUTO: the mission's performer. A kind of vehicle says how it goes to places, and when it is there."""

    NAVIGATION: ClassVar[Collection[int]]
    """the commands that it flies or drives, one at a time; any other is done as soon as it is begun"""

    @property
    @abstractmethod
    def target(self) -> Vector | None:
        """The place that it goes to, in the world's NED."""

    @property
    def paused(self) -> bool:
        """It stands still on its way."""
        return False

    def pause(self) -> bool:
        """Stand still on the way; False where there is none."""
        return False

    def resume(self) -> None:
        """Go on after :meth:`pause`."""

    @abstractmethod
    def set_out(self, item: Item) -> None:
        """Begin one of the :attr:`NAVIGATION` commands."""

    @abstractmethod
    def arrived(self, item: Item) -> bool:
        """Whether that one is done."""

    @abstractmethod
    def change_speed(self, item: Item) -> None:
        """DO_CHANGE_SPEED."""

    # ---- the mission's performer

    def start(self, item: Item) -> bool:
        vehicle, command = self.vehicle, item.command
        nowhere = item.here and item.z == 0
        if command in self.NAVIGATION:
            self.set_out(item)
        elif command == CHANGE_SPEED:
            self.change_speed(item)
        elif command == SET_HOME:
            vehicle.move_home(None if item.p1 == 1 or nowhere else vehicle.place_of(item, None))
        elif command in REGIONS:
            vehicle.region_of_interest(None if nowhere else vehicle.place_of(item, None))
        else:
            return command == LAND_START or vehicle.payload.perform(item)
        return True

    def verify(self, item: Item) -> bool:
        if item.command in UNREPORTED:
            return True
        done = item.command not in self.NAVIGATION or self.arrived(item)
        if done:
            self.vehicle.reached(item.seq)
        return done
