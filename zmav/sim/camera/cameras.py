"""The cameras of a world: what :meth:`World.camera` gives, and what its ticks hand to those that are served."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput, missing_extra
from zmav.sim.arrays import Array, Flags
from zmav.sim.camera.cast import Actor
from zmav.sim.camera.poses import Poses
from zmav.sim.camera.projection import View, camera_matrix, camera_rotation, quat_matrix
from zmav.sim.camera.scene import Scene, check_scene
from zmav.sim.camera.spec import CameraSpec, PadSpec
from zmav.sim.dynamics.body import Body
from zmav.sim.environment import Terrain
from zmav.sim.fleets.base import Fleet

if TYPE_CHECKING:
    from zmav.sim.camera.figures import Figure
    from zmav.sim.camera.ground import Ground
    from zmav.sim.camera.lens import Lens
    from zmav.sim.camera.render import Renderer

T = TypeVar("T")
Image = NDArray[np.uint8]
Inside = Callable[[Callable[[], Poses]], Poses]
MOST_SUBFRAMES = 16  # of a picture with motion blur
BLUR_STEP_PX = 1.5  # how far the ground moves from one to the next


class Frame(NamedTuple):
    """One picture, and what was true when the shutter was half open."""

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
    attitude: tuple[float, float, float, float]
    """of the vehicle, body to world (w, x, y, z)"""
    rotation: Array
    """(3, 3) camera (x right, y down, z ahead) to world NED"""


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
        self._last: Image | None = None
        self._parts: tuple[Renderer, Lens] | None = None

    @property
    def matrix(self) -> Array:
        """(3, 3): K."""
        return camera_matrix(self.spec)

    def frame(self) -> Frame:
        """A picture of now."""
        return self.capture(self._cameras.look())

    def prepare(self) -> None:
        """Draw what every picture is made from, else the first one does. :class:`BadConfig` for a lens that folds."""
        with self._lock:
            self._made()

    def capture(self, poses: Poses) -> Frame:
        """A picture of the world at ``poses``."""
        with self._lock:
            sequence, self._sequence = self._sequence, self._sequence + 1
            return self._frame(self._image(poses, sequence), poses, sequence)

    def encode(self, frame: Frame) -> bytes:
        """As JPEG of the camera's quality."""
        with self._lock:
            return self._made()[1].encode(frame.image)

    def pose(self, poses: Poses) -> tuple[Array, Array]:
        """Optical centre (3,) NED and rotation (3, 3) camera to world."""
        q = poses.q[:, self._index]
        center = poses.pos[:, self._index] + quat_matrix(q) @ np.array(self.spec.offset_m)
        return center, camera_rotation(self.spec, q)

    def attitude(self, poses: Poses) -> tuple[float, float, float, float]:
        """Of the vehicle, body to world (w, x, y, z)."""
        w, x, y, z = poses.q[:, self._index].tolist()
        return w, x, y, z

    def unix_s(self, poses: Poses) -> float:
        """UTC as the vehicle's GPS tells it."""
        return self._cameras.epoch_s + poses.time_s

    def _frame(self, image: Image, poses: Poses, sequence: int) -> Frame:
        center, rotation = self.pose(poses)
        north, east, down = self._made()[0].lifted(center).tolist()
        place, attitude = (north, east, down), self.attitude(poses)
        return Frame(image, poses.time_s, self.unix_s(poses), sequence, place, attitude, rotation)

    def _image(self, poses: Poses, sequence: int) -> Image:
        if self.blackout is not None:
            if self.blackout == "black" or self._last is None:
                return np.zeros((self.spec.height, self.spec.width, 3), dtype=np.uint8)
            return self._last.copy()
        _, lens = self._made()
        # The noise of a picture hangs on its number alone, whatever was looked at before.
        rng = np.random.default_rng([self._cameras.seed, self._index, sequence])
        image = lens.develop(self._exposed(poses), rng)
        self._last = image.copy()
        return image

    def _exposed(self, poses: Poses) -> Image:
        """What falls on the lens while the shutter is open: the mean of so many instants that none shows by itself."""
        exposure = self.spec.exposure_s
        count = min(max(1, round(self._flow(poses) * exposure / BLUR_STEP_PX)), MOST_SUBFRAMES) if exposure else 1
        if count == 1:
            return self._rendered(poses)
        total = np.zeros((*self._made()[1].size[::-1], 3), dtype=np.uint16)
        for i in range(count):
            total += self._rendered(poses.after(exposure * ((i + 0.5) / count - 0.5)))
        result: Image = ((total + count // 2) // count).astype(np.uint8)
        return result

    def _rendered(self, poses: Poses) -> Image:
        renderer, lens = self._made()
        center, rotation = self.pose(poses)
        return renderer.render(View(lens.k, rotation, renderer.lifted(center), lens.size), poses, self._index)

    def _flow(self, poses: Poses) -> float:
        """About how fast anything moves through the picture, pixels a second."""
        renderer, _ = self._made()
        center, _ = self.pose(poses)
        height = max(renderer.backdrop.height(center), 0.05)
        i = self._index
        speed = float(np.linalg.norm(poses.vel - poses.vel[:, i : i + 1], axis=0).max())
        own, turn = float(np.linalg.norm(poses.vel[:, i])), float(np.linalg.norm(poses.rate[:, i]))
        return self.spec.focal * (max(speed, own) / height + 1.4 * turn)

    def _made(self) -> tuple[Renderer, Lens]:
        """What renders, made when it is first needed."""
        if self._parts is None:
            from zmav.sim.camera.lens import Lens
            from zmav.sim.camera.render import Renderer

            cameras = self._cameras
            lens = Lens(self.spec, cameras.scene.light.brightness, np.random.default_rng([cameras.seed, self._index]))
            self._parts = Renderer(cameras.ground(), cameras.terrain, cameras.figures()), lens
        return self._parts


class Cameras:
    """All cameras of a world and the scene they look at.

    ``inside``: runs a function in the world's thread, if one runs, else here. Raises :class:`BadConfig` where OpenCV is
    missing.
    """

    def __init__(
        self, actors: Sequence[Actor], scene: Scene, terrain: Terrain, seed: int, epoch_s: float, inside: Inside
    ) -> None:
        if importlib.util.find_spec("cv2") is None:
            raise missing_extra("a simulated camera", "OpenCV", "vision")
        check_scene(scene)
        self.scene = scene
        self.terrain = terrain
        self.seed = seed
        self.epoch_s = epoch_s
        self.all = [SimCamera(a.name, i, a.camera, self) for i, a in enumerate(actors) if a.camera is not None]
        self._actors = actors
        self._inside = inside
        self._fleets = _columns(actors)
        self._lock = threading.Lock()
        self._ground: Ground | None = None
        self._figures: list[Figure] | None = None
        self._server: Server | None = None
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
        if self._server is not None:
            self._server.tick(now, self.snapshot)

    def snapshot(self) -> Poses:
        """Where everything is now."""
        n = len(self._actors)
        pos, vel, q, rate = np.empty((3, n)), np.empty((3, n)), np.empty((4, n)), np.empty((3, n))
        spinning: Flags = np.zeros(n, dtype=bool)
        for fleet, seats, columns in self._fleets:
            body = fleet.dynamics
            pos[:, columns], vel[:, columns] = body.pos[:, seats], body.vel[:, seats]
            q[:, columns], rate[:, columns] = body.q[:, seats], body.rate[:, seats]
            rotors = getattr(body, "rotor", None)
            if rotors is not None:
                spinning[columns] = rotors[:, seats].any(0)
        return Poses(self._now, pos, vel, q, rate, spinning)

    # ---- what any thread does

    def look(self) -> Poses:
        """Where everything is between two ticks."""
        return self._inside(self.snapshot)

    @property
    def served(self) -> bool:
        """A server is attached."""
        return self._server is not None

    def attach(self, server: Server) -> None:
        """Have ``server`` ticked, and closed with the world."""
        self._server = server

    def close(self) -> None:
        """End serving."""
        server, self._server = self._server, None
        if server is not None:
            server.close()

    def ground(self) -> Ground:
        from zmav.sim.camera.ground import Ground

        with self._lock:
            if self._ground is None:
                self._ground = Ground(self.scene, self.seed)
            return self._ground

    def figures(self) -> list[Figure]:
        """What each vehicle looks like; those of a kind share it."""
        with self._lock:
            if self._figures is None:
                known: dict[tuple[int, PadSpec | None], Figure] = {}
                self._figures = []
                for actor in self._actors:
                    key = id(actor.fleet), actor.pad
                    if key not in known:
                        known[key] = _figure(actor.fleet.dynamics, actor.pad)
                    self._figures.append(known[key])
            return self._figures


def _columns(actors: Sequence[Actor]) -> list[tuple[Fleet, list[int], list[int]]]:
    """Each fleet with its columns, and whose they are in the world's order."""
    found: dict[int, tuple[Fleet, list[int], list[int]]] = {}
    for i, actor in enumerate(actors):
        _, seats, columns = found.setdefault(id(actor.fleet), (actor.fleet, [], []))
        seats.append(actor.column)
        columns.append(i)
    return list(found.values())


def _figure(body: Body, pad: PadSpec | None) -> Figure:
    from zmav.sim.camera.figures import copter_figure, plane_figure, rover_figure
    from zmav.sim.dynamics.copter import CopterDynamics
    from zmav.sim.dynamics.plane import PlaneDynamics
    from zmav.sim.dynamics.rover import RoverDynamics

    if isinstance(body, RoverDynamics):
        frame = body.frame
        return rover_figure((frame.length_m, frame.width_m, frame.height_m), frame.wheelbase_m, frame.track_m, pad)
    if isinstance(body, PlaneDynamics):
        return plane_figure(body.wing.span_m, pad)
    assert isinstance(body, CopterDynamics), body
    return copter_figure(body.airframe.rotors, pad)
