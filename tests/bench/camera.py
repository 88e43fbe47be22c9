"""What a picture of the simulated camera costs, on one core and one thread.

    python tests/bench/camera.py [FRAMES]

Prints the median and the 99th percentile of the CPU time of one 640x480 picture in several places: standing still
(every texture known), flying at 5 m/s (new ground all the time), with a pad that fills the picture, tilted, and to the
horizon. Beside them is the straightforward way in the same run: a ray
for every pixel in numpy, its point on the ground, and the four texels about it, of a texture that is there already.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim import VehicleSpec, World
from zmav.sim.arrays import Array, quat_from_euler
from zmav.sim.camera import CameraSpec, PadSpec, Road, Scene
from zmav.sim.camera.cameras import Poses, SimCamera
from zmav.sim.camera.ground import FINEST_M
from zmav.sim.camera.serve import JPEG_QUALITY

SCENE = Scene(roads=(Road(points=((-500.0, -12.0), (500.0, -9.0))),))
CARRIER = VehicleSpec(name="carrier", pad=PadSpec())
Place = Callable[[int], tuple[float, ...]]


def poses(place: tuple[float, ...]) -> Poses:
    """The camera's vehicle at ``place`` (north, east, down, degrees of roll, pitch, yaw), the other near the origin."""
    table = np.array([place, (0.4, 0.3, 0.0, 0.0, 0.0, 30.0)]).T
    return Poses(0.0, 0.0, table[:3], quat_from_euler(*np.radians(table[3:])))


def measure(name: str, camera: SimCamera, place: Place, frames: int) -> float:
    """Prints one line; gives the median, s."""
    camera.capture(poses(place(0)))
    spent = []
    for i in range(frames):
        where = poses(place(i))
        start = time.thread_time()
        camera.capture(where)
        spent.append(time.thread_time() - start)
    return report(name, spent)


def report(name: str, spent: list[float]) -> float:
    median, late = np.percentile(spent, (50, 99))
    print(f"{name:58s} {median * 1e3:8.2f} {late * 1e3:8.2f}")
    return float(median)


class RayCast:
    """Every pixel's ray cut with the ground, in numpy; the ground is one picture of ``texel`` metres."""

    def __init__(self, ground: NDArray[np.uint8], texel: float) -> None:
        self.ground = ground
        self.texel = texel
        v, u = np.mgrid[0:480, 0:640].astype(float)
        self.rays = np.stack([(u.ravel() - 319.5) / 520.0, (v.ravel() - 239.5) / 520.0, np.ones(u.size)])

    def picture(self, center: Array, rotation: Array) -> NDArray[np.uint8]:
        d = rotation @ self.rays
        reach = -center[2] / d[2]
        x = (center[1] + reach * d[1]) / self.texel + self.ground.shape[1] / 2.0
        y = -(center[0] + reach * d[0]) / self.texel + self.ground.shape[0] / 2.0
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = (x - x0)[:, None], (y - y0)[:, None]
        g = self.ground[..., :3]
        top = g[y0, x0] * (1.0 - fx) + g[y0, x0 + 1] * fx
        low = g[y0 + 1, x0] * (1.0 - fx) + g[y0 + 1, x0 + 1] * fx
        result: NDArray[np.uint8] = np.rint(top * (1.0 - fy) + low * fy).astype(np.uint8).reshape(480, 640, 3)
        return result


def main() -> None:
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    cv2.setNumThreads(1)
    world = World(
        [VehicleSpec(name="plain", camera=CameraSpec(offset_m=(0.0, 0.0, 0.0))), CARRIER], scene=SCENE, epoch_s=0.0
    )
    plain = world.camera("plain")
    print(f"{'ms of CPU for one picture':58s} {'median':>8s} {'p99':>8s}")
    base = measure("5 m, grass and a pad, standing", plain, lambda i: (0.0, 0.0, -5.0, 3.0, 2.0, 10.0), frames)
    measure(
        "5 m, at 5 m/s over new ground, 20 Hz",
        plain,
        lambda i: (100.0 + 0.25 * i, 0.0, -5.0, 0.0, -5.0, 0.0),
        frames,
    )
    measure("30 m, at 10 m/s over new ground, 20 Hz", plain, lambda i: (0.5 * i, 40.0, -30.0, 0.0, -5.0, 0.0), frames)
    measure(
        "0.7 m above the pad, which fills half the picture", plain, lambda i: (0.4, 0.3, -1.0, 0.0, 0.0, 0.0), frames
    )
    measure("5 m, 15 degrees of roll and of pitch", plain, lambda i: (0.0, 0.0, -5.0, 15.0, 15.0, 30.0), frames)
    measure("20 m, to the horizon (70 degrees)", plain, lambda i: (0.0, 0.0, -20.0, 0.0, 70.0, 30.0), frames)
    frame = plain.capture(poses((0.0, 0.0, -5.0, 3.0, 2.0, 10.0)))
    spent = []
    for _ in range(frames):
        start = time.thread_time()
        cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        spent.append(time.thread_time() - start)
    report("JPEG", spent)
    assert world.cameras is not None
    ground, _ = world.cameras.surroundings()
    cast = RayCast(ground.levels[0], FINEST_M)
    spent = []
    for _ in range(max(frames // 10, 5)):
        start = time.thread_time()
        cast.picture(np.array([0.0, 0.0, -5.0]), frame.rotation)
        spent.append(time.thread_time() - start)
    naive = report("bare ground by rays in numpy, no pad", spent)
    print(f"rays in numpy take {naive / base:.0f} times as long")
    world.close()


if __name__ == "__main__":
    main()
