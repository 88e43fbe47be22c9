"""Calibration from chessboards that the simulator renders, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from agents.camera.calibrate import FEWEST, Views
from agents.camera.cli import camera
from agents.camera.settings import Calibration
from tests.sim.camera.conftest import Studio
from zmav.errors import BadConfig, BadInput
from zmav.sim import VehicleSpec, World
from zmav.sim.camera import CameraSpec, PadSpec, PlacedPad, Scene
from zmav.vision.opencv import Image

BENT = (-0.12, 0.05, 0.0, 0.0, 0.0)
MATRIX = np.array([[400.0, 0.0, 235.0], [0.0, 400.0, 183.0], [0.0, 0.0, 1.0]])
WIDE = CameraSpec(width=640, height=480, focal_px=400.0, offset_m=(0.0,) * 3)
BOARD = PadSpec(symbol="chessboard", symbol_m=2.0, squares=(7, 10), shape="square", size_m=2.4, background="white")
SQUARES, SIDE = (7, 10), 0.2
TILTED = [
    (0.0, 0.0, 0.0),
    (22.0, 0.0, 20.0),
    (-22.0, 5.0, 0.0),
    (0.0, 22.0, -30.0),
    (5.0, -22.0, 60.0),
    (18.0, 18.0, 0.0),
    (-18.0, 18.0, 90.0),
    (18.0, -18.0, 45.0),
    (-18.0, -18.0, 10.0),
    (0.0, 0.0, 45.0),
    (25.0, 10.0, -60.0),
]
"""degrees of roll, pitch, yaw"""


def place(roll: float, pitch: float, yaw: float, shift: float, height: float = 3.4) -> tuple[float, ...]:
    """Where a camera must be that looks past the board's middle by ``shift`` metres."""
    ahead, right = math.tan(math.radians(pitch)), -math.tan(math.radians(roll))
    c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    north, east = -height * (ahead * c - right * s) + shift, -height * (ahead * s + right * c) - shift
    return north, east, -height, roll, pitch, yaw


@pytest.fixture(scope="module")
def views() -> Iterator[list[Image]]:
    scene = Scene(ground="asphalt", pads=(PlacedPad(position=(0.0, 0.0), pad=BOARD),))
    world = World([VehicleSpec(name="copter1", camera=WIDE)], scene=scene, epoch_s=1000.0)
    studio = Studio(world)
    straight = [studio.take(place(*angles, shift=0.35 * (i % 3 - 1))).image for i, angles in enumerate(TILTED)]
    yield [bent(image, studio.camera.matrix) for image in straight]
    world.close()


def bent(image: Image, wide: NDArray[np.float64]) -> Image:
    """As a lens with MATRIX and BENT would have taken it."""
    pixels = np.stack(np.meshgrid(np.arange(480.0), np.arange(360.0)), -1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(pixels, MATRIX, np.array(BENT), P=wide).reshape(360, 480, 2).astype(np.float32)
    return np.asarray(cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR), dtype=np.uint8)


def test_a_lens_is_found_again(views: list[Image], tmp_path: Path) -> None:
    for i, image in enumerate(views):
        cv2.imwrite(str(tmp_path / f"{i:02d}.png"), image)
    (tmp_path / "broken.png").write_bytes(b"no picture")
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((360, 480, 3), 90, np.uint8))
    out = tmp_path / "down.toml"
    arguments = ["calibrate", str(tmp_path), "--squares", "7x10", "--size", "0.2", "-o", str(out)]
    done = CliRunner().invoke(camera, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "broken.png: no picture" in done.output
    assert "empty.png: no board" in done.output
    found = Calibration.load(out)
    assert (found.width, found.height) == (480, 360)
    assert found.focal == pytest.approx((400.0, 400.0), rel=0.01)
    assert found.center == pytest.approx((235.0, 183.0), abs=3.0)
    assert found.distortion[0] == pytest.approx(BENT[0], abs=0.03)
    assert found.error_px is not None
    assert found.error_px < 0.4


def test_too_few_views_are_refused(views: list[Image]) -> None:
    found = Views(SQUARES, SIDE)
    assert [found.add(image) for image in views[:3]] == ["", "", ""]
    assert found.add(views[0]) == "like another"
    assert "pixels" in found.add(views[0][:300])
    with pytest.raises(BadInput, match=f"3 views of the board, expected {FEWEST} at least"):
        found.solve()


def test_the_wrong_count_of_squares_finds_no_board(views: list[Image]) -> None:
    found = Views((9, 12), SIDE)
    assert {found.add(image) for image in views[:2]} == {"no board"}


def seen_head_on(scale: float, step: float) -> Views:
    """Nine views of an untilted board of 9x6 squares of ``scale`` px, ``step`` px apart."""
    views = Views((9, 6), SIDE)
    views.size = (480, 360)
    grid = np.mgrid[0:8, 0:5].T.reshape(-1, 2) * scale + 20.0
    views.corners = [grid + np.array([step * i, step * j]) for i in range(3) for j in range(3)]
    return views


def test_views_that_are_all_alike_are_refused() -> None:
    with pytest.raises(BadInput, match="tilt the board"):
        seen_head_on(30.0, 90.0).solve()
    with pytest.raises(BadInput, match="in the corners, too"):
        seen_head_on(12.0, 21.0).solve()


@pytest.mark.parametrize("squares", [(3, 6), (9, 9), (9, 51)])
def test_boards_that_tell_nothing(squares: tuple[int, int]) -> None:
    with pytest.raises(BadInput, match="squares"):
        Views(squares, SIDE)


def test_a_calibration_is_scaled_and_saved(tmp_path: Path) -> None:
    found = Calibration(width=640, height=480, focal=(500.0, 510.0), center=(319.5, 239.5), distortion=BENT)
    half = found.scaled(320, 240)
    assert (half.focal, half.center) == ((250.0, 255.0), (159.5, 119.5))
    with pytest.raises(BadConfig, match="another shape"):
        found.scaled(640, 360)
    found.save(tmp_path / "a.toml")
    assert Calibration.load(tmp_path / "a.toml") == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("width = 640", "height"),
        ("width = 640\nheight = 480\nfocal = [0.0, 1.0]\ncenter = [1.0, 1.0]", "focal"),
        ("width = 640\nheight = 480\nfocal = [1.0, 1.0]\ncenter = [nan, 1.0]", "finite"),
        ("no toml", "calibration"),
    ],
)
def test_a_broken_calibration_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(text)
    with pytest.raises(BadConfig, match=words):
        Calibration.load(path)
    with pytest.raises(BadConfig, match="cannot read"):
        Calibration.load(tmp_path / "missing.toml")
