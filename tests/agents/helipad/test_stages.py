"""The detector's stages alone, and the generator that its figures rest on."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from agents.helipad import channels, polar, structure
from agents.helipad.candidates import Kernels, Room
from agents.helipad.check import LearnedCheck, features
from agents.helipad.geometry import View
from agents.helipad.refine import SIDE, Aligner, heading, turned
from agents.helipad.templates import Symbol, letter_h
from tests.agents.helipad.generator import (
    CAMERA,
    SIZE,
    Pad,
    Sample,
    ground_to_picture,
    project,
    sample,
    stamp,
    surface_of,
    truth_of,
)
from tests.agents.helipad.letters import LOOKALIKES, ink
from tests.agents.helipad.train_check import side_by_side

BENT = np.array([-0.2, 0.05, 0.001, 0.002, 0.0])


def painted(middle: tuple[float, float], angle: float, tall: float, symbol: Symbol, side: int = 64) -> channels.Picture:
    """A picture of ``symbol``, ``tall`` pixels high."""
    v, u = np.mgrid[0:side, 0:side].astype(float)
    x, y = (u - middle[0]) / tall, (v - middle[1]) / tall
    c, s = math.cos(angle), math.sin(angle)
    return np.rint(60.0 + 120.0 * symbol.at(c * x + s * y, c * y - s * x)).astype(np.uint8)


def test_a_view_agrees_with_the_generator_and_with_itself() -> None:
    view = View(CAMERA, None, 5.0 / 0.25, 0.2, -0.15)
    points = np.array([[0.3, -0.2], [-4.0, 3.0], [6.0, -5.0]])
    pixels = view.to_pixels(points)
    matrix = ground_to_picture(5.0, 0.2, -0.15)
    for point, pixel in zip(points, pixels, strict=True):
        assert pixel == pytest.approx(project(matrix, 0.25 * point[0], 0.25 * point[1]), abs=1e-6)
    assert view.to_plane(pixels) == pytest.approx(points, abs=1e-9)
    assert view.scale == pytest.approx(26.0)


@pytest.mark.parametrize("distortion", [None, BENT])
def test_the_affine_map_is_how_pixels_move(distortion: np.ndarray | None) -> None:
    view = View(CAMERA, distortion, 20.0, 0.1, 0.2)
    pixels = np.array([[100.0, 80.0], [500.0, 400.0]])
    affines = view.affine(pixels)
    step = np.array([0.05, -0.03])
    moved = view.to_pixels(view.to_plane(pixels) + step)
    assert moved - pixels == pytest.approx(affines @ step, abs=0.02)


def test_pixels_above_the_horizon_see_no_ground() -> None:
    view = View(CAMERA, None, 20.0, 0.0, math.radians(80.0))
    assert view.in_front(np.array([[320.0, 470.0], [320.0, 5.0]])).tolist() == [True, False]


def test_smaller_pictures_keep_their_places() -> None:
    v, u = np.mgrid[0:480, 0:640].astype(float)
    blob = np.rint(200.0 * np.exp(-((u - 401.3) ** 2 + (v - 150.7) ** 2) / (2 * 15.0**2))).astype(np.uint8)
    pyramid = channels.Pyramid(blob[40:, 70:], (70, 40))
    for factor in (1.0, 0.8, 0.5, 0.31, 0.12):
        small, factors = pyramid.shrunk(factor)
        weight = small.astype(float)
        place = np.array([(weight.sum(axis=k) * np.arange(weight.shape[1 - k])).sum() for k in (0, 1)]) / weight.sum()
        back = (place + 0.5) / factors - 0.5 + pyramid.origin
        assert back == pytest.approx([401.3, 150.7], abs=0.2), factor
        assert factors[0] == pytest.approx(factor, rel=0.06)


def test_yellow_shows_paint_and_nothing_pale() -> None:
    frame = np.full((96, 96, 3), 180, dtype=np.uint8)
    assert channels.yellow(frame) is None
    assert channels.yellow(frame[..., 0]) is None
    frame[20:40, 20:40] = (30, 190, 240)
    found = channels.yellow(frame)
    assert found is not None
    paint, (u, v) = found
    assert paint[30 - v, 30 - u] == 160
    assert paint[6 - v, 6 - u] == 0
    assert paint.shape[0] < 96


def test_candidates_come_at_any_heading_and_light() -> None:
    symbol = letter_h()[1]
    kernels = Kernels(letter_h(), 6.25, Room())
    for angle in np.linspace(0.0, math.pi, 7):
        for gain in (0.15, 1.0):
            picture = painted((30.4, 33.2), float(angle), 6.25, symbol)
            dim = np.rint(20.0 + gain * picture).clip(0, 255).astype(np.uint8)
            assert kernels.candidates(dim, 5)[0] == pytest.approx([30.4, 33.2], abs=0.4)


def test_a_polar_match_tells_heading_and_scale() -> None:
    symbols = letter_h()
    bank = polar.Bank(symbols, (0.88, 1.0, 1.14))
    for angle in (0.0, 0.5, 1.3, 2.6):
        picture = painted((31.0, 32.0), angle, 13.0 * 1.14, symbols[2])
        patch = polar.sample(picture, np.array([[31.0, 32.0]]), np.eye(2)[None] * 13.0, *polar.grid())
        value, symbol, scale, turn = bank.match(polar.normalised(patch, bank.weight))
        assert value[0] > 0.95
        assert (symbol[0], scale[0]) == (2, 1.14)
        assert abs((turn[0] - angle + math.pi / 2) % math.pi - math.pi / 2) < 2.0 * math.pi / polar.ANGLES


def test_alignment_ends_where_the_symbol_is() -> None:
    symbols = letter_h()
    aligner = Aligner(symbols)
    picture = painted((31.3, 32.6), 0.6, 14.0, symbols[0])
    start = np.eye(2)[None] * 13.0 @ turned(np.array([0.7]), np.array([1.0]))
    middles, affines = aligner.align(picture, np.array([0]), np.array([[32.4, 31.9]]), start, 6)
    assert middles[0] == pytest.approx([31.3, 32.6], abs=0.03)
    assert heading(affines)[0] == pytest.approx(0.6, abs=0.004)
    assert np.linalg.norm(affines[0, :, 1]) == pytest.approx(14.0, rel=0.01)


@pytest.mark.parametrize(("width", "stroke"), [(0.58, 0.14), (0.6, 0.15), (0.7, 0.18), (0.82, 0.22)])
def test_an_h_is_built_as_one_and_few_other_letters_are(width: float, stroke: float) -> None:
    aligner = Aligner(letter_h())
    x, y = aligner.x, -aligner.y

    def sound(letter: str, hidden: np.ndarray | bool = False) -> bool:
        drawn = ink(letter, x, y, width, stroke) & ~np.broadcast_to(hidden, x.shape)
        return bool(structure.sound(drawn.astype(np.float32)[None])[0])

    assert sound("H")
    assert sound("H", (x > 0.12) & (y > 0.1)), "a half bar may be hidden"
    assert not sound("H", x > 0.12), "a whole bar may not"
    assert not sound("H", (np.abs(x) < 0.2) & (np.abs(y) < 0.15)), "nor the one across"
    assert [letter for letter in LOOKALIKES if sound(letter)] == ["N", "X", "M", "W", "4"]
    assert not structure.sound(np.zeros((1, x.size), dtype=np.float32))[0]
    assert not structure.sound(np.ones((1, x.size), dtype=np.float32))[0]


def test_the_learned_check_knows_no_mirror_image_from_another() -> None:
    rng = np.random.default_rng(5)
    patches = rng.normal(size=(20, SIDE * SIDE)).astype(np.float32)
    grids = patches.reshape(-1, SIDE, SIDE)
    for other in (grids[:, ::-1], grids[:, :, ::-1], grids[:, ::-1, ::-1]):
        assert features(other.reshape(20, -1)) == pytest.approx(features(patches), abs=1e-6)
    assert len(features(np.zeros((0, SIDE * SIDE), dtype=np.float32))) == 0


def test_networks_side_by_side_give_the_mean_of_their_odds() -> None:
    rng = np.random.default_rng(6)
    sizes = ((SIDE * SIDE, 5), (5, 3), (3, 1))

    def some(*size: int) -> NDArray[np.float32]:
        return rng.normal(size=size).astype(np.float32)

    nets = [LearnedCheck([some(*each) for each in sizes], [some(out) for _, out in sizes]) for _ in range(3)]
    inputs = some(20, SIDE * SIDE)
    mean = np.mean([net.outputs(inputs)[-1] for net in nets], axis=0)
    assert side_by_side(nets).outputs(inputs)[-1] == pytest.approx(mean, rel=1e-4, abs=1e-4)


def test_a_patch_has_bare_ground_at_0_and_paint_at_1_whatever_the_light() -> None:
    aligner = Aligner(letter_h())
    h = letter_h()[1].at(aligner.x, aligner.y)
    which = np.array([1])
    for gain, level, slope in ((150.0, 40.0, 0.0), (30.0, 10.0, 12.0)):
        patch = (gain * h + level + slope * aligner.x).astype(np.float32)[None]
        patch[0, (aligner.x > 0.1) & (aligner.y > 0.2)] = level  # something hides a corner
        found = aligner.standard(patch, which)[0]
        clear = ((aligner.x < 0.0) | (aligner.y < 0.1)) & letter_h()[1].near(aligner.x, aligner.y)
        assert found[clear] == pytest.approx(h[clear], abs=0.12)


def test_the_generator_paints_exactly_what_its_truth_says() -> None:
    """The ink's centre of gravity, on black, against the projected middle."""
    pad = Pad(0.3, -0.2, 0.4, shape="none", color=(255.0, 255.0, 255.0))
    for height, roll in ((2.0, 0.0), (9.0, 0.0), (6.0, 0.1)):
        matrix = ground_to_picture(height, roll, 0.0)
        picture = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.float32)
        stamp(picture, matrix, (pad.x, pad.y), pad.angle, 0.25, 2.2, surface_of(np.random.default_rng(0), pad, 0.0))
        weight = picture[..., 0].astype(float)
        truth = truth_of(pad, matrix)
        u = (weight.sum(axis=0) * np.arange(SIZE[0])).sum() / weight.sum()
        v = (weight.sum(axis=1) * np.arange(SIZE[1])).sum() / weight.sum()
        assert (u, v) == pytest.approx((truth.u, truth.v), abs=0.05)
        moments = cv2.moments(picture[..., 0])
        long_axis = 0.5 * math.atan2(2 * moments["mu11"], moments["mu20"] - moments["mu02"])
        assert roll or abs((long_axis + math.pi / 2 - truth.heading + math.pi / 2) % math.pi - math.pi / 2) < 0.02
        assert truth.scale_px == pytest.approx(520.0 * 0.25 / height, rel=0.03)


