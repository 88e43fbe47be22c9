"""A pad whose level is said wrongly is followed down all the same: its size tells."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from agents.helipad import Detector
from agents.helipad.geolocate import BY_SIZE, camera_height, sized_plane
from agents.helipad.level import FORGOTTEN, UNKNOWN, PadLevel
from tests.agents.helipad.generator import CAMERA, SYMBOL_M, Sample, sample
from zmav.vision.optics import Optics
from zmav.vision.poses import Pose
from zmav.wire import CameraInfo

OPTICS = Optics.of(
    CameraInfo(
        t=0.0,
        camera="down",
        width=640,
        height=480,
        focal=(float(CAMERA[0, 0]), float(CAMERA[1, 1])),
        center=(float(CAMERA[0, 2]), float(CAMERA[1, 2])),
        rate_hz=15.0,
    )
)


@functools.cache
def descent() -> list[Sample]:
    """From 5 m to 0.7 m above a pad."""
    return [sample(52_000_000 + n, height=(h, h), whole_pad=True) for n, h in enumerate(np.linspace(5.0, 0.7, 20))]


def found_below(height: float, wrong: float, learns: bool) -> list[bool]:
    """Of a descent onto a pad at 0 m down that is said to be at ``wrong``: in which pictures below it was found."""
    detector, level, found = Detector(CAMERA, SYMBOL_M, trust_height=True), PadLevel(), []
    for number, made in enumerate(descent()):
        t, above = number / 5.0, made.height_m
        pose = Pose(t, (0.0, 0.0, -above), made.roll, made.pitch, 0.0, 0.0)
        hint = camera_height(OPTICS, pose, level.at(t, wrong))
        symbol, truth = made.pad_specs[0].symbol_m, made.pads[0]
        best = detector.detect(made.frame, hint * SYMBOL_M / symbol, made.roll, made.pitch)[:1]
        hit = bool(best) and math.hypot(best[0].u - truth.u, best[0].v - truth.v) < 0.3 * truth.scale_px
        if best and learns:
            sized = sized_plane(OPTICS, pose, (best[0].u, best[0].v), best[0].scale_px, symbol)
            assert sized is not None
            level.learn(t, wrong, sized, camera_height(OPTICS, pose, sized))
        if above < height:
            found.append(hit)
    return found


@pytest.mark.parametrize("wrong", [-0.5, 0.6])
def test_it_is_found_down_to_the_pad_though_its_level_is_said_wrongly(wrong: float) -> None:
    assert sum(found_below(1.1, wrong, learns=False)) == 0
    assert all(found_below(1.1, wrong, learns=True))


def test_what_is_said_is_put_right_by_sizes_and_counts_again_when_nothing_was_seen_for_long() -> None:
    level, rng = PadLevel(), np.random.default_rng(4)
    assert level.at(0.0, 3.0) == 3.0
    for number in range(60):
        sized = 2.4 + BY_SIZE * 5.0 * rng.normal()
        level.learn(number / 15.0, 3.0, sized, 5.0)
    last = 59 / 15.0
    assert level.at(last, 3.0) == pytest.approx(2.4, abs=BY_SIZE * 5.0)
    assert level.at(last, 7.0) - level.at(last, 3.0) == pytest.approx(4.0), "a target on a slope"
    assert level.at(last + FORGOTTEN, 3.0) == 3.0
    assert level.at(last - 1.0, 3.0) == 3.0, "the clock was set back"
    # The first sight afterwards counts as the first of all does.
    level.learn(last + 2.0 * FORGOTTEN, 3.0, 4.0, 5.0)
    gain = UNKNOWN**2 / (UNKNOWN**2 + (BY_SIZE * 5.0) ** 2)
    assert level.at(last + 2.0 * FORGOTTEN, 3.0) == pytest.approx(3.0 + gain)
