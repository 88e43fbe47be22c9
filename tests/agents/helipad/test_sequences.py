"""Pictures one after another: what happens to a pad while it is watched, and what only several pictures show."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from agents.helipad.detector import Detection, Sight
from agents.helipad.refine import SIDE
from agents.helipad.search import Searcher
from agents.helipad.tracks import LEAST, PICTURES, Place, Tracks
from tests.agents.helipad.sequences import longest_gap, right, sequence, watched

SEED = 33_000_000
PICTURES_OF_IT = 24
"""a quarter before and a quarter after what happens; 15 a second"""


@pytest.mark.parametrize(
    ("happening", "share", "gap"),
    [
        ("hand", 0.6, 9),
        ("shadow", 0.9, 2),
        ("edge", 0.5, 12),
        ("blur", 0.7, 5),
        ("rolling shutter", 0.9, 2),
        ("exposure", 0.8, 3),
        ("video", 0.9, 2),
    ],
)
def test_it_is_seen_again_and_again_whatever_happens(happening: str, share: float, gap: int) -> None:
    """``gap``: pictures in a row in which it may be missed, of those ``PICTURES_OF_IT``."""
    shots = sequence(SEED, height=(4.0, 6.0), count=PICTURES_OF_IT, happening=happening)
    told = watched(shots)
    seen = [any(right(shot, each.detection) for each in found) for shot, found in zip(shots, told, strict=True)]
    assert np.mean(seen) >= share
    assert longest_gap(seen) <= gap
    assert seen[0]
    assert seen[-1]
    wrong = [each for shot, found in zip(shots, told, strict=True) for each in found if not right(shot, each.detection)]
    assert wrong == []


def test_hard_pictures_together_show_more_than_each_alone() -> None:
    alone = together = pictures = 0
    for number in range(8):
        shots = sequence(SEED + 100 + number, hard=True, height=(10.0, 12.0))
        for shot, found in zip(shots, watched(shots), strict=True):
            pictures += 1
            there = [each for each in found if right(shot, each.detection)]
            together += bool(there)
            alone += any(each.pictures == 1 for each in there)
            assert all(each.pictures == 1 or LEAST <= each.pictures <= PICTURES for each in found)
    assert together > alone
    assert together >= 0.4 * pictures


def test_hard_pads_to_10_m_are_told_of_within_five_pictures() -> None:
    told = 0
    for number in range(10):
        shots = sequence(SEED + 200 + number, hard=True, height=(1.0, 10.0), count=PICTURES)
        found = watched(shots)
        told += any(right(shot, each.detection) for shot, some in zip(shots, found, strict=True) for each in some)
    assert told >= 9


@pytest.mark.parametrize("kind", ["clutter", "lookalike"])
def test_hard_pictures_of_no_pad_together_show_none(kind: str) -> None:
    wrong = sum(any(watched(sequence(SEED + 300 + number, kind, hard=True))) for number in range(10))
    assert wrong <= 1


# Tracks alone.


def doubtful(odds: float = 1.0, noise: float = 0.0, seed: int = 0) -> Sight:
    """An H with its patch, not sure of it."""
    symbol, aligner = Searcher().symbols[1], Searcher().aligner
    patch = symbol.at(aligner.x, aligner.y) + noise * np.random.default_rng(seed).normal(size=SIDE * SIDE)
    return Sight(Detection(100.0, 100.0, 13.0, 0.3, 0.3), patch.astype(np.float32), 0.7, odds, False)


def at(north: float = 0.0, east: float = 0.0, bearing: float = 0.3) -> Place:
    return Place(north, east, 0.05, bearing)


def test_a_doubtful_sight_is_told_of_as_the_third_picture_shows_it() -> None:
    tracks = Tracks(0.25)
    assert [len(tracks.told(0.1 * i, [(doubtful(), at())])) for i in range(3)] == [0, 0, 1]
    (told,) = tracks.told(0.3, [(doubtful(), at(0.05, -0.03))])
    assert (told.number, told.pictures) == (0, 4)
    assert told.span == pytest.approx(0.3)
    assert told.detection.score > doubtful().detection.score


def test_two_of_five_pictures_are_too_few() -> None:
    tracks = Tracks(0.25)
    for i in range(12):
        assert tracks.told(0.1 * i, [(doubtful(), at())] if i % 3 == 0 else []) == []


@pytest.mark.parametrize(
    "places",
    [
        [at(0.6 * i) for i in range(6)],
        [at(bearing=0.3 + 0.6 * i) for i in range(6)],
    ],
    ids=["elsewhere", "turned"],
)
def test_what_does_not_stay_is_not_told_of(places: list[Place]) -> None:
    tracks = Tracks(0.25)
    assert all(tracks.told(0.1 * i, [(doubtful(), place)]) == [] for i, place in enumerate(places))


def test_what_stays_and_is_no_h_is_not_told_of() -> None:
    """Two bars without the one between them."""
    tracks = Tracks(0.25)
    aligner = Searcher().aligner
    bars = ((np.abs(np.abs(aligner.x) - 0.26) < 0.09) & (np.abs(aligner.y) < 0.5)).astype(np.float32)
    sight = dataclasses.replace(doubtful(), patch=bars)
    assert all(tracks.told(0.1 * i, [(sight, at())]) == [] for i in range(6))


def test_half_a_turn_more_is_the_same_pad() -> None:
    tracks = Tracks(0.25)
    for i in range(3):
        sight = doubtful()
        turned = dataclasses.replace(sight, patch=sight.patch[::-1].copy()) if i % 2 else sight
        told = tracks.told(0.1 * i, [(turned, at(bearing=(0.02 if i % 2 else math.pi - 0.02)))])
    assert len(told) == 1


def test_a_gap_of_time_and_a_clock_that_is_set_back_begin_again() -> None:
    for later in (5.0, -1.0):
        tracks = Tracks(0.25)
        for i in range(2):
            tracks.told(0.1 * i, [(doubtful(), at())])
        assert tracks.told(0.2 + later, [(doubtful(), at())]) == []
        assert len(tracks.wanted) == 1


def test_without_a_place_only_what_is_sure_is_told_of() -> None:
    tracks = Tracks(0.25)
    for i in range(5):
        assert tracks.told(0.1 * i, [(doubtful(), None)]) == []
    sure = dataclasses.replace(doubtful(), sure=True)
    (told,) = tracks.told(0.6, [(sure, None)])
    assert (told.detection, told.pictures, told.span) == (sure.detection, 1, 0.0)
    assert tracks.wanted == []
