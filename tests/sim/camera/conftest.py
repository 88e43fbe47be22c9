"""What the camera's tests share: worlds whose vehicles are put anywhere, without flying there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from zmav.sim import VehicleSpec, World
from zmav.sim.arrays import Array, quat_from_euler
from zmav.sim.camera import CameraSpec, Scene
from zmav.sim.camera.cameras import Frame, Poses, SimCamera

Place = tuple[float, ...]
"""north, east, down (m), and roll, pitch, yaw (degrees) where they are not 0"""

PLAIN = Scene(ground="asphalt")
EPOCH_S = 1000.0


def poses(*places: Place, time_s: float = 0.0) -> Poses:
    """Vehicles at ``places``."""
    table = np.array([[*place, *[0.0] * (6 - len(place))] for place in places]).T
    return Poses(time_s, EPOCH_S + time_s, table[:3], quat_from_euler(*np.radians(table[3:6])))


class Studio:
    """A world whose first vehicle has a camera; the others stand where they are put."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.camera: SimCamera = world.camera("quad1")

    def take(self, *places: Place, time_s: float = 0.0) -> Frame:
        """A picture with the vehicles at ``places``; those that are not named are far away."""
        missing = len(self.world.vehicles) - len(places)
        far = [(-5000.0 - 100.0 * i, 0.0, 0.0) for i in range(missing)]
        return self.camera.capture(poses(*places, *far, time_s=time_s))


def pinhole(frame: Frame, camera: SimCamera, points: Array) -> Array:
    """(2, N): where the camera equation puts (3, N) points NED: K [R | t]."""
    local = frame.rotation.T @ (points - np.array(frame.position)[:, None])
    x, y = local[0] / local[2], local[1] / local[2]
    k = camera.matrix
    return np.array([k[0, 0] * x + k[0, 2], k[1, 1] * y + k[1, 2]])


def turned(heading_deg: float, ahead: Array, right: Array) -> tuple[Array, Array]:
    """North and east parts of places in axes with that heading."""
    c, s = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    return ahead * c - right * s, ahead * s + right * c


MakeStudio = Callable[..., Studio]


@pytest.fixture
def make_studio() -> Iterator[MakeStudio]:
    """``make_studio(camera, *other vehicles, **options of the world)``."""
    worlds = []

    def make(camera: CameraSpec | None = None, *others: VehicleSpec, **options: Any) -> Studio:
        options = {"scene": PLAIN, "epoch_s": EPOCH_S, **options}
        first = VehicleSpec(name="quad1", camera=camera or CameraSpec(offset_m=(0.0, 0.0, 0.0)))
        world = World([first, *others], **options)
        worlds.append(world)
        return Studio(world)

    yield make
    for world in worlds:
        world.close()
