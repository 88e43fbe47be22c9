"""What the detector promises of each kind of pad, picture and hint."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest

from agents.helipad import Detection, Detector
from tests.agents.helipad.generator import (
    BACKGROUNDS,
    CAMERA,
    WHITE,
    YELLOW,
    Pad,
    Sample,
    Wear,
    ground_to_picture,
    render,
    truth_of,
)
from tests.agents.helipad.test_recall import away, off
from zmav.errors import BadInput

SEED = 31_000_000
FIVE_M = 5.0


def shot(
    pads: list[Pad],
    height: float = FIVE_M,
    roll: float = 0.0,
    pitch: float = 0.0,
    wear: Wear | None = None,
    seed: int = 0,
    things: int = 5,
) -> Sample:
    """A frame with exactly these pads and a few things beside them, some of which are letters, but no H."""
    matrix = ground_to_picture(height, roll, pitch)
    frame = render(np.random.default_rng([SEED, seed]), matrix, height, pads, wear or Wear(), things)
    return Sample(frame, tuple(truth_of(pad, matrix) for pad in pads), height, roll, pitch, tuple(pads))


def only(found: list[Detection]) -> Detection:
    assert len(found) == 1, found
    return found[0]


def at_pad(one: Detection, made: Sample, number: int = 0) -> bool:
    truth = made.pads[number]
    return (
        away(one, truth) < 0.1 * truth.scale_px and off(one, truth) < 4.0 and 0.9 < one.scale_px / truth.scale_px < 1.1
    )


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector(CAMERA)


@pytest.fixture(scope="module")
def pad_frame() -> Sample:
    return shot([Pad(0.4, -0.3, 0.7)], roll=0.1, pitch=-0.12)


@pytest.mark.parametrize("shape", ["disc", "ring", "square", "none"])
@pytest.mark.parametrize("color", [WHITE, YELLOW], ids=["white", "yellow"])
def test_every_kind_of_pad_is_found(detector: Detector, shape: str, color: tuple[float, float, float]) -> None:
    for i, background in enumerate(BACKGROUNDS[:3]):
        made = shot([Pad(0.5, -0.4, 0.4 + i, shape=shape, color=color, background=background)], 3.0 + 2.0 * i, seed=i)
        assert at_pad(only(detector.detect(made.frame, made.height_m)), made)


def test_yellow_on_ground_that_is_as_bright_is_found_by_its_colour(detector: Detector) -> None:
    """Grey 187 on grey 187."""
    made = shot([Pad(0.2, 0.3, 1.0, shape="square", color=YELLOW, background=(187.0, 187.0, 187.0))])
    grey = cv2.cvtColor(made.frame, cv2.COLOR_BGR2GRAY)
    assert detector.detect(np.asarray(grey), made.height_m) == []
    assert at_pad(only(detector.detect(made.frame, made.height_m)), made)


def test_a_grey_frame_will_do(detector: Detector, pad_frame: Sample) -> None:
    grey = np.asarray(cv2.cvtColor(pad_frame.frame, cv2.COLOR_BGR2GRAY))
    found = detector.detect(grey, pad_frame.height_m, pad_frame.roll, pad_frame.pitch)
    assert at_pad(only(found), pad_frame)


def test_a_mirror_image_is_the_same_letter(detector: Detector) -> None:
    made = shot([Pad(0.5, 0.2, 0.6, mirrored=True)])
    assert at_pad(only(detector.detect(made.frame, made.height_m)), made)
    mirrored = np.ascontiguousarray(made.frame[:, ::-1])
    one = only(detector.detect(mirrored, made.height_m))
    assert abs(one.u - (639.0 - made.pads[0].u)) < 0.5
    assert abs(one.heading - (math.pi - made.pads[0].heading)) < 0.05


def test_two_pads_are_both_found(detector: Detector) -> None:
    made = shot([Pad(-0.8, 0.2, 0.5), Pad(0.9, -0.4, 2.0, color=YELLOW, background=BACKGROUNDS[3])])
    found = detector.detect(made.frame, made.height_m)
    assert len(found) == 2
    assert found[0].score >= found[1].score
    for number in (0, 1):
        assert sum(at_pad(one, made, number) for one in found) == 1


def test_a_wrong_height_is_survived_within_four_frames(detector: Detector, pad_frame: Sample) -> None:
    for wrong in (0.4, 0.75, 1.3, 2.2):
        hints = (wrong * pad_frame.height_m, pad_frame.roll, pad_frame.pitch)
        found = [one for _ in range(4) for one in detector.detect(pad_frame.frame, *hints)]
        assert found, wrong
        assert all(at_pad(one, pad_frame) for one in found), wrong


def test_a_trusted_height_is_the_only_one(pad_frame: Sample) -> None:
    detector = Detector(CAMERA, trust_height=True)
    height, roll, pitch = pad_frame.height_m, pad_frame.roll, pad_frame.pitch
    assert at_pad(only(detector.detect(pad_frame.frame, height, roll, pitch)), pad_frame)
    assert detector.detect(pad_frame.frame, 2.2 * height, roll, pitch) == []


def test_without_any_hint_a_pad_is_found_near_and_far(detector: Detector) -> None:
    for i, height in enumerate((0.8, 1.7, 3.0, 7.0, 11.0)):
        made = shot([Pad(0.1 * height, -0.08 * height, 0.4 * i)], height, seed=10 + i)
        assert at_pad(only(detector.detect(made.frame)), made), height


def test_a_tilted_camera_is_allowed_for(detector: Detector) -> None:
    for i, (roll, pitch) in enumerate(((0.26, 0.26), (-0.26, 0.26), (0.26, -0.26), (-0.4, 0.0))):
        made = shot([Pad(0.0, 0.0, 0.3 + i)], 6.0, roll, pitch, seed=20 + i)
        assert at_pad(only(detector.detect(made.frame, 6.0, roll, pitch)), made)


def test_a_lens_that_bends_is_allowed_for(pad_frame: Sample) -> None:
    """The frame is bent with OpenCV's own functions, and so is the truth."""
    bend = np.array([-0.25, 0.06, 0.001, -0.001, 0.0])
    v, u = np.mgrid[0:480, 0:640].astype(np.float64)
    straight = cv2.undistortPoints(np.stack([u.ravel(), v.ravel()], axis=1).reshape(-1, 1, 2), CAMERA, bend, P=CAMERA)
    where = np.asarray(straight, dtype=np.float32).reshape(480, 640, 2)
    made = shot([Pad(2.0, -1.4, 0.7)])
    bent = np.asarray(cv2.remap(made.frame, where[..., 0], where[..., 1], cv2.INTER_LINEAR))
    truth = made.pads[0]
    ray = np.array([[truth.u - CAMERA[0, 2], truth.v - CAMERA[1, 2], CAMERA[0, 0]]]) / CAMERA[0, 0]
    place = np.ravel(cv2.projectPoints(ray, np.zeros(3), np.zeros(3), CAMERA, bend)[0])
    one = only(Detector(CAMERA, distortion=bend).detect(bent, made.height_m))
    assert math.hypot(one.u - place[0], one.v - place[1]) < 0.4


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_picture_of_one_value_holds_nothing(detector: Detector, value: int) -> None:
    frame = np.full((480, 640, 3), value, dtype=np.uint8)
    assert detector.detect(frame, 5.0) == []
    assert detector.detect(frame) == []


