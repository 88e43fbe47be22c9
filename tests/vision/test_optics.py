"""The pinhole there and back, against OpenCV's own projection and the simulator's camera."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from zmav.errors import BadInput
from zmav.sim.camera.projection import mount_matrix
from zmav.sim.camera.spec import CameraSpec
from zmav.vision.opencv import decode, encode
from zmav.vision.optics import Optics
from zmav.wire import CameraInfo

BENT = (-0.25, 0.08, 0.001, -0.002, -0.01)
INFO = CameraInfo(
    t=0.0,
    camera="down",
    width=640,
    height=480,
    focal=(520.0, 524.0),
    center=(322.0, 236.5),
    distortion=BENT,
    mount=(0.1, -0.3, 0.7),
    rate_hz=10.0,
)
PIXELS = np.array([[0.0, 0.0], [639.0, 479.0], [322.0, 236.5], [100.3, 400.7]])


def changed(**values: Any) -> CameraInfo:
    return msgspec.structs.replace(INFO, **values)


def test_rays_are_what_opencv_projects_to_the_pixel() -> None:
    optics = Optics.of(INFO)
    rays = optics.rays(PIXELS)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    zero = np.zeros(3)
    projected, _ = cv2.projectPoints(rays * 7.0, zero, zero, optics.matrix, optics.distortion)
    assert projected[:, 0] == pytest.approx(PIXELS, abs=1e-5)


def test_the_optical_axis_is_the_principal_point() -> None:
    assert Optics.of(INFO).rays(np.array([[322.0, 236.5]]))[0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)


def test_the_mount_is_the_simulators() -> None:
    optics = Optics.of(INFO)
    spec = CameraSpec(mount_deg=tuple(math.degrees(a) for a in INFO.mount))  # type: ignore[arg-type]
    assert optics.mount == pytest.approx(mount_matrix(spec))
    rays = optics.rays(PIXELS)
    assert optics.to_vehicle(rays) @ optics.mount == pytest.approx(rays)


@pytest.mark.parametrize(
    ("mount", "ahead"), [((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ((0.0, math.pi / 2, 0.0), (1.0, 0.0, 0.0))]
)
def test_where_mounts_look(mount: tuple[float, float, float], ahead: tuple[float, float, float]) -> None:
    axis = np.array([[0.0, 0.0, 1.0]])
    assert Optics.of(changed(mount=mount)).to_vehicle(axis)[0] == pytest.approx(ahead, abs=1e-12)


def test_the_upper_edge_is_toward_the_nose() -> None:
    optics = Optics.of(changed(mount=(0.0, 0.0, 0.0), distortion=(0.0,) * 5))
    forward, right, down = optics.to_vehicle(optics.rays(np.array([[322.0, 0.0]])))[0]
    assert forward > 0.3
    assert (right, down > 0.8) == (pytest.approx(0.0, abs=1e-12), True)


def test_a_resized_picture_sees_the_same() -> None:
    whole = Optics.of(INFO)
    half = whole.scaled(320, 240)
    middle_of_four = np.array([[100.5, 60.5]])  # pixels 100, 101 by 60, 61 become pixel 50, 30
    assert half.rays(np.array([[50.0, 30.0]])) == pytest.approx(whole.rays(middle_of_four), abs=1e-9)
    assert whole.scaled(640, 480) is whole


@pytest.mark.parametrize(
    "wrong", [{"focal": (0.0, 520.0)}, {"focal": (math.nan, 1.0)}, {"width": 0}, {"offset": (math.inf, 0.0, 0.0)}]
)
def test_numbers_that_are_no_cameras(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="camera down"):
        Optics.of(changed(**wrong))


def test_a_jpeg_there_and_back() -> None:
    image = np.full((48, 64, 3), (10, 120, 200), np.uint8)
    assert decode(encode(image, 95)) == pytest.approx(image, abs=4)
    for wrong in (b"", b"no picture"):
        with pytest.raises(BadInput, match="no picture"):
            decode(wrong)


def test_pictures_are_read_without_opencv() -> None:
    """Only looking into them needs it, and then says what to install."""
    code = (
        "import sys; sys.modules['cv2'] = None\n"
        "from zmav.vision import assembler, chunks, optics, reader\n"
        "from zmav.errors import BadConfig\n"
        "try:\n    reader.Picture(b'x', 0.0, 0, 1, 1, 0.0).decode()\n"
        "except BadConfig as e:\n    print(e)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install 'zmav[vision]'" in done.stdout, done.stderr
