"""What is said of a flight: errors against where it should have been, the way itself, and where the peaks are."""

from __future__ import annotations

import numpy as np
import pytest

from agents.navigator.path import Array
from agents.navigator.routes import shape
from agents.navigator.tracking import Summary, errors, summarise
from agents.navigator.trajectory import Limits, Trajectory

TRAJECTORY = Trajectory(shape("ev3", (0.0, 0.0, -6.0)).reached_from((0.0, 0.0, -5.0), 2.0), Limits())
T = np.arange(0.0, TRAJECTORY.duration, 0.05)
MEANT = TRAJECTORY.at(T)


def summary(times: Array, positions: Array, trajectory: Trajectory) -> Summary:
    return summarise(errors(times, positions, trajectory), trajectory.route)


def test_who_is_where_it_should_be_has_no_error() -> None:
    found = summary(T, MEANT.pos, TRAJECTORY)
    assert found.peak < 1e-9
    assert found.length == pytest.approx(70.0)
    assert found.seconds == pytest.approx(82.0, abs=0.1)  # without the way to it


def test_who_is_late_is_off_its_reference() -> None:
    late = TRAJECTORY.at(T - 0.2).pos
    found = summary(T, late, TRAJECTORY)
    assert found.peak == pytest.approx(0.2, abs=1e-3)
    assert found.rms < found.peak


def test_an_offset_is_told_whole() -> None:
    found = summary(T, MEANT.pos + np.array([0.3, 0.0, -0.4]), TRAJECTORY)
    assert found.rms == pytest.approx(0.5)


def bumps(where: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Off by 1 m to the north at some places of each side, (N, 3)."""
    away = np.abs(MEANT.along[:, None] - TRAJECTORY.route.corners[:-1] - where).min(axis=1)
    return MEANT.pos + np.outer(np.exp(-((away / 0.3) ** 2)), (1.0, 0.0, 0.0))


def test_peaks_near_corners_are_told_from_those_between() -> None:
    near, between = summary(T, bumps(0.8), TRAJECTORY), summary(T, bumps(2.5), TRAJECTORY)
    assert near.share_near == 1.0
    assert between.share_near == 0.0
    assert len(near.peaks) == len(between.peaks) == 8
    assert [peak.to_corner for peak in near.peaks] == pytest.approx([0.8] * 8, abs=0.1)
    assert [peak.error for peak in between.peaks] == pytest.approx([1.0] * 8, abs=0.05)
    assert near.time_near == between.time_near < 0.5


def test_what_is_not_of_the_route_has_no_summary() -> None:
    early = TRAJECTORY.begins > T
    with pytest.raises(ValueError, match="no position"):
        summary(T[early], MEANT.pos[early], TRAJECTORY)
