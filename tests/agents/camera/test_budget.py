"""What is sent over links of every kind, in simulated time; and what reports that lie can do."""

from __future__ import annotations

import math
import statistics
from typing import Any

import pytest

from agents.camera.budget import MOST_READERS, Budget
from agents.camera.quality_steps import ROOM, QualityStep, QualitySteps
from agents.camera.settings import CameraSettings
from tests.agents.camera.simlink import FULL_BYTES, SimLink
from zmav.vision.chunks import count_of
from zmav.vision.parity import needed
from zmav.wire import FrameReport

OWN = CameraSettings(vehicle="quad1")


def test_a_clean_link_is_filled() -> None:
    link = SimLink(OWN)
    link.run(60)
    assert link.quality.step == link.quality.steps[0]
    link.run(10)
    assert (link.whole, link.lost) == (1.0, 0)
    assert link.bytes > 10 * 10 * FULL_BYTES  # all pictures, the best way, and parity


@pytest.mark.parametrize(("rate", "most", "lost"), [(10e3, 1.3, 0.2), (25e3, 1.15, 0.12), (100e3, 1.15, 0.12)])
def test_a_narrow_link_is_not_overrun(rate: float, most: float, lost: float) -> None:
    """Of 10 kB/s a picture comes every two seconds: there is little to learn from."""
    link = SimLink(OWN, rate=rate)
    link.run(20)
    link.run(60)
    assert 0.5 * rate < link.bytes / 60 < most * rate
    assert link.lost < lost * link.sent
    assert link.whole >= 0.9


@pytest.mark.parametrize("clock", [0.0, 100.0, -100.0])
def test_a_queue_that_loses_nothing_is_kept_short_whatever_the_readers_clock(clock: float) -> None:
    """200 kB would wait 8 s."""
    link = SimLink(OWN, rate=25e3, queue=200e3, clock=clock)
    link.run(20)
    link.run(60)
    assert 0.6 * 25e3 < link.bytes / 60 < 1.1 * 25e3
    assert statistics.median(link.delays) < 0.8
    assert (link.whole, link.lost) == (1.0, 0)


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_loss_that_is_the_links_own_is_met_by_parity_and_not_by_fewer_pictures(loss: float) -> None:
    link = SimLink(OWN, loss=loss)
    link.run(16)
    link.run(40)
    assert link.whole >= 0.93
    assert link.bytes / 40 > 1.5 * OWN.budget
    assert abs(link.budget.loss - loss) < 0.1


def test_both_at_once() -> None:
    link = SimLink(OWN, loss=0.1, rate=100e3)
    link.run(20)
    link.run(40)
    assert link.whole >= 0.9
    assert link.bytes / 40 < 1.2 * 100e3


def test_a_link_that_becomes_narrow_and_wide_again() -> None:
    link = SimLink(OWN)
    link.run(30)
    link.rate = 30e3
    link.run(15)
    link.run(10)
    assert link.bytes / 10 < 1.3 * 30e3
    link.rate = None
    link.run(60)
    link.run(10)
    assert link.bytes / 10 > 60e3


def report(**values: Any) -> FrameReport:
    return FrameReport(**{"t": 1.0, "seq": 0, "whole": 1, "torn": 0, **values})


def test_the_tightest_reader_counts_until_it_is_silent() -> None:
    budget = Budget(OWN)
    assert budget.bytes == OWN.budget
    budget.report("wide", report(), 0.0)
    budget.report("tight", report(most_bytes=7e3), 0.0)
    assert budget.bytes == 7e3
    budget.report("wide", report(t=4.0), 4.0)
    budget.expire(4.0)
    assert list(budget.links) == ["wide"]
    assert budget.bytes == OWN.budget


def test_who_has_less_than_the_floor_says_so_himself() -> None:
    budget = Budget(OWN)
    budget.report("lora", report(most_bytes=1e3), 0.0)
    assert budget.bytes == 1e3


def test_not_everybody_is_heard() -> None:
    budget = Budget(OWN)
    for i in range(MOST_READERS + 5):
        budget.report(f"reader-{i}", report(), 0.0)
    assert len(budget.links) == MOST_READERS


@pytest.mark.parametrize(
    "lie",
    [
        {"whole": -5, "torn": -7},
        {"whole": 10**9, "torn": 10**9},
        {"rate_bytes": -1.0},
        {"rate_bytes": 1e300},
        {"delay": math.inf},
        {"delay": -1e9},
        {"delay": 1e9},
        {"seq": 2**63},
        {"seq": -1},
        {"most_bytes": -1.0},
        {"most_bytes": 0.0},
    ],
)
def test_reports_that_lie_leave_the_budget_within_its_bounds(lie: dict[str, Any]) -> None:
    budget = Budget(OWN)
    for i in range(40):
        budget.sent.add(i, 6000, 0.1, 0.5 * i)
        budget.report("liar", report(**{"t": 0.5 * i, "seq": i, "rate_bytes": 12e3, **lie}), 0.5 * i)
        assert 500.0 <= budget.bytes <= OWN.most
        assert 0.0 < budget.loss < 0.5


def test_pictures_get_worse_in_the_documented_order() -> None:
    quality = QualitySteps(OWN)
    quality.learn(quality.steps[0], FULL_BYTES)
    seen: list[QualityStep] = []
    for kilobytes in range(700, 4, -1):
        step = quality.choose(kilobytes * 1e3, 0.01)
        assert quality.bytes(step, 0.01) * step.rate <= ROOM * kilobytes * 1e3 * 1.001
        seen.append(step)
    assert seen[0] == quality.steps[0]
    kinds = list(dict.fromkeys((step.half, step.quality) for step in seen))
    assert kinds == [(False, 70), (False, 56), (False, 42), (True, 56), (True, 42)]
    slow = [step for step in seen if step.rate < OWN.rate]
    assert {(step.half, step.quality) for step in slow} == {(False, 42), (True, 42)}
    assert min(step.rate for step in slow if not step.half) >= OWN.rate / 2


def test_a_better_step_needs_room_to_spare() -> None:
    """Else two steps would take turns at a budget that lies between them."""
    quality = QualitySteps(OWN)
    quality.learn(quality.steps[0], FULL_BYTES)
    count = count_of(FULL_BYTES)
    need = FULL_BYTES * OWN.rate * (count + needed(count, 0.01)) / count
    assert quality.choose(1.1 * need, 0.01) == quality.steps[0]
    assert quality.choose(0.9 * need, 0.01) == quality.steps[1]
    assert quality.choose(1.1 * need, 0.01) == quality.steps[1]
    assert quality.choose(1.3 * need, 0.01) == quality.steps[0]
