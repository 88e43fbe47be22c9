"""What the parts of an ArduPilot know of their vehicle: its state, its modes, and what it does in a failsafe.

The parts (radio, fence, filter, failsafes) are put together in :mod:`.vehicle`.
"""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from typing import ClassVar

import msgspec

from zmav.sim.autopilots.ardupilot.boot import STAGES, Boot, Stage
from zmav.sim.autopilots.ardupilot.mission import Mission, Performer, State
from zmav.sim.autopilots.ardupilot.plan import ABSOLUTE, TERRAIN
from zmav.sim.autopilots.base import Autopilot
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector
from zmav.sim.geo import Position, to_ned

EMERGENCY, ALERT, CRITICAL, ERROR, WARNING, NOTICE, INFO, DEBUG = range(8)  # MAV_SEVERITY
CHANGE_SPEED, SET_HOME, SET_SERVO = 178, 179, 183  # MAV_CMD
# What the mission library carries out by itself: done at once, and no item is reported reached.
UNREPORTED = frozenset((181, 183, 203, 206, 1000, 2000, 2001))
DISARM = -1
Steps = tuple[int | str, ...]
"""modes that are tried until one is entered, what is said before them, or :data:`DISARM`"""


# ---- what GUIDED is asked for

Quaternion = tuple[float, float, float, float]


class Doing(enum.Enum):
    """What GUIDED does now."""

    HOLD = "hold"
    TAKEOFF = "takeoff"
    POSITION = "position"
    POSITION_VELOCITY = "position and velocity"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    ATTITUDE = "attitude"


class YawWish(msgspec.Struct, frozen=True):
    """The yaw part of a target: an angle (radians, absolute), a rate (rad/s), or neither."""

    angle: float | None = None
    rate: float | None = None


class Target(msgspec.Struct, frozen=True):
    """A target in the world's NED (metres, m/s, m/s^2); what is None is left to the vehicle."""

    pos: Vector | None = None
    vel: Vector | None = None
    acc: Vector | None = None
    yaw: YawWish = YawWish()


class AttitudeTarget(msgspec.Struct, frozen=True):
    """An attitude (w, x, y, z; body to world) that turns at body ``rates`` (rad/s), or without one the rates alone;
    and a vertical speed in m/s (positive up) or a thrust, -1 to 1.
    """

    attitude: Quaternion | None
    rates: Vector
    climb: float | None
    thrust: float | None

    @property
    def lifts(self) -> bool:
        """It takes a landed copter off the ground."""
        return (self.climb or 0.0) > 0.0 or (self.thrust or 0.0) > 0.0


# ---- the vehicle


class VehicleState(Autopilot, ABC):
    """One vehicle, as its parts see it."""

    NOT_SIMULATED: ClassVar[Mapping[int, str]]
    """modes that the real firmware has and this one does not"""
    STAGES: ClassVar[tuple[Stage, ...]] = STAGES
    """how it wakes up"""
    RADIO_PARAMS: ClassVar[tuple[str, str]] = ("FS_THR_ENABLE", "FS_THR_VALUE")
    AXES: ClassVar[tuple[tuple[str, int, int, int], ...]] = (
        ("y", 0, 1, -1000),
        ("x", 1, -1, -1000),
        ("z", 2, 1, 0),
        ("r", 3, 1, -1000),
    )
    """of MANUAL_CONTROL: which channel (from 0) each moves, its sign, and its lowest value; the highest is 1000"""
    GCS_PARAMS: ClassVar[tuple[str, str]] = ("FS_GCS_ENABLE", "FS_GCS_TIMEOUT")

    mode: Mode
    mode_by_fence: bool
    auto: AutoMode
    guided: GuidedMode
    reactions: Reactions
    boot: Boot
    mission: Mission
    landed: bool
    dt: float
    """s between two updates"""
    report: Callable[[str], None]
    """sends a message of the reports on every link"""
    reached: Callable[[int], None]
    """tells of a mission item"""

    @abstractmethod
    def set_mode(self, number: int, *, by_fence: bool = False) -> bool:
        """Change mode; says why where it does not."""

    @abstractmethod
    def disarm(self, *, forced: bool = False) -> bool:
        """Stop the motors; refused in the air unless forced."""

    @abstractmethod
    def move_home(self, place: Vector | None, *, lock: bool = False) -> bool:
        """Home is there (the world's NED) or, with None, here; False before there is an origin."""

    @abstractmethod
    def sized(self, param: str, count: int) -> None:
        """A list has another length; the parameter says so."""

    @abstractmethod
    def set_servo(self, channel: int, pwm: int) -> bool:
        """Set an output that nothing else drives; else False, with the reason said."""

    @property
    @abstractmethod
    def position_ok(self) -> bool:
        """The EKF holds a position good enough to go by."""

    @property
    def height(self) -> float:
        """Above home, m."""
        return self.home_world[2] - self.sense.down

    @property
    def from_home(self) -> float:
        """Over the ground, m."""
        return math.hypot(self.sense.north - self.home_world[0], self.sense.east - self.home_world[1])

    @abstractmethod
    def above_home(self, north: float, east: float) -> float:
        """m by which the ground there (the world's NED) is higher than at home, as far as it was told."""

    @property
    def voltage(self) -> float:
        return self.power.volts

    def place_of(self, item: Item, default: Vector | None) -> Vector:
        """Where a mission item is, in the world's NED; what it leaves open (zeros) is as in ``default``."""
        north, east, down = to_ned(Position(item.x * 1e-7, item.y * 1e-7, item.z), self.world)
        if item.frame not in ABSOLUTE:
            down = self.home_world[2] - item.z
        if item.frame in TERRAIN:
            down -= self.above_home(north, east)
        if default is None:
            return north, east, down
        if item.here:
            north, east = default[0], default[1]
        return north, east, default[2] if item.z == 0 else down


