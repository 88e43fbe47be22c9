"""The report, held against systems whose response stands in closed form in the textbooks."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from agents.controllers.inject import Inject, Injection, duration
from agents.controllers.response import ResponseReport, StepResponse, examine, picture
from agents.controllers.types import Array
from zmav.errors import BadConfig, BadInput

HZ = 250.0


def times(args: Inject, before: float = 1.0, after: float = 2.0, hz: float = HZ) -> Array:
    return np.arange(round(-before * hz), round((duration(args) + after) * hz)) / hz


def injected(args: Inject, t: Array) -> Array:
    level: Any = {"z": "position", "x": "position", "yaw": "position", "roll": "attitude"}[args.channel]
    injection = Injection(args, level, 0.0)
    return np.array([injection.value(float(each)) for each in t])


def step(seconds: float = 8.0, amplitude: float = 1.0, channel: str = "z") -> Inject:
    return Inject(kind="step", channel=channel, amplitude=amplitude, seconds=seconds)


def second_order(t: Array, wn: float, zeta: float) -> Array:
    """The unit step response of wn²/(s² + 2 zeta wn s + wn²), underdamped."""
    wd = wn * math.sqrt(1.0 - zeta * zeta)
    since = np.maximum(t, 0.0)
    sway = np.cos(wd * since) + zeta / math.sqrt(1.0 - zeta * zeta) * np.sin(wd * since)
    return np.where(t >= 0.0, 1.0 - np.exp(-zeta * wn * since) * sway, 0.0)


def first_order(t: Array, lag: float) -> Array:
    return np.where(t >= 0.0, 1.0 - np.exp(-np.maximum(t, 0.0) / lag), 0.0)


def of_step(args: Inject, response: Callable[[Array], Array], base: float = -3.0, noise: float = 0.0) -> ResponseReport:
    t = times(args)
    u = injected(args, t)
    y = base + args.amplitude * (response(t) - response(t - args.seconds))
    y = y + noise * np.random.default_rng(1).standard_normal(len(t))
    return examine(args, t + 1.7e9, base + u, y, u)


@given(st.floats(3.0, 12.0), st.floats(0.3, 0.9), st.sampled_from([-1.0, 0.4]))
@hypothesis_settings(max_examples=40)
def test_a_second_order_step_has_the_textbooks_overshoot_and_peak_time(wn: float, zeta: float, size: float) -> None:
    found = of_step(step(12.0, size), lambda t: second_order(t, wn, zeta)).found
    assert isinstance(found, StepResponse)
    wd = wn * math.sqrt(1.0 - zeta * zeta)
    assert found.overshoot == pytest.approx(100.0 * math.exp(-math.pi * zeta * wn / wd), abs=0.5)
    assert found.t_peak == pytest.approx(math.pi / wd, abs=2.0 / HZ + 0.01 * math.pi / wd)
    assert found.peak == pytest.approx(size * (1.0 + math.exp(-math.pi * zeta * wn / wd)), rel=0.01)
    # Rise and settling by a grid a hundred times as fine.
    fine = np.linspace(0.0, 12.0, 300_000)
    y = second_order(fine, wn, zeta)
    rise = fine[np.argmax(y >= 0.9)] - fine[np.argmax(y >= 0.1)]
    assert found.rise == pytest.approx(rise, abs=2e-3)
    for told, band in ((found.settle_5, 0.05), (found.settle_2, 0.02)):
        after = fine[np.flatnonzero(np.abs(y - 1.0) > band)[-1]]
        near = np.abs(np.abs(y[(fine > 0.3 * after)] - 1.0)[:-1] - band).min()  # an extremum just at the band: either
        assert told is not None
        assert abs(told - after) < 0.01 or near < 2e-3


@pytest.mark.parametrize("lag", [0.1, 0.5])
def test_a_first_order_step_is_logarithms(lag: float) -> None:
    found = of_step(step(10.0), lambda t: first_order(t, lag)).found
    assert isinstance(found, StepResponse)
    assert found.rise == pytest.approx(math.log(9.0) * lag, abs=1e-3)
    assert found.delay == pytest.approx(math.log(2.0) * lag, abs=1e-3)
    assert found.settle_5 == pytest.approx(math.log(20.0) * lag, abs=1e-3)
    assert found.settle_2 == pytest.approx(math.log(50.0) * lag, abs=1e-3)
    assert found.overshoot == pytest.approx(0.0, abs=1e-3)
    assert found.steady_error == pytest.approx(0.0, abs=1e-6)


def test_what_stays_short_of_the_reference_is_a_steady_error() -> None:
    report = of_step(step(10.0), lambda t: 0.9 * first_order(t, 0.2))
    assert isinstance(report.found, StepResponse)
    assert report.found.steady_error == pytest.approx(0.1, abs=1e-6)
    assert report.found.rise == pytest.approx(math.log(9.0) * 0.2, abs=1e-3)
    assert report.notes == []


def test_errors_are_those_while_it_was_injected() -> None:
    report = of_step(step(10.0), lambda t: first_order(t, 0.2))
    # The integral of e^(-2t/lag) from 0 to 10 is lag/2.
    assert report.rms == pytest.approx(math.sqrt(0.1 / 10.0), rel=0.02)
    assert report.peak_error == pytest.approx(1.0)


def test_a_reference_that_moves_meanwhile_changes_nothing() -> None:
    args = step(6.0)
    t = times(args)
    u, moving = injected(args, t), 0.5 * t - 3.0
    y = moving - 0.07 + second_order(t, 6.0, 0.5) - second_order(t - 6.0, 6.0, 0.5)
    found, still = examine(args, t, moving + u, y, u).found, of_step(args, lambda t: second_order(t, 6.0, 0.5)).found
    assert isinstance(found, StepResponse)
    assert isinstance(still, StepResponse)
    for name in ("rise", "overshoot", "settle_2", "steady_error"):
        assert getattr(found, name) == pytest.approx(getattr(still, name), abs=1e-6)


def test_a_yaw_past_south_is_one_step() -> None:
    args = step(6.0, 0.5, "yaw")
    t = times(args)
    u = injected(args, t)
    wrap = np.vectorize(lambda a: math.remainder(a, 2.0 * math.pi))
    y = 3.0 + 0.5 * (first_order(t, 0.3) - first_order(t - 6.0, 0.3))
    report = examine(args, t, wrap(3.0 + u), wrap(y), u)
    assert isinstance(report.found, StepResponse)
    assert report.found.rise == pytest.approx(math.log(9.0) * 0.3, abs=1e-3)
    assert report.peak_error == pytest.approx(0.5, abs=1e-6)


def test_noise_widens_the_band_and_is_told() -> None:
    report = of_step(step(8.0), lambda t: second_order(t, 5.0, 0.6), noise=0.02)
    found = report.found
    assert isinstance(found, StepResponse)
    assert found.noise == pytest.approx(0.02, rel=0.2)
    assert found.settle_2 is not None
    assert found.rise == pytest.approx(0.37, abs=0.05)
    assert any("noise" in note for note in report.notes)


def test_what_does_not_follow_or_has_not_come_to_rest_is_told() -> None:
    report = of_step(step(5.0), lambda t: 0.0 * t)
    assert isinstance(report.found, StepResponse)
    assert (report.found.rise, report.found.overshoot, report.found.settle_2) == (None, None, None)
    assert any("does not follow" in note for note in report.notes)
    slow = of_step(step(5.0), lambda t: first_order(t, 4.0))
    assert any("not come to rest" in note for note in slow.notes)
    assert isinstance(slow.found, StepResponse)
    assert slow.found.settle_2 is None
    backwards = of_step(step(5.0), lambda t: -first_order(t, 0.2))
    assert any("does not follow" in note for note in backwards.notes)


def filtered(u: Array, wn: float, zeta: float) -> Array:
    """By integration of wn²/(s² + 2 zeta wn s + wn²) at four steps a sample, the input held."""
    y, v, found, dt = 0.0, 0.0, np.empty(len(u)), 1.0 / HZ / 4.0
    for k, each in enumerate(u):
        found[k] = y
        for _ in range(4):
            v += dt * (wn * wn * (each - y) - 2.0 * zeta * wn * v)
            y += dt * v
    return found


def test_of_a_doublet_the_errors_are_told() -> None:
    args = Inject(kind="doublet", channel="x", amplitude=0.5, seconds=2.0)
    t = times(args)
    u = injected(args, t)
    report = examine(args, t, u, 0.0 * u, u)
    assert report.found is None
    assert report.peak_error == pytest.approx(0.5)
    assert "RMS error" in report.text() and "rise" not in report.text()


def test_samples_that_are_no_numbers_or_lost_are_counted_and_do_little() -> None:
    args = step(6.0)
    t = times(args)
    u = injected(args, t)
    y = first_order(t, 0.3) - first_order(t - 6.0, 0.3)
    whole = np.random.default_rng(4).random(len(t)) > 0.05
    y[[10, 700]], t[1200] = np.nan, t[1199]  # and one that does not come later
    whole[[10, 700, 1200]] = True
    report = examine(args, t[whole], u[whole], y[whole], u[whole])
    assert report.bad == 3
    assert report.lost == np.count_nonzero(~whole) + 3
    assert isinstance(report.found, StepResponse)
    assert report.found.rise == pytest.approx(math.log(9.0) * 0.3, abs=5e-3)


def test_too_short_too_many_gaps_and_nothing_injected_are_refused() -> None:
    args = step(2.0)
    t = times(args)
    u = injected(args, t)
    cases: list[tuple[str, Any]] = [
        ("20 at least", np.abs(t) < 0.03),
        ("samples were lost", np.random.default_rng(5).random(len(t)) > 0.4),
        ("at a time", ~((t > 0.5) & (t < 0.8))),
        ("nothing was injected", t < 0.0),
    ]
    for words, kept in cases:
        with pytest.raises(BadInput, match=words):
            examine(args, t[kept], u[kept], u[kept], u[kept])
    with pytest.raises(BadInput, match="20 at least"):
        examine(args, t, u, np.full(len(t), np.nan), u)
    with pytest.raises(BadInput, match="20 at least"):
        examine(args, np.empty(0), np.empty(0), np.empty(0), np.empty(0))


def test_one_that_ended_early_is_told() -> None:
    args = step(6.0)
    t = times(args)
    u = np.where(t < 2.0, injected(args, t), 0.0)
    report = examine(args, t, u, np.where(t < 2.0, first_order(t, 0.1), 0.0), u)
    assert any("ended after 2.00 s of 6 s" in note for note in report.notes)


def test_one_that_was_not_at_rest_before_is_told() -> None:
    args = step(6.0)
    t = times(args)
    u = injected(args, t)
    report = examine(args, t, u, first_order(t, 0.2) + 0.5 * np.minimum(t, 0.0), u)
    assert any("not at rest before: it moved by 0.5 m" in note for note in report.notes)


def test_it_reads_as_a_table_and_as_numbers() -> None:
    report = of_step(step(8.0, -1.0), lambda t: second_order(t, 4.0, 0.5))
    assert "step of -1 m in z, 8 s" in report.text()
    assert "overshoot            16.3 %" in report.text()
    assert report.numbers()["overshoot"] == pytest.approx(16.3, abs=0.05)


@pytest.mark.parametrize("kind", ["step", "doublet"])
def test_it_is_drawn(kind: str, tmp_path: Path) -> None:
    args = Inject(kind=kind, channel="x", amplitude=0.5, seconds=12.0)  # type: ignore[arg-type]
    t = times(args)
    u = injected(args, t)
    outputs = {"thrust": 0.5 + 0.0 * t, "torque.x": u, "torque.y": np.full(len(t), np.nan)}
    report = examine(args, t, u, filtered(u, 6.0, 0.5), u, outputs)
    picture(report, tmp_path / "response.png")
    assert (tmp_path / "response.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(BadInput, match="cannot draw"):
        picture(report, tmp_path / "response.nonsense")
    with pytest.raises(BadInput, match="cannot write"):
        picture(report, tmp_path / "none" / "response.png")


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = of_step(step(4.0), lambda t: first_order(t, 0.1))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(BadConfig, match=r"a picture needs matplotlib.*zmav\[planner\]"):
        picture(report, tmp_path / "response.png")
