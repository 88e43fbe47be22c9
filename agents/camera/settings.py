"""What a camera agent is told: sizes, rates, what its link has; and the camera's own constants."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import msgspec

from zmav import keys
from zmav.errors import BadConfig
from zmav.vision.opencv import Image

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Angle = Annotated[float, msgspec.Meta(ge=-6.3, le=6.3)]
Metres = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
Pixels = Annotated[int, msgspec.Meta(ge=16, le=8192)]
Coefficient = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
MOST_ZOOM = 8.0
SAME_SHAPE = 0.02
"""by how much the ratio of width to height may differ from the calibrated one"""


class CameraSettings(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """Of one camera; :meth:`check` says what in it cannot be."""

    vehicle: str
    camera: str = "down"
    rate: Annotated[float, msgspec.Meta(ge=0.2, le=60.0)] = 10.0
    """Hz at most"""
    size: tuple[Pixels, Pixels] = (640, 480)
    """width and height in pixels at most; the picture keeps its shape and is never enlarged"""
    quality: Annotated[int, msgspec.Meta(ge=10, le=95)] = 70
    """of JPEG at most"""
    budget: Annotated[float, msgspec.Meta(ge=2e3, le=1e8)] = 60e3
    """B/s to begin with, and where no reader reports"""
    least: Annotated[float, msgspec.Meta(ge=1e3, le=1e8)] = 4e3
    """B/s below which no reader's bad reports bring it; what a reader says its link has goes before"""
    most: Annotated[float, msgspec.Meta(ge=2e3, le=1e8)] = 2e6
    """B/s above which no reader's good reports bring it"""
    mount: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """rad: roll, pitch, yaw from straight down"""
    offset: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """m forward, right, down"""
    gimbal: bool = False

    def check(self) -> CameraSettings:
        """Itself; raises :class:`BadConfig` that names the field, and :class:`~zmav.errors.BadKey` for a bad name."""
        keys.check_name(self.vehicle, "vehicle")
        keys.check_name(self.camera, "camera")
        try:
            msgspec.convert(msgspec.to_builtins(self), CameraSettings)
        except msgspec.ValidationError as e:
            raise BadConfig(f"camera {self.camera}: {e}", field="camera", value=self.camera, expected=str(e)) from None
        if not self.least <= self.budget <= self.most:
            text = f"budget {self.budget:g} B/s: expected between {self.least:g} and {self.most:g} (least and most)"
            raise BadConfig(text, field="budget", value=self.budget, expected=f"{self.least:g} to {self.most:g} B/s")
        return self


class Calibration(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """A camera's own constants, for pictures of ``width`` by ``height``, as OpenCV's
    calibration gives them; a TOML or JSON file."""

    width: Pixels
    height: Pixels
    focal: tuple[Positive, Positive]
    """px: fx, fy"""
    center: tuple[float, float]
    """px: cx, cy; the centre of the upper left pixel is 0, 0"""
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3"""

    @classmethod
    def by_angle(cls, fov: float, width: int, height: int) -> Calibration:
        """An ideal lens with a horizontal field of view of ``fov`` rad. Raises :class:`BadConfig`."""
        if not 0.05 < fov < 3.0:
            text = f"field of view {math.degrees(fov):g}°: expected 3 to 170"
            raise BadConfig(text, field="fov", value=fov, expected="0.05 to 3 rad")
        focal = 0.5 * width / math.tan(0.5 * fov)
        return cls(width=width, height=height, focal=(focal, focal), center=((width - 1) / 2, (height - 1) / 2))

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """From a TOML or JSON file; raises :class:`BadConfig` that names the field."""
        try:
            data = path.read_bytes()
            decode = msgspec.json.decode if path.suffix == ".json" else msgspec.toml.decode
            found: Calibration = decode(data, type=cls)
        except OSError as e:
            text = f"cannot read the calibration {path}: {e.strerror}"
            raise BadConfig(text, field="calibration", value=str(path), expected="a file") from e
        except (msgspec.DecodeError, ValueError, RecursionError) as e:
            text = f"calibration {path}: {e}"
            raise BadConfig(text, field="calibration", value=str(path), expected="what OpenCV gives") from e
        if not all(map(math.isfinite, (*found.center, *found.focal, *found.distortion))):
            text = f"calibration {path}: expected finite numbers"
            raise BadConfig(text, field="calibration", value=str(path), expected="finite numbers")
        return found

    def scaled(self, width: int, height: int) -> Calibration:
        """For a picture that was resized; raises :class:`BadConfig` for one of another shape (it was cropped)."""
        kx, ky = width / self.width, height / self.height
        if abs(kx / ky - 1.0) > SAME_SHAPE:
            text = (
                f"the calibration is for {self.width}x{self.height}, the pictures are {width}x{height}: another shape"
            )
            raise BadConfig(text, field="calibration", value=[self.width, self.height], expected=f"{width}x{height}")
        (fx, fy), (cx, cy) = self.focal, self.center
        return msgspec.structs.replace(
            self,
            width=width,
            height=height,
            focal=(fx * kx, fy * ky),
            center=((cx + 0.5) * kx - 0.5, (cy + 0.5) * ky - 0.5),
        )

    def zoomed(self, factor: float) -> Calibration:
        """For the middle of the picture, enlarged so many times to the same size."""
        (fx, fy), (cx, cy) = self.focal, self.center
        u, v = (self.width - 1) / 2.0, (self.height - 1) / 2.0
        center = u + (cx - u) * factor, v + (cy - v) * factor
        return msgspec.structs.replace(self, focal=(fx * factor, fy * factor), center=center)


def cropped(image: Image, zoom: float) -> Image:
    """The middle of a picture, a ``zoom``-th of it each way."""
    if zoom <= 1.0:
        return image
    height, width = image.shape[:2]
    across, down = max(round(width / zoom / 2.0), 1), max(round(height / zoom / 2.0), 1)
    middle_x, middle_y = width // 2, height // 2
    return image[max(middle_y - down, 0) : middle_y + down, max(middle_x - across, 0) : middle_x + across]
