"""Turbulence against Dryden's statistics (MIL-F-8785C), and the air's density against the standard atmosphere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from zmav.errors import BadConfig
from zmav.sim.air import GUSTS, Air, density, scales
from zmav.sim.arrays import Array
from zmav.sim.environment import Environment

WIND = (6.0, -2.0, 0.0)


def record(air: Air, height: float, seconds: float, speed: float = 0.0) -> Array:
    """Wind (T, 3, N) felt by vehicles at a height that move at ``speed`` through the mean wind, going north."""
    pos, vel = np.zeros((3, air.mean.shape[1])), air.mean.copy()
    pos[2], vel[0] = -height, vel[0] + speed
    return np.array([air.step(pos, vel).copy() for _ in range(round(seconds / air.dt))])


def make(gusts: str, n: int, dt: float, seed: int = 1) -> Air:
    return Environment(WIND, gusts=gusts).air(n, (seed,), dt)


def along(gusts: Array) -> tuple[Array, Array, Array]:
    """Gusts along the mean wind, across it and down."""
    c, s = np.array(WIND[:2]) / np.hypot(WIND[0], WIND[1])
    return gusts[:, 0] * c + gusts[:, 1] * s, gusts[:, 1] * c - gusts[:, 0] * s, gusts[:, 2]


@pytest.mark.parametrize(("gusts", "height"), [("light", 30.0), ("moderate", 100.0), ("severe", 300.0)])
@pytest.mark.parametrize("dt", [0.01, 0.1, 30.0])
def test_intensities_are_the_standards_whatever_the_step(gusts: str, height: float, dt: float) -> None:
    air = make(gusts, 800, dt)
    felt = record(air, height, 20 * dt) - np.array(WIND)[:, None]
    feet = height / 0.3048
    vertical = 0.1 * GUSTS[gusts]
    level = vertical / (0.177 + 0.000823 * min(feet, 1000.0)) ** 0.4
    u, v, w = (part[-1].std() for part in along(felt))
    assert [u, v, w] == pytest.approx([level, level, vertical], rel=0.1)
    assert abs(felt[-1].mean()) < 0.15 * vertical


def test_lengths_are_the_integrals_of_the_correlations() -> None:
    """Of the gust along the way: exp(-V t / L), whose integral over the way is L. Of those aside and down with
    their zero at 0 Hz lower, (1 - x / 2) exp(-x): half of it.
    """
    speed, height, dt = 20.0, 100.0, 0.1
    felt = record(make("moderate", 150, dt), height, 100.0, speed) - np.array(WIND)[:, None]
    length, upright, _, _ = (float(x[0]) for x in scales(np.array([height]), GUSTS["moderate"]))
    shapes: list[Callable[[Array], Array]] = [np.exp, _transverse, _transverse]
    for part, wanted, shape in zip(along(felt), (length, length, upright), shapes, strict=True):
        variance = (part * part).mean()
        for lag in (5, 20):
            found = (part[:-lag] * part[lag:]).mean() / variance
            assert found == pytest.approx(float(shape(np.array(-lag * dt * speed / wanted))), abs=0.06)


def _transverse(x: Array) -> Array:
    """Correlation of Dryden's transverse gusts at minus the way over the length."""
    result: Array = (1.0 + x / 2.0) * np.exp(x)
    return result


def test_a_vehicle_that_stands_in_a_calm_feels_gusts_come_and_go() -> None:
    air = Environment(gusts="light").air(1, (3,), 0.1)
    pos, vel = np.zeros((3, 1)), np.zeros((3, 1))
    felt = np.array([air.step(pos, vel).copy() for _ in range(600)])
    assert felt.std(0).min() > 0.2


def test_higher_up_the_lengths_grow_to_those_of_high_altitude() -> None:
    low, _, _, _ = scales(np.array([1000.0 * 0.3048]), 10.0)
    high, upright, _, _ = scales(np.array([2500.0 * 0.3048]), 10.0)
    assert [low[0], high[0], upright[0]] == pytest.approx([1000 * 0.3048, 1750 * 0.3048, 1750 * 0.3048], rel=1e-3)


def test_no_gusts_are_the_mean_and_nothing_else() -> None:
    air = make("none", 3, 0.01)
    assert (record(air, 20.0, 0.1) == np.array(WIND)[:, None]).all()


def test_a_seed_gives_the_same_gusts_and_a_further_vehicle_changes_none() -> None:
    two, again, five = make("severe", 2, 0.01), make("severe", 2, 0.01), make("severe", 5, 0.01)
    felt = record(two, 50.0, 5.0)
    assert (felt == record(again, 50.0, 5.0)).all()
    assert (felt == record(five, 50.0, 5.0)[:, :, :2]).all()
    assert np.abs(felt - record(make("severe", 2, 0.01, seed=2), 50.0, 5.0)).max() > 1.0
    assert np.abs(felt[:, :, 0] - felt[:, :, 1]).max() > 1.0  # and vehicles are independent


def test_density_of_the_standard_atmosphere() -> None:
    table = {0.0: 1.225, 1000.0: 1.1116, 3000.0: 0.90912}  # ISO 2533, table 5
    assert density(np.array(list(table))) == pytest.approx(list(table.values()), rel=2e-4)


def test_unknown_gusts_are_refused_by_name() -> None:
    with pytest.raises(BadConfig, match="none, light, moderate, severe") as caught:
        Environment(gusts="gale")
    assert caught.value.detail["field"] == "gusts"
