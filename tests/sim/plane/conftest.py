"""A ground station at one simulated ArduPlane, and what it is often told."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from tests.sim.conftest import Gcs, MakeGcs
from tests.sim.plans import degrees
from zmav.sim import VehicleSpec
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.fleets.plane import PlaneFleet

MANUAL, CIRCLE, STABILIZE, TRAINING, ACRO, FBWA, FBWB, CRUISE = range(8)
AUTO, RTL, LOITER, TAKEOFF, GUIDED, AUTOLAND = 10, 11, 12, 13, 15, 26
ARM, SET_MODE, REPOSITION = 400, 176, 192
TRIM = math.radians(-3.4)  # of pitch, in level flight at 22 m/s
PLANE = VehicleSpec(autopilot="arduplane", start_ned_m=(0.0, 0.0, 0.0))


class Field:
    """A plane, and the ground station beside it."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs = gcs
        self.plane: ArduPlane = gcs.vehicle.plane

    def mode(self, number: int) -> int:
        return self.gcs.command(SET_MODE, 1, number)

    def ready(self) -> None:
        self.gcs.until(lambda: self.plane.boot.has("prearm"))

    def wait(self, seconds: float) -> None:
        self.gcs.world.step(seconds)

    def take_off(self, then: int = LOITER) -> None:
        """Into the air with mode TAKEOFF, and into another once it is up."""
        self.ready()
        assert self.mode(TAKEOFF) == 0
        assert self.gcs.command(ARM, 1) == 0
        self.gcs.until(lambda: self.plane.height > 48.0)
        self.wait(1.0)
        assert self.mode(then) == 0
        self.gcs.clear()

    def put_up(self, then: int = LOITER, height: float = 60.0) -> None:
        """In the air at once, to the north at 22 m/s over the world's origin, in some mode."""
        self.ready()
        assert self.mode(FBWA) == 0
        assert self.gcs.command(ARM, 1) == 0
        fleet, i = self.gcs.vehicle.node.seat.fleet, self.gcs.vehicle.node.seat.index
        assert isinstance(fleet, PlaneFleet)
        dyn = fleet.dynamics
        dyn.pos[2, i], dyn.vel[0, i], dyn.throttle[i] = -height, 22.0 * self.plane.eas2tas, 0.48
        dyn.q[:, i] = math.cos(TRIM / 2.0), 0.0, math.sin(TRIM / 2.0), 0.0
        dyn.contact[i] = dyn.resting[i] = False
        self.wait(0.1)
        assert self.mode(LOITER) == 0
        self.wait(0.9)
        assert self.mode(then) == 0
        self.gcs.clear()

    def reposition(self, north: float, east: float, up: float, **more: float) -> int:
        x, y = degrees(north, east)
        return self.gcs.command_int(REPOSITION, x=x, y=y, z=up, frame=3, **{"param1": -1.0, **more})

    def set(self, name: str, value: float) -> None:
        self.gcs.send("PARAM_SET", param_id=name, param_value=value, param_type=9)
        assert self.plane.params[name] == pytest.approx(value)

    def heartbeat(self) -> None:
        self.gcs.send("HEARTBEAT", type=6, autopilot=8, mavlink_version=3)

    def keep(self, seconds: float, send: Callable[[], Any]) -> None:
        """Say it five times a second."""
        for _ in range(round(seconds * 5)):
            send()
            self.wait(0.2)

    def away(self, north: float = 0.0, east: float = 0.0) -> float:
        """Over the ground from a place, m."""
        s = self.plane.sense
        return math.hypot(s.north - north, s.east - east)

    def track(self, seconds: float, look: Callable[[], float]) -> list[float]:
        """What ``look`` gives, twice a second."""
        found = []
        for _ in range(round(seconds * 2)):
            self.wait(0.5)
            found.append(look())
        return found


MakeField = Callable[..., Field]


@pytest.fixture
def make_field(make_gcs: MakeGcs) -> MakeField:
    def make(**options: Any) -> Field:
        return Field(make_gcs([PLANE], **options))

    return make


@pytest.fixture
def field(make_field: MakeField) -> Field:
    """One plane on the ground at the world's origin, nose to the north, awake within half a second."""
    return make_field()


@pytest.fixture
def flying(field: Field) -> Field:
    """The same, circling some 60 m up."""
    field.put_up()
    return field
