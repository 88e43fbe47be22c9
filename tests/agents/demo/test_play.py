"""What a demo waits for: each condition, by what was last heard of a vehicle."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import zmav
from agents.demo.play import Play, holds
from agents.demo.story import Wait, find
from zmav import wire
from zmav.errors import ZmavError

SAID: dict[str, Any] = {"mode": "RTL", "armed": True, "local": (1.0, 2.0, -12.0), "pilot": None}


def heard(age: float | None = 0.2, **other: Any) -> zmav.Vehicle:
    """A vehicle of which this was heard so long ago."""
    state = wire.VehicleState(t=0.0, fleet="demo", name="quad1", instance="i", **{**SAID, **other})
    return cast(zmav.Vehicle, SimpleNamespace(last_state=None if age is None else state, age=age))


@pytest.mark.parametrize(
    ("wait", "vehicle", "agent", "so"),
    [
        (Wait(mode=["rtl", "LAND"]), heard(), None, True),
        (Wait(mode=["LAND"]), heard(), None, False),
        (Wait(armed=True), heard(), None, True),
        (Wait(armed=False), heard(), None, False),
        (Wait(armed=False), heard(armed=None), None, False),
        (Wait(pilot=True), heard(pilot="the pilot's switch"), None, True),
        (Wait(pilot=True), heard(), None, False),
        (Wait(pilot=False), heard(), None, True),
        (Wait(stale=True), heard(age=30.0), None, True),
        (Wait(stale=True), heard(age=None), None, True),
        (Wait(stale=True), heard(), None, False),
        (Wait(stale=False), heard(), None, True),
        (Wait(stale=False, mode=["LAND"]), heard(), None, False),
        (Wait(armed=True), heard(age=30.0), None, False),
        (Wait(agent="follower", state="track"), heard(), "track", True),
        (Wait(agent="follower", state="track"), heard(), "search", False),
        (Wait(agent="follower", state="*"), heard(), None, False),
    ],
    ids=str,
)
def test_it_is_so_only_if_all_of_it_is(wait: Wait, vehicle: zmav.Vehicle, agent: str | None, so: bool) -> None:
    assert holds(vehicle, wait, agent) is so


def test_what_nobody_saw_is_not_taken_for_kept_apart(tmp_path: Path) -> None:
    nobody: Any = None
    play = Play(find("line"), nobody, nobody, tmp_path, nobody)
    with play.truth.watching(tmp_path / "no simulator"):
        pass
    with pytest.raises(ZmavError, match="did not tell until the end"):
        play.judge()
