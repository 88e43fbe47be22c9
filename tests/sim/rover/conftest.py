"""A ground station at one simulated rover, and what it is often told."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from tests.sim.conftest import POSITION, Gcs, MakeGcs
from zmav.sim import VehicleSpec
from zmav.sim.autopilots.ardurover.rover import ArduRover

GUIDED, HOLD, MANUAL, AUTO, RTL = 15, 4, 0, 10, 11


class Yard:
    """A rover, and the ground station beside it."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs = gcs
        self.rover: ArduRover = gcs.vehicle.rover

    def mode(self, number: int) -> int:
        return self.gcs.command(176, 1, number)

    def ready(self, mode: int = GUIDED) -> None:
        """Armed in a mode, with a position."""
        self.gcs.until(lambda: self.rover.position_ok)
        assert self.mode(mode) == 0
        assert self.gcs.command(400, 1) == 0
        self.gcs.clear()

    def goto(self, north: float, east: float, frame: int = 1, mask: int = POSITION, **more: float) -> None:
        fields = {"coordinate_frame": frame, "type_mask": mask, "x": north, "y": east, **more}
        self.gcs.send("SET_POSITION_TARGET_LOCAL_NED", **fields)

    def sticks(self, steering: int = 1500, throttle: int = 1500) -> None:
        """Pulses, as an override."""
        self.gcs.send(
            "RC_CHANNELS_OVERRIDE",
            **{f"chan{i}_raw": 65535 for i in (2, *range(4, 9))},
            chan1_raw=steering,
            chan3_raw=throttle,
        )

    def keep(self, seconds: float, send: Callable[[], Any]) -> None:
        """Say it ten times a second."""
        for _ in range(round(seconds * 10)):
            send()
            self.gcs.world.step(0.1)

    @property
    def place(self) -> tuple[float, float]:
        north, east, _ = self.rover.local
        return north, east

    @property
    def speed(self) -> float:
        """m/s over the ground, along the nose."""
        s = self.rover.sense
        return s.vn * math.cos(s.yaw) + s.ve * math.sin(s.yaw)

    def stands(self) -> bool:
        return abs(self.speed) < 0.02


MakeYard = Callable[..., Yard]


@pytest.fixture
def make_yard(make_gcs: MakeGcs) -> MakeYard:
    """A world with one rover; ``params`` are the vehicle's, the rest the world's."""

    def make(params: dict[str, float] | None = None, **options: Any) -> Yard:
        spec = VehicleSpec(autopilot="ardurover", params=params or {})
        return Yard(make_gcs([spec], **options))

    return make


@pytest.fixture
def yard(make_yard: MakeYard) -> Yard:
    """One Ackermann rover, awake within half a second."""
    return make_yard()
