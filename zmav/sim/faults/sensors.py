"""Sensors that fail or lie. What the autopilot makes of it is up to its navigation filter and its failsafes."""

from __future__ import annotations

import functools
import math
from abc import abstractmethod
from typing import Annotated, ClassVar

from msgspec import Meta

from zmav.sim.faults.base import AutopilotFault, Fault, Undo, Victim
from zmav.sim.sensors.troubles import FINE, Trouble

Metres = Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]
Degrees = Annotated[float, Meta(ge=-180.0, le=180.0)]


class SensorFault(Fault, frozen=True):
    """Base of those that are nothing but a sensor's trouble."""

    @abstractmethod
    def trouble(self) -> Trouble: ...

    def begin(self, victim: Victim) -> Undo:
        cause = f"fault {self.KIND}"
        victim.seat.trouble(cause, self.trouble())
        return lambda: victim.seat.trouble(cause, FINE)


class GpsLoss(SensorFault, frozen=True):
    """The GPS receiver has no solution: jammed, or no view of the sky."""

    KIND: ClassVar[str] = "gps-loss"

    def trouble(self) -> Trouble:
        return Trouble(gps_lost=True)


class GpsGlitch(SensorFault, frozen=True):
    """The GPS solution jumps aside by so many metres and stays there; its velocity stays true."""

    KIND: ClassVar[str] = "gps-glitch"
    north: Metres = 50.0
    east: Metres = 0.0
    up: Metres = 0.0

    def trouble(self) -> Trouble:
        return Trouble(gps_shift=(self.north, self.east, -self.up))


class CompassError(SensorFault, frozen=True):
    """The compass reads as if the nose pointed so many degrees farther to the right; or nothing at all (lost)."""

    KIND: ClassVar[str] = "compass"
    degrees: Degrees = 40.0
    lost: bool = False

    def trouble(self) -> Trouble:
        return Trouble(compass_lost=True) if self.lost else Trouble(compass_turn=math.radians(self.degrees))


class BaroError(SensorFault, frozen=True):
    """The barometer reads so many metres too high; or nothing at all (lost)."""

    KIND: ClassVar[str] = "baro"
    metres: Annotated[float, Meta(ge=-10_000.0, le=10_000.0)] = 5.0
    lost: bool = False

    def trouble(self) -> Trouble:
        return Trouble(baro_lost=True) if self.lost else Trouble(baro_shift=self.metres)


class RangefinderError(SensorFault, frozen=True):
    """The downward rangefinder sees nothing; or, with metres, reads so much too far."""

    KIND: ClassVar[str] = "rangefinder"
    metres: Annotated[float, Meta(ge=-1000.0, le=1000.0)] = 0.0

    def trouble(self) -> Trouble:
        return Trouble(range_shift=self.metres) if self.metres else Trouble(range_lost=True)


class ImuError(SensorFault, frozen=True):
    """The accelerometers shake by so many m/s^2 (root mean square), and reach their limit so many times a second."""

    KIND: ClassVar[str] = "imu"
    vibration: Annotated[float, Meta(ge=0.0, le=500.0)] = 40.0
    clipping: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0

    def trouble(self) -> Trouble:
        return Trouble(vibration=self.vibration, clipping=self.clipping)


class PitotLoss(SensorFault, frozen=True):
    """The pitot tube is blocked: it measures no flow."""

    KIND: ClassVar[str] = "pitot"

    def trouble(self) -> Trouble:
        return Trouble(pitot_lost=True)


def _set_receiver(victim: Victim, name: str, value: object) -> Undo:
    """What the receiver makes of corrections, until that is undone."""
    receiver = victim.vehicle.node.receiver
    before = getattr(receiver, name)
    setattr(receiver, name, value)
    return functools.partial(setattr, receiver, name, before)


class CorrectionsLoss(AutopilotFault, frozen=True):
    """Corrections stop: the receiver gets none of those that its autopilot is sent."""

    KIND: ClassVar[str] = "rtcm-loss"

    def begin(self, victim: Victim) -> Undo:
        return _set_receiver(victim, "deaf", True)


class CorrectionsJump(AutopilotFault, frozen=True):
    """The base is not where it says: a solution by its corrections is so many metres aside."""

    KIND: ClassVar[str] = "rtcm-jump"
    north: Metres = 2.0
    east: Metres = 0.0
    up: Metres = 0.0

    def begin(self, victim: Victim) -> Undo:
        return _set_receiver(victim, "jump", (self.north, self.east, -self.up))


class CorrectionsForeign(AutopilotFault, frozen=True):
    """Corrections are another place's: the receiver sees none of that base's satellites, and cannot use them."""

    KIND: ClassVar[str] = "rtcm-foreign"

    def begin(self, victim: Victim) -> Undo:
        return _set_receiver(victim, "foreign", True)
