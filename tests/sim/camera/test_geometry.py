"""Where things are in the picture: against the camera equation, within a tenth of a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from tests.sim.camera.conftest import pinhole, turned
from zmav.sim import VehicleSpec
from zmav.sim.arrays import Array
from zmav.sim.camera import CameraSpec, PadSpec, PlacedPad, Scene
from zmav.sim.camera.cameras import Frame, SimCamera
from zmav.sim.camera.spec import bgr

if TYPE_CHECKING:
    from tests.sim.camera.conftest import MakeStudio, Place

WITHIN_PX = 0.1
BOARD = PadSpec(symbol="chessboard", symbol_m=2.0, squares=(7, 10), shape="square", size_m=2.4, background="white")
AT_FEET = CameraSpec(offset_m=(0.0, 0.0, 0.0))


def board_corners(heading_deg: float = 0.0) -> tuple[Array, Array]:
    """North and east parts of the chessboard's inner corners, from its middle."""
    side = BOARD.symbol_m / 10
    along, across = np.meshgrid((np.arange(1, 10) - 5) * side, (np.arange(1, 7) - 3.5) * side, indexing="ij")
    return turned(heading_deg, along.ravel(), across.ravel())


def found_corners(frame: Frame, expected: Array) -> Array:
    """Corners of the picture near ``expected`` (2, N), to a fraction of a pixel; the search begins off the place.

    Without the blur the finder itself is off by up to 0.16 px, also in a picture sampled 8 by 8 times a pixel.
    """
    grey = cv2.GaussianBlur(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY), (0, 0), 1.0)
    start = np.ascontiguousarray(expected.T + np.array([1.3, -1.1]), dtype=np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    found = cv2.cornerSubPix(grey, start, (5, 5), (-1, -1), criteria)
    return np.asarray(found, dtype=float).reshape(-1, 2).T


def check_corners(frame: Frame, camera: SimCamera, points: Array) -> None:
    expected = pinhole(frame, camera, points)
    size = np.array([[camera.spec.width], [camera.spec.height]])
    inside = ((expected > 12) & (expected < size - 13)).all(0)
    assert inside.sum() > 20
    expected = expected[:, inside]
    error = np.hypot(*(found_corners(frame, expected) - expected))
    assert error.max() < WITHIN_PX, f"{error.max():.3f} px at worst, {np.median(error):.3f} in the middle"


POSES: list[Place] = [
    (0.0, 0.0, -3.0),
    (0.3, -0.2, -4.3, 0.0, 0.0, 77.0),
    (1.2, -0.7, -5.0, 9.0, -14.0, 200.0),
    (-0.9, 1.2, -4.0, -15.0, 15.0, -35.0),
    (0.1, 0.2, -9.0, 3.0, -2.0, 10.0),
]


class TestGround:
    @pytest.mark.parametrize("place", POSES)
    def test_corners_on_the_ground(self, make_studio: MakeStudio, place: Place) -> None:
        scene = Scene(ground="asphalt", pads=(PlacedPad(position=(0.2, 0.1), heading_deg=25.0, pad=BOARD),))
        studio = make_studio(AT_FEET, scene=scene)
        north, east = board_corners(25.0)
        frame = studio.take(place)
        check_corners(frame, studio.camera, np.array([north + 0.2, east + 0.1, np.zeros_like(north)]))

    def test_far_from_the_origin(self, make_studio: MakeStudio) -> None:
        scene = Scene(ground="asphalt", pads=(PlacedPad(position=(7000.2, -9000.1), pad=BOARD),))
        studio = make_studio(AT_FEET, scene=scene)
        north, east = board_corners()
        frame = studio.take((7000.0, -9000.0, -4.0, 5.0, 5.0, 60.0))
        check_corners(frame, studio.camera, np.array([north + 7000.2, east - 9000.1, np.zeros_like(north)]))

    def test_another_lens_and_mount(self, make_studio: MakeStudio) -> None:
        camera = CameraSpec(
            width=800,
            height=600,
            focal_px=480.0,
            mount_deg=(4.0, 12.0, 90.0),
            offset_m=(0.1, -0.05, -0.2),
        )
        studio = make_studio(camera, scene=Scene(ground="asphalt", pads=(PlacedPad(position=(0, 0), pad=BOARD),)))
        north, east = board_corners()
        frame = studio.take((-0.8, 0.0, -3.0, 2.0, -3.0, 5.0))
        check_corners(frame, studio.camera, np.array([north, east, np.zeros_like(north)]))

    def test_the_texture_itself_moves_as_the_camera_does(self, make_studio: MakeStudio) -> None:
        """Two pictures of bare ground, from two places: the one warped to the other falls on it."""
        studio = make_studio(AT_FEET, scene=Scene(ground="grass"))
        first, second = studio.take((0.0, 0.0, -5.0)), studio.take((0.137, -0.251, -5.3, 6.0, -4.0, 23.0))
        corners = np.array([[-1.5, -1.5, 1.5, 1.5], [-1.5, 1.5, 1.5, -1.5], [0.0, 0.0, 0.0, 0.0]])
        one, two = (pinhole(frame, studio.camera, corners).T.astype(np.float32) for frame in (first, second))
        matrix = cv2.getPerspectiveTransform(two, one)
        back = cv2.warpPerspective(second.image, matrix, (640, 480), flags=cv2.INTER_CUBIC)
        patch = slice(140, 340), slice(220, 420)
        (dx, dy), response = cv2.phaseCorrelate(*(_grey(each)[patch] for each in (first.image, back)))
        assert response > 0.5
        assert np.hypot(dx, dy) < WITHIN_PX


def _grey(image: object) -> Array:
    return np.asarray(cv2.cvtColor(np.asarray(image), cv2.COLOR_BGR2GRAY), dtype=np.float64)


class TestRover:
    @pytest.mark.parametrize("place", [(0.0, 0.0, -3.0), (0.5, 0.3, -4.0, 12.0, -9.0, 120.0)])
    def test_its_pad_is_at_its_deck(self, make_studio: MakeStudio, place: Place) -> None:
        board = PadSpec(
            symbol="chessboard",
            symbol_m=1.0,
            shape="square",
            size_m=1.2,
            background="white",
            deck_m=0.6,
        )
        studio = make_studio(AT_FEET, VehicleSpec(name="carrier", pad=board))
        frame = studio.take(place, (0.4, 0.2, 0.0, 0.0, 0.0, 40.0))
        ahead, right = (np.array(each) / 2.0 for each in board_corners())
        north, east = turned(40.0, ahead, right)
        check_corners(frame, studio.camera, np.array([north + 0.4, east + 0.2, np.full_like(north, -0.6)]))

    def test_a_leaning_deck(self, make_studio: MakeStudio) -> None:
        board = PadSpec(symbol="chessboard", symbol_m=1.0, shape="square", size_m=1.2, background="white", deck_m=0.5)
        studio = make_studio(AT_FEET, VehicleSpec(name="carrier", pad=board))
        frame = studio.take((0.0, 0.0, -3.0), (0.2, 0.0, 0.0, 0.0, 10.0, 0.0))  # nose up
        ahead, right = (np.array(each) / 2.0 for each in board_corners())
        c, s = np.cos(np.radians(10.0)), np.sin(np.radians(10.0))
        points = np.array([0.2 + ahead * c - 0.5 * s, right, -ahead * s - 0.5 * c])
        check_corners(frame, studio.camera, points)


def letter(frame: Frame, camera: SimCamera, pad: PadSpec) -> tuple[Array, Array, Array]:
    """Of the pixels about a pad at the world's origin: how much the letter covers of each, by sampling it 7 by 7; how
    much it does in the picture; and the first pixel (u, v).
    """
    middle = pinhole(frame, camera, np.zeros((3, 1)))[:, 0]
    reach = int(0.35 * pad.size_m * camera.spec.focal_px / -frame.position[2])
    first = np.maximum(np.rint(middle).astype(int) - reach, 0)
    shown = np.asarray(frame.image[first[1] :, first[0] :, 1][: 2 * reach + 1, : 2 * reach + 1], dtype=float)
    height, width = shown.shape
    step = (np.arange(7) - 3) / 7
    v, u = ((np.arange(n)[:, None] + step).ravel() for n in (height, width))
    grid = np.array(np.meshgrid(u + first[0], v + first[1])).reshape(2, -1)
    rays = frame.rotation @ np.linalg.inv(camera.matrix) @ np.vstack([grid, np.ones(grid.shape[1])])
    north, east, down = frame.position
    n, e = north - rays[0] * down / rays[2], east - rays[1] * down / rays[2]
    stroke, half = pad.stroke_ratio * pad.symbol_m, pad.width_ratio * pad.symbol_m / 2
    upright = (np.abs(n) <= pad.symbol_m / 2) & (np.abs(e) <= half) & (np.abs(e) >= half - stroke)
    bar = (np.abs(n) <= stroke / 2) & (np.abs(e) <= half)
    covered = (upright | bar).reshape(height, 7, width, 7).mean((1, 3))
    return covered, (shown - BLACK) / (WHITE - BLACK), first


def centroid(weight: Array) -> Array:
    """Column and row."""
    v, u = np.indices(weight.shape)
    middle: Array = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    return middle


PAD = PadSpec(symbol_m=0.25, shape="square", size_m=0.6, color="#f0f0f0", background="#101010")
WHITE, BLACK = 240.0, 16.0


class TestLetter:
    @pytest.mark.parametrize("height", [1.0, 2.5, 6.0, 12.0])
    @pytest.mark.parametrize("tilt", [0.0, 15.0])
    def test_its_place_and_its_area(self, make_studio: MakeStudio, height: float, tilt: float) -> None:
        pads = (PlacedPad(position=(0.0, 0.0), pad=PAD),)
        studio = make_studio(AT_FEET, scene=Scene(pads=pads))
        lean = height * np.tan(np.radians(tilt)) * 0.7
        frame = studio.take((-lean + 0.011, lean + 0.017, -height, tilt, tilt, 0.0))
        expected, shown, _ = letter(frame, studio.camera, PAD)
        assert np.hypot(*(centroid(shown) - centroid(expected))) < WITHIN_PX
        assert shown.sum() == pytest.approx(expected.sum(), rel=0.02)
        assert np.abs(shown - expected).max() < 0.25  # of the step, at edges: not one pixel is beside the place

    def test_straight_above_it_is_in_the_middle_between_pixels(self, make_studio: MakeStudio) -> None:
        studio = make_studio(AT_FEET, scene=Scene(pads=(PlacedPad(position=(0.0, 0.0), pad=PAD),)))
        _, shown, first = letter(studio.take((0.0, 0.0, -2.0)), studio.camera, PAD)
        assert centroid(shown) + first == pytest.approx([319.5, 239.5], abs=0.03)

    def test_up_in_the_picture_is_ahead_and_right_is_right(self, make_studio: MakeStudio) -> None:
        pads = (PlacedPad(position=(1.0, 0.0), pad=PAD),)
        studio = make_studio(AT_FEET, scene=Scene(ground="asphalt", pads=pads))
        for heading, u, v in ((0.0, 319.5, 239.5 - 130.0), (90.0, 319.5 - 130.0, 239.5), (180.0, 319.5, 369.5)):
            frame = studio.take((0.0, 0.0, -4.0, 0.0, 0.0, heading))
            white = np.asarray(frame.image.min(2) > 200, dtype=float)
            assert centroid(white) == pytest.approx([u, v], abs=0.3)

    @pytest.mark.parametrize("color", ["white", "yellow"])
    @pytest.mark.parametrize("shape", ["disc", "square"])
    def test_every_kind_of_pad(self, make_studio: MakeStudio, color: str, shape: str) -> None:
        pad = PadSpec(symbol_m=0.5, shape=shape, size_m=1.0, color=color, background="blue")  # type: ignore[arg-type]
        studio = make_studio(AT_FEET, scene=Scene(pads=(PlacedPad(position=(0.0, 0.0), pad=pad),)))
        image = studio.take((0.0, 0.0, -2.6)).image.astype(int)  # 200 px a metre
        paint, blue = np.array(bgr(color)), np.array(bgr("blue"))
        assert image[239, 319] == pytest.approx(paint, abs=2)  # the letter's bar
        assert image[239 - 45, 319 - 30] == pytest.approx(paint, abs=2)  # an upright
        assert np.abs(image[239 - 30, 319] - blue).max() < 3  # between the uprights
        assert np.abs(image[239, 319 - 97] - blue).max() < 3  # the rim
        corner = bool(np.abs(image[239 - 95, 319 - 95] - blue).max() < 3)
        assert corner is (shape == "square")


class TestMount:
    def test_a_gimbal_stays_level_and_turns_along(self, make_studio: MakeStudio) -> None:
        camera = CameraSpec(offset_m=(0.0, 0.0, 0.0), gimbal=True)
        studio = make_studio(camera)
        leaning, level = studio.take((0, 0, -5, 20, -10, 70)), studio.take((0, 0, -5, 0, 0, 70))
        assert leaning.rotation == pytest.approx(level.rotation, abs=1e-12)
        assert (leaning.image == level.image).all()

    def test_its_pitch_looks_ahead_and_its_roll_to_the_left(self, make_studio: MakeStudio) -> None:
        ahead = make_studio(CameraSpec(mount_deg=(0.0, 30.0, 0.0))).take((0.0, 0.0, -5.0, 0.0, 0.0, 90.0))
        assert ahead.rotation[:, 2] == pytest.approx([0.0, 0.5, np.sqrt(0.75)], abs=1e-9)
        aside = make_studio(CameraSpec(mount_deg=(30.0, 0.0, 0.0))).take((0.0, 0.0, -5.0))
        assert aside.rotation[:, 2] == pytest.approx([0.0, -0.5, np.sqrt(0.75)], abs=1e-9)

    def test_the_offset_turns_with_the_vehicle(self, make_studio: MakeStudio) -> None:
        studio = make_studio(CameraSpec(offset_m=(0.2, 0.1, -0.3)))
        assert studio.take((1.0, 2.0, -5.0, 0.0, 0.0, 90.0)).position == pytest.approx((0.9, 2.2, -5.3))
