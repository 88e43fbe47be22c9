"""The cameras of a world: what :meth:`World.camera` gives, and what its ticks hand to those that are served."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput, missing_extra
from zmav.sim.arrays import Array
from zmav.sim.camera.projection import View, camera_matrix, camera_rotation, quat_matrix
from zmav.sim.camera.scene import Scene, check_scene
from zmav.sim.camera.spec import CameraSpec, PadSpec
from zmav.sim.external import External
from zmav.sim.fleets.base import Fleet
from zmav.sim.spec import VehicleSpec
from zmav.sim.vehicle import SimVehicle

if TYPE_CHECKING:
    from zmav.sim.camera.figures import Figure
    from zmav.sim.camera.ground import GroundTexture
    from zmav.sim.camera.render import Renderer

Image = NDArray[np.uint8]


class Poses(NamedTuple):
    """Where all vehicles of a world are at one moment, one column each in the world's order: metres NED, and (w, x, y,
    z) body to world.
    """

    time_s: float
    """simulated"""
    unix_s: float
    """UTC"""
    pos: Array
    q: Array


Inside = Callable[[Callable[[], Poses]], Poses]


class Frame(NamedTuple):
    """One picture, and what was true when it was taken."""

    image: Image
    """(height, width, 3) BGR"""
    time_s: float
    """simulated seconds"""
    unix_s: float
    """UTC as the vehicle's GPS tells it"""
    sequence: int
    """counts this camera's pictures from 0"""
    position: tuple[float, float, float]
    """of the optical centre, metres NED of the world"""
    rotation: Array
    """(3, 3) camera (x right, y down, z ahead) to world NED"""


class Actor(NamedTuple):
    """One vehicle: the one in that column of its fleet."""

    name: str
    camera: CameraSpec | None
    pad: PadSpec | None
    fleet: Fleet
    column: int


def actors(specs: Sequence[VehicleSpec], own: Sequence[SimVehicle], external: Sequence[External]) -> list[Actor]:
    """Everybody in the order of ``specs``: vehicles that the simulator flies, and those that other flight stacks do."""
    ours, theirs = iter(own), iter(external)
    found = []
    for spec in specs:
        if spec.stack is None:
            vehicle = next(ours)
            seat = vehicle.node.seat
            found.append(Actor(vehicle.name, spec.camera, spec.pad, seat.fleet, seat.index))
        else:
            other = next(theirs)
            found.append(Actor(other.name, spec.camera, spec.pad, other.plant, 0))
    return found


class Server(Protocol):
    """What gives the pictures away while the world runs (:mod:`zmav.sim.camera.serve`)."""

    def tick(self, now: float, snapshot: Callable[[], Poses]) -> None: ...

    def close(self) -> None: ...


class SimCamera:
    """One vehicle's camera. Pictures may be taken in any thread, one at a time."""

    def __init__(self, name: str, index: int, spec: CameraSpec, cameras: Cameras) -> None:
        self.name = name
        self.spec = spec
        self.blackout: Literal["black", "frozen"] | None = None
        """a fault: pictures are black, or show what the last good one did"""
        self._index = index
        self._cameras = cameras
        self._lock = threading.Lock()
        self._sequence = 0
        self._last: Image = np.zeros((spec.height, spec.width, 3), dtype=np.uint8)
        self._renderer: Renderer | None = None

    @property
    def matrix(self) -> Array:
        """(3, 3): K."""
        return camera_matrix(self.spec)

    def frame(self) -> Frame:
        """A picture of now."""
        return self.capture(self._cameras.look())

    def prepare(self) -> None:
        """Draw what every picture is made from, else the first one does."""
        with self._lock:
            self._made()

    def capture(self, poses: Poses) -> Frame:
        """A picture of the world at ``poses``."""
        with self._lock:
            renderer = self._made()
            q = poses.q[:, self._index]
            center = poses.pos[:, self._index] + quat_matrix(q) @ np.array(self.spec.offset_m)
            size = (self.spec.width, self.spec.height)
            view = View(self.matrix, camera_rotation(self.spec, q), renderer.lifted(center), size)
            if self.blackout is None:
                self._last = renderer.render(view, poses.pos, poses.q, self._index)
            image = np.zeros_like(self._last) if self.blackout == "black" else self._last.copy()
            sequence, self._sequence = self._sequence, self._sequence + 1
        north, east, down = view.center.tolist()
        return Frame(image, poses.time_s, poses.unix_s, sequence, (north, east, down), view.rotation)

    def _made(self) -> Renderer:
        """What renders, made when it is first needed."""
        if self._renderer is None:
            from zmav.sim.camera.render import Renderer

            self._renderer = Renderer(*self._cameras.surroundings())
        return self._renderer


class Cameras:
    """All cameras of a world and the scene they look at.

    ``inside``: runs a function in the world's thread, if one runs, else here. Raises :class:`BadConfig` where OpenCV is
    missing.
    """

    def __init__(self, actors: Sequence[Actor], scene: Scene, seed: int, epoch_s: float, inside: Inside) -> None:
        if importlib.util.find_spec("cv2") is None:
            raise missing_extra("a simulated camera", "OpenCV", "vision")
        check_scene(scene)
        self.epoch_s = epoch_s
        """UTC at 0 s of simulated time; later, where that fell behind real time"""
        self.all = [SimCamera(a.name, i, a.camera, self) for i, a in enumerate(actors) if a.camera is not None]
        self.server: Server | None = None
        """is ticked, and closed with the world"""
        self._actors = actors
        self._place = scene, seed
        self._inside = inside
        self._lock = threading.Lock()
        self._surroundings: tuple[GroundTexture, list[Figure]] | None = None
        self._now = 0.0

    def get(self, name: str) -> SimCamera:
        """The camera of that vehicle; :class:`BadInput` names those that have one."""
        for camera in self.all:
            if camera.name == name:
                return camera
        expected = ", ".join(camera.name for camera in self.all)
        raise BadInput(f"{name} has no camera; these have: {expected}", field="camera", value=name, expected=expected)

    # ---- what the world's thread does

    def tick(self, now: float) -> None:
        """Hand out where everything is, where a served camera is due; called after every tick."""
        self._now = now
        if self.server is not None:
            self.server.tick(now, self.snapshot)

    def snapshot(self) -> Poses:
        """Where everything is now."""
        bodies = [(actor.fleet.dynamics, actor.column) for actor in self._actors]
        pos = np.stack([body.pos[:, column] for body, column in bodies], axis=1)
        q = np.stack([body.q[:, column] for body, column in bodies], axis=1)
        return Poses(self._now, self.epoch_s + self._now, pos, q)

    # ---- what any thread does

    def look(self) -> Poses:
        """Where everything is between two ticks."""
        return self._inside(self.snapshot)

    def close(self) -> None:
        """End serving."""
        server, self.server = self.server, None
        if server is not None:
            server.close()

    def surroundings(self) -> tuple[GroundTexture, list[Figure]]:
        """The ground, and what each vehicle looks like; the same for all cameras."""
        from zmav.sim.camera.figures import figure
        from zmav.sim.camera.ground import GroundTexture

        with self._lock:
            if self._surroundings is None:
                figures = [figure(actor.fleet.dynamics, actor.pad) for actor in self._actors]
                self._surroundings = GroundTexture(*self._place), figures
            return self._surroundings