def test_an_overexposed_picture_holds_nothing_and_a_bright_one_a_pad(detector: Detector, pad_frame: Sample) -> None:
    """At a gain of 9 all but black is white."""
    hints = (pad_frame.height_m, pad_frame.roll, pad_frame.pitch)
    burnt = shot(list(pad_frame.pad_specs), roll=0.1, pitch=-0.12, wear=Wear(gain=9.0))
    assert np.mean(burnt.frame == 255) > 0.6
    assert detector.detect(burnt.frame, *hints) == []
    bright = shot(list(pad_frame.pad_specs), roll=0.1, pitch=-0.12, wear=Wear(gain=1.8))
    assert at_pad(only(detector.detect(bright.frame, *hints)), bright)


def test_pure_noise_holds_nothing(detector: Detector) -> None:
    noise = np.random.default_rng(SEED).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    assert detector.detect(noise, 6.0) == []
    assert detector.detect(noise) == []


def test_tracking_finds_what_is_near_and_nothing_else(detector: Detector) -> None:
    made = shot([Pad(-0.8, 0.2, 0.5), Pad(0.9, -0.4, 2.0)])
    for number, truth in enumerate(made.pads):
        last = Detection(truth.u + 0.5 * truth.scale_px, truth.v - 0.5 * truth.scale_px, 1.1 * truth.scale_px, 0.0, 1.0)
        assert at_pad(only(detector.detect(made.frame, made.height_m, near=last)), made, number)
        assert at_pad(only(detector.detect(made.frame, near=last)), made, number)
    lost = Detection(320.0, 60.0, made.pads[0].scale_px, 0.0, 1.0)
    assert detector.detect(made.frame, made.height_m, near=lost) == []
    for outside in (Detection(-500.0, 100.0, 30.0, 0.0, 1.0), Detection(700.0, 9000.0, 30.0, 0.0, 1.0)):
        assert detector.detect(made.frame, made.height_m, near=outside) == []


