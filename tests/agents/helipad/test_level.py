"""A pad whose level is said wrongly is followed down all the same: its size tells."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from agents.helipad import Detector
from agents.helipad.geolocate import BY_SIZE, camera_height, sized_plane
from agents.helipad.level import FORGOTTEN, MOST, UNKNOWN, PadLevel
from tests.agents.helipad.generator import CAMERA, INFO, SYMBOL_M, Sample, sample
from zmav.vision.optics import Optics
from zmav.vision.poses import Pose

OPTICS = Optics.of(INFO)


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
            sized = sized_plane(OPTICS, pose, best[0], symbol)
            assert sized is not None
            level.learn(t, wrong, sized, BY_SIZE * camera_height(OPTICS, pose, sized))
        if above < height:
            found.append(hit)
    return found


@pytest.mark.parametrize("wrong", [-0.5, 0.6])
def test_it_is_found_down_to_the_pad_though_its_level_is_said_wrongly(wrong: float) -> None:
    assert found_below(1.1, wrong, learns=False) == [False, False]
    assert found_below(1.1, wrong, learns=True) == [True, True]


SD = BY_SIZE * 5.0


def learned(said: float = 3.0, true: float = 2.4, count: int = 60) -> PadLevel:
    """From pictures of the time 0 to 4 s, 5 m above a pad that is ``true`` m down and said to be ``said``."""
    level, rng = PadLevel(), np.random.default_rng(4)
    for number in range(count):
        level.learn(4.0 * number / (count - 1), said, true + SD * rng.normal(), SD)
    return level


def test_what_is_said_is_put_right_by_sizes_and_counts_again_when_nothing_was_seen_for_long() -> None:
    level = learned()
    assert PadLevel().at(0.0, 3.0) == 3.0
    assert level.at(4.0, 3.0) == pytest.approx(2.4, abs=0.5 * SD)
    assert level.at(4.0, 7.0) == pytest.approx(6.4, abs=0.5 * SD), "the carrier went down a slope"
    assert level.at(4.0 + FORGOTTEN, 3.0) == 3.0
    assert level.at(3.0, 3.0) == 3.0, "the clock was set back"
    # The first sight afterwards counts as the first of all does.
    level.learn(30.0, 3.0, 4.0, SD)
    assert level.at(30.0, 3.0) == pytest.approx(3.0 + UNKNOWN**2 / (UNKNOWN**2 + SD**2))


def test_a_size_that_no_pad_there_can_have_teaches_nothing() -> None:
    level = learned()
    before = level.at(4.0, 3.0)
    for number in range(3):
        level.learn(4.1 + 0.1 * number, 3.0, 4.6, SD)
    assert level.at(4.3, 3.0) == before, "three strays"
    level.learn(4.4, 3.0, 4.6, SD)
    assert level.at(4.4, 3.0) == pytest.approx(4.6, abs=0.3), "the fourth in a row: the level was wrong"
    for number in range(20):
        level.learn(4.5 + 0.1 * number, 3.0, 3.1 + MOST, SD)
    assert level.at(6.4, 3.0) == pytest.approx(4.6, abs=0.3), "farther from what is said than any pad is"
    level.learn(6.5, 3.0, math.nan, SD)
    assert math.isfinite(level.at(6.5, 3.0))