def test_the_generator_repeats_itself_and_hides_what_it_says() -> None:
    one, same, other = sample(32_000_000), sample(32_000_000), sample(32_000_001)
    assert isinstance(one, Sample)
    assert np.array_equal(one.frame, same.frame)
    assert not np.array_equal(one.frame, other.frame)
    assert sample(32_000_000, "clutter").pads == sample(32_000_000, "lookalike").pads == ()
    x, y = np.meshgrid(np.linspace(-0.35, 0.35, 141), np.linspace(-0.5, 0.5, 201))
    pad = Pad(0.0, 0.0, 0.0, background=(0.0, 0.0, 0.0))
    for hidden in (0.1, 0.3):
        which, _ = surface_of(np.random.default_rng(3), pad, hidden)(x, y)
        plain, _ = surface_of(np.random.default_rng(3), pad, 0.0)(x, y)
        assert np.mean(which != plain) == pytest.approx(hidden, abs=0.05)


def test_the_letters_differ() -> None:
    y, x = np.mgrid[-0.5:0.5:41j, -0.4:0.4:33j]
    drawn = {name: ink(name, x, y, 0.7, 0.18).tobytes() for name in ("H", "N", "A", "X", "+", "O", "E", "T", "U", "II")}
    assert len(set(drawn.values())) == len(drawn)