def test_a_track_measures_as_a_search_does(detector: Detector, pad_frame: Sample) -> None:
    hints = (pad_frame.height_m, pad_frame.roll, pad_frame.pitch)
    one = only(detector.detect(pad_frame.frame, *hints))
    again = only(detector.detect(pad_frame.frame, *hints, near=one))
    assert math.hypot(one.u - again.u, one.v - again.v) < 0.05
    assert abs(one.heading - again.heading) < 0.01


def test_the_same_frame_gives_the_same(detector: Detector, pad_frame: Sample) -> None:
    first = detector.detect(pad_frame.frame)
    detector.detect(np.zeros((100, 120), dtype=np.uint8), 3.0)
    kept = pad_frame.frame.copy()
    assert detector.detect(pad_frame.frame) == first == Detector(CAMERA).detect(pad_frame.frame)
    assert np.array_equal(kept, pad_frame.frame)


@pytest.mark.parametrize(
    "frame",
    [
        None,
        "frame",
        [[1, 2], [3, 4]],
        np.zeros((0, 0, 3), dtype=np.uint8),
        np.zeros((480, 640, 4), dtype=np.uint8),
        np.zeros((480, 640, 3), dtype=np.float32),
        np.zeros((480, 640, 3, 1), dtype=np.uint8),
        np.zeros((8, 640), dtype=np.uint8),
    ],
)
def test_what_is_no_frame_is_refused(detector: Detector, frame: object) -> None:
    with pytest.raises(BadInput) as caught:
        detector.detect(frame, 5.0)
    assert caught.value.detail["field"] == "frame"


@pytest.mark.parametrize(
    ("field", "hints"),
    [
        ("height_m", {"height_m": 0.0}),
        ("height_m", {"height_m": -3.0}),
        ("height_m", {"height_m": math.nan}),
        ("height_m", {"height_m": "5"}),
        ("roll", {"roll": math.inf}),
        ("pitch", {"pitch": 2.0}),
        ("near", {"near": Detection(math.nan, 1.0, 20.0, 0.0, 1.0)}),
    ],
)
def test_hints_that_are_none_are_refused(detector: Detector, field: str, hints: dict[str, Any]) -> None:
    with pytest.raises(BadInput) as caught:
        detector.detect(np.zeros((480, 640, 3), dtype=np.uint8), **hints)
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("camera_matrix", {"camera_matrix": np.eye(2)}),
        ("camera_matrix", {"camera_matrix": "K"}),
        ("camera_matrix", {"camera_matrix": np.diag([0.0, 500.0, 1.0])}),
        ("camera_matrix", {"camera_matrix": np.diag([math.nan, 500.0, 1.0])}),
        ("symbol_height_m", {"symbol_height_m": 0.0}),
        ("distortion", {"distortion": [0.1, 0.2]}),
    ],
)
def test_a_detector_of_nonsense_is_refused(field: str, options: dict[str, Any]) -> None:
    with pytest.raises(BadInput) as caught:
        Detector(**{"camera_matrix": CAMERA, **options})
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize("size", [(16, 16), (17, 640), (480, 16), (33, 47)])
def test_frames_of_any_size_are_searched(detector: Detector, size: tuple[int, int]) -> None:
    noise = np.random.default_rng(SEED + 1).integers(0, 256, (*size, 3), dtype=np.uint8)
    assert detector.detect(noise) == []
    assert detector.detect(noise, 3.0, 0.5, -0.5) == []


def test_a_view_beyond_the_horizon_is_searched_as_far_as_it_is_ground(detector: Detector) -> None:
    noise = np.random.default_rng(SEED + 2).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    assert detector.detect(noise, 6.0, math.radians(60.0), math.radians(60.0)) == []