class Mode(ABC):
    """A flight mode: one object per mode and vehicle. ``update`` runs at every tick while armed."""

    number: int
    name: str
    needs_position: ClassVar[bool] = True
    armable: ClassVar[bool] = False
    by_pilot: ClassVar[bool] = False
    manual_throttle: ClassVar[bool] = False
    throttle_to_arm: ClassVar[float] = 0.5  # the highest throttle stick that it may be armed with
    changes_speed: ClassVar[bool] = False  # takes DO_CHANGE_SPEED

    def __init__(self, vehicle: VehicleState) -> None:
        self.vehicle = vehicle

    def allows_arming(self) -> bool:
        """It may be armed in it, by its parameters now."""
        return self.armable

    @property
    def is_landing(self) -> bool:
        """On its way down to the ground."""
        return False

    def blocked(self) -> str:
        """Why it is not entered, armed or not; empty: it is."""
        return ""

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
    waiting = False
    """for an origin, to begin the mission then"""

    @property
    @abstractmethod
    def target(self) -> Vector | None:
        """The place that it goes to, in the world's NED."""

    @abstractmethod
    def set_out(self, item: Item) -> None:
        """Begin one of the :attr:`NAVIGATION` commands."""

    @abstractmethod
    def arrived(self, item: Item) -> bool:
        """Whether that one is done."""

    @abstractmethod
    def change_speed(self, item: Item) -> None:
        """DO_CHANGE_SPEED."""

    def leave(self) -> None:
        if self.vehicle.mission.state is State.RUNNING:
            self.vehicle.mission.stop()

    def run_mission(self) -> None:
        """Go on with it, or begin it."""
        if not self.waiting:
            self.vehicle.mission.update()
        elif self.vehicle.boot.has("origin"):
            self.waiting = False
            self.vehicle.mission.start_or_resume()

    def start(self, item: Item) -> None:
        vehicle, command = self.vehicle, item.command
        if command in self.NAVIGATION:
            self.set_out(item)
        elif command == CHANGE_SPEED:
            self.change_speed(item)
        elif command == SET_HOME:
            here = item.p1 == 1 or (item.here and item.z == 0)
            vehicle.move_home(None if here else vehicle.place_of(item, None))
        elif command == SET_SERVO:
            vehicle.set_servo(int(item.p1), int(item.p2))

    def verify(self, item: Item) -> bool:
        if item.command in UNREPORTED:
            return True
        done = item.command not in self.NAVIGATION or self.arrived(item)
        if done:
            self.vehicle.reached(item.seq)
        return done


class Reactions(ABC):
    """What a kind of ArduPilot does when one of its failsafes or its fence trips, with its own texts, parameters and
    modes. :mod:`.failsafe` and :mod:`.fence` say when.
    """

    BATTERY_URGENCY: ClassVar[tuple[int, ...]]
    """the values of BATT_FS_LOW_ACT, the one that others give way to first"""
    ACTIONS: ClassVar[Mapping[int, Steps]]
    """what the failsafes' actions are, by the values of BATT_FS_LOW_ACT; others do nothing"""

    def __init__(self, vehicle: VehicleState) -> None:
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
