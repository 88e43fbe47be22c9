"""How much wider than they are vehicles are planned: by how they hold their ways, and how well clocks are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agents.planner.execute.following import USUAL, Following
from agents.planner.execute.offset import Offset
from agents.planner.live.margins import MOST_MARGIN, WIDEST, PlanMargins
from agents.planner.live.settings import PlannerSettings
from zmav.errors import Refused

NOW = 1000.0


def margins(clocks: dict[str, float], known: dict[str, str | None], **settings: Any) -> PlanMargins:
    """``clocks``: s to which those that are flown are known, by vehicle; ``known``: what is usual, by vehicle."""
    offsets = {name: Offset() for name in clocks}
    for name, error in clocks.items():
        if error < 1.0:
            offsets[name].answered(NOW - 2.0 * error, NOW, NOW)
    fleet = SimpleNamespace(
        seen=lambda name: SimpleNamespace(view=SimpleNamespace(body=SimpleNamespace(speed=5.0))),
        followings_of=lambda names: {name: Following(known[name]) for name in names},
    )
    context = SimpleNamespace(
        settings=PlannerSettings(name="margins", **settings),
        fleet=fleet,
        clocks=SimpleNamespace(clock=SimpleNamespace(now=lambda: NOW)),
    )
    return PlanMargins(context, list(known), offsets)  # type: ignore[arg-type]


def test_it_is_wider_for_who_holds_its_way_badly_and_for_clocks_that_are_known_badly() -> None:
    usual = margins({"a": 0.005}, {"a": None})
    late = margins({"a": 0.005}, {"a": "px4"})
    unsure = margins({"a": 0.05}, {"a": None})
    assert late.tracking == pytest.approx(3.0 * USUAL["px4"][1])
    assert late.best_first()[1][0] > usual.best_first()[1][0] + 0.3
    assert unsure.needed(0.4) == pytest.approx(usual.needed(0.4) + 5.1 * 0.045, abs=0.002)
    assert unsure.needed(0.4, 1.0 / 3.0) < unsure.needed(0.4)
    widths = [width for width, _ in late.best_first()]
    assert widths == sorted(widths, reverse=True)
    assert widths[0] <= MOST_MARGIN


def test_the_clocks_are_those_of_all_that_fly_and_the_ways_those_of_the_goal() -> None:
    """One that was taken by a pilot flies on by our clock of it, and may hold its way as it likes."""
    assert margins({"a": 0.005, "b": 0.05}, {"a": None}).needed(0.4) == margins({"b": 0.05}, {}).needed(0.4)
    assert margins({"a": 0.005, "b": 0.005}, {"a": None}).tracking < margins({"a": 0.005}, {"a": "px4"}).tracking


def test_what_no_margin_is_enough_for_is_refused() -> None:
    unknown = margins({"a": 0.005, "b": 9.0}, {"a": None})
    with pytest.raises(Refused, match=r"the clock of b is known to ±inf ms only"):
        unknown.best_first()
    unsure = margins({"a": 0.12}, {"a": None}, tracking=1.0, margin=1.4)
    with pytest.raises(Refused, match=r"a margin of 1\.\d\d m would be needed"):
        unsure.best_first()
    wide = margins({"a": 0.005}, {"a": None}, tracking=2.0, margin=2.2)
    with pytest.raises(Refused, match=r"a margin of 2\.10 m would be needed"):
        wide.best_first()
    assert [each.too_wide for each in (unknown, unsure, wide)] == [False, False, True]
    assert margins({"a": 0.19}, {"a": "px4"}).tracking < WIDEST
