"""How many pads are found, how well, and what is taken for one that is none. The thresholds leave room for the binomial
spread of what tests/bench/helipad.py measures on thousands of other frames (docs/vision.md).
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from agents.helipad import Detection, Detector
from tests.agents.helipad.generator import CAMERA, SYMBOL_M, Sample, Truth, sample

FIRST_SEED = 30_000_000


@functools.cache
def easy(number: int) -> Sample:
    """One of the frames that two tests look at."""
    return sample(FIRST_SEED + number, height=(1.0, 10.0))


def found_in(made: Sample, hints: bool = True) -> list[Detection]:
    symbol = made.pad_specs[0].symbol_m if made.pad_specs else SYMBOL_M
    rng = np.random.default_rng(round(1e6 * made.height_m))
    height, roll, pitch = made.hints(rng)
    detector = Detector(CAMERA, symbol)
    return detector.detect(made.frame, height, roll, pitch) if hints else detector.detect(made.frame)


def away(one: Detection, truth: Truth) -> float:
    """Pixels."""
    return math.hypot(one.u - truth.u, one.v - truth.v)


def off(one: Detection, truth: Truth) -> float:
    """Degrees."""
    return abs(math.degrees((one.heading - truth.heading + math.pi / 2.0) % math.pi - math.pi / 2.0))


def hits(seed: int, count: int, hard: bool, height: tuple[float, float], whole_pad: bool = False) -> int:
    total = 0
    for made in (sample(seed + i, "pad", hard, height, whole_pad) for i in range(count)):
        best = found_in(made)[:1]
        total += bool(best and away(best[0], made.pads[0]) < 0.3 * made.pads[0].scale_px)
    return total


def test_a_pad_is_found_to_10_m_and_measured() -> None:
    places, headings, scales, missed = [], [], [], 0
    for made in map(easy, range(50)):
        truth = made.pads[0]
        best = found_in(made)[:1]
        if not best or away(best[0], truth) > 0.3 * truth.scale_px:
            missed += 1
            continue
        places.append(away(best[0], truth))
        headings.append(off(best[0], truth))
        scales.append(abs(best[0].scale_px / truth.scale_px - 1.0))
        assert 0.0 < best[0].score <= 1.0
        assert 0.0 <= best[0].heading < math.pi
    assert missed <= 2
    assert np.median(places) < 0.12
    assert np.median(headings) < 0.5
    assert np.median(scales) < 0.05


def test_a_pad_is_found_from_10_to_12_m() -> None:
    assert hits(FIRST_SEED + 100, 25, False, (10.0, 12.0)) >= 23


def test_a_pad_is_found_in_hard_frames() -> None:
    assert hits(FIRST_SEED + 200, 40, True, (1.0, 10.0)) >= 26


def test_a_small_pad_is_found_to_10_m() -> None:
    """The pad, not the letter, is 0.25 m wide."""
    assert hits(FIRST_SEED + 500, 30, False, (1.0, 10.0), whole_pad=True) >= 26


@pytest.mark.parametrize(
    ("kind", "hard", "most"),
    [("clutter", False, 1), ("clutter", True, 1), ("lookalike", False, 1), ("lookalike", True, 2)],
)
def test_frames_without_a_pad_give_none(kind: str, hard: bool, most: int) -> None:
    false = sum(bool(found_in(sample(FIRST_SEED + 300 + i, kind, hard))) for i in range(25))
    assert false <= most


def test_no_hints_cost_little_where_the_camera_is_nearly_level() -> None:
    found = level = 0
    for made in map(easy, range(30)):
        if max(abs(made.roll), abs(made.pitch)) <= math.radians(9.0):
            best = found_in(made, hints=False)[:1]
            level += 1
            found += bool(best and away(best[0], made.pads[0]) < 0.3 * made.pads[0].scale_px)
    assert level >= 5
    assert found >= 0.8 * level
