"""What happens to a picture on its way through the lens and the sensor: distortion, blur, exposure, noise, JPEG."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadConfig
from zmav.sim.arrays import Array
from zmav.sim.camera.projection import camera_matrix, undistort
from zmav.sim.camera.spec import CameraSpec

Image = NDArray[np.uint8]

LARGEST = 4  # times the picture that a distorted one may be made from
INVERTIBLE = 1e-6  # greatest error of an undistorted coordinate
SPARE = 128  # the noise is taken from a larger picture of it, from another place each time
UNIT = 64  # of that picture, where the spread depends on the value: one standard deviation


class Lens:
    """Of one camera. What is rendered is ``size`` large with the camera matrix ``k``, without distortion.

    :class:`BadConfig` where the distortion folds the picture onto itself.
    """

    def __init__(self, spec: CameraSpec, brightness: float, rng: np.random.Generator) -> None:
        self.spec = spec
        self.k: Array = camera_matrix(spec)
        self.size = (spec.width, spec.height)
        self._maps: tuple[Image, Image] | None = None
        if any(spec.distortion):
            self._bend()
        self._shade = self._exposure(brightness * spec.gain)
        self._noise = self._noise_picture(rng) if spec.noise > 0.0 or spec.shot_noise > 0.0 else None
        values = np.arange(256)
        spread = np.sqrt(spec.noise**2 + spec.shot_noise**2 * values) * UNIT
        self._spread = np.clip(np.rint(spread), 0, 32767).astype(np.int16)

    def develop(self, image: Image, rng: np.random.Generator) -> Image:
        """From what falls on the lens to what the sensor gives, (height, width, 3) BGR."""
        spec = self.spec
        if self._maps is not None:
            image = _bytes(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        if spec.defocus_px > 0.0:
            image = _bytes(cv2.GaussianBlur(image, (0, 0), spec.defocus_px))
        if self._shade is not None:
            image = self._shade(image)
        if self._noise is not None:
            image = self._add_noise(image, rng)
        return image

    def encode(self, image: Image) -> bytes:
        """As JPEG."""
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.spec.jpeg_quality])
        return data.tobytes()

    def _bend(self) -> None:
        """Where each pixel of the distorted picture lies in the pinhole's, which must hold them all."""
        spec = self.spec
        (f, _, cu), (_, _, cv), _ = self.k.tolist()
        u, v = np.meshgrid(np.arange(spec.width, dtype=float), np.arange(spec.height, dtype=float))
        x, y, worst = undistort(spec, (u - cu) / f, (v - cv) / f)
        if not (worst < INVERTIBLE and _grows(spec, x, y)):
            raise BadConfig(
                f"distortion {spec.distortion} folds the picture onto itself; expected smaller coefficients",
                field="distortion",
                value=spec.distortion,
                expected="coefficients that can be inverted",
            )
        u, v = x * f + cu, y * f + cv
        left, top = math.floor(u.min()) - 1, math.floor(v.min()) - 1
        self.size = (math.ceil(u.max()) + 2 - left, math.ceil(v.max()) + 2 - top)
        if self.size[0] > LARGEST * spec.width or self.size[1] > LARGEST * spec.height:
            raise BadConfig(
                f"distortion {spec.distortion} needs a picture of {self.size[0]}x{self.size[1]}",
                field="distortion",
                value=spec.distortion,
                expected=f"at most {LARGEST} times the picture's size",
            )
        self.k = self.k - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        maps = cv2.convertMaps((u - left).astype(np.float32), (v - top).astype(np.float32), cv2.CV_16SC2)
        self._maps = (maps[0], maps[1])  # of 16 bits

    def _exposure(self, factor: float) -> _Shade | None:
        spec = self.spec
        if spec.vignetting == 0.0:
            return None if factor == 1.0 else _Shade(factor, None)
        u, v = np.arange(spec.width) - spec.center[0], np.arange(spec.height) - spec.center[1]
        r2 = (u * u)[None, :] + (v * v)[:, None]
        dark = 1.0 - spec.vignetting * r2 / r2.max()
        return _Shade(factor, np.repeat(np.rint(dark * 255.0).astype(np.uint8)[..., None], 3, 2))

    def _noise_picture(self, rng: np.random.Generator) -> NDArray[np.int16]:
        size = (self.spec.height + SPARE, self.spec.width + SPARE, 3)
        # Where the spread is the same for all values it is in the picture already, in steps of 8 bits.
        scale = UNIT if self.spec.shot_noise > 0.0 else self.spec.noise
        normal = rng.standard_normal(size, dtype=np.float32)
        noise: NDArray[np.int16] = np.rint(normal * scale).astype(np.int16)
        return noise

    def _add_noise(self, image: Image, rng: np.random.Generator) -> Image:
        assert self._noise is not None
        top, left = (int(i) for i in rng.integers(0, SPARE, 2))
        grain = self._noise[top : top + image.shape[0], left : left + image.shape[1]]
        if self.spec.shot_noise > 0.0:
            spread = cv2.LUT(image, self._spread)
            return _bytes(cv2.add(image, cv2.multiply(grain, spread, scale=UNIT**-2.0), dtype=cv2.CV_8U))
        return _bytes(cv2.add(image, grain, dtype=cv2.CV_8U))


class _Shade:
    """Brightness, the same everywhere or falling to the corners; what is too bright is white."""

    def __init__(self, factor: float, dark: Image | None) -> None:
        self._factor = factor
        self._dark = dark

    def __call__(self, image: Image) -> Image:
        if self._dark is None:
            return _bytes(cv2.convertScaleAbs(image, alpha=self._factor))
        return _bytes(cv2.multiply(image, self._dark, scale=self._factor / 255.0))


def _grows(spec: CameraSpec, x: Array, y: Array) -> bool:
    """Whether the lens keeps the order of points along every ray from the axis, out to the picture's corners."""
    far = np.sqrt(x * x + y * y).max() * np.linspace(0.0, 1.0, 200)
    k1, k2, _, _, k3 = spec.distortion
    r2 = far * far
    return bool((np.diff(far * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))) > 0.0).all())


def _bytes(image: object) -> Image:
    result: Image = np.asarray(image, dtype=np.uint8)
    return result
