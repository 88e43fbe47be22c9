"""The camera that an ArduPilot triggers by distance: AP_Camera's first, of a kind that is not looked at.

There is one where CAM1_TYPE was not 0 when it started. Without one ArduPilot takes the command and makes no picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav.sim.autopilots.ardupilot.state import VehicleState
from zmav.sim.geo import Position


class Picture(NamedTuple):
    """What CAMERA_FEEDBACK tells of one."""

    number: int
    """counted from 1 since it started"""
    place: Position
    height: float
    """m above home"""
    attitude: tuple[float, float, float]
    """roll, pitch, yaw; rad"""


class Camera:
    """https://ardupilot.org/copter/docs/common-camera-shutter-with-servo.html"""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.there = False
        self.every = 0.0
        """m from one picture to the next; 0: none"""
        self.taken = 0
        self.last: Picture | None = None
        self._from: tuple[float, float] | None = None

    def power_on(self) -> None:
        """A camera is found at the start alone, and its distance is not kept over it."""
        self.there = self._vehicle.params["CAM1_TYPE"] != 0
        self.every, self.taken, self.last, self._from = 0.0, 0, None, None

    def trigger_every(self, metres: float, *, at_once: bool) -> None:
        """DO_SET_CAM_TRIGG_DIST, which ArduPilot accepts with a camera or without."""
        if not self.there:
            return
        self.every, self._from = max(metres, 0.0), None
        if at_once:
            self._take()

    def update(self) -> None:
        """Take one where it has come so far over the ground since the last, or since it was switched on."""
        if self.every <= 0.0 or not self._vehicle.position_ok:
            return
        here = (self._vehicle.sense.north, self._vehicle.sense.east)
        if self._from is None:
            self._from = here
        elif math.dist(here, self._from) >= self.every:
            self._take()

    def _take(self) -> None:
        vehicle, s = self._vehicle, self._vehicle.sense
        self.taken += 1
        self._from = (s.north, s.east)
        self.last = Picture(self.taken, vehicle.position, vehicle.height, (s.roll, s.pitch, s.yaw))
        vehicle.report("CAMERA_FEEDBACK")
