"""What ``zmav demo follow`` shows: the ways that its rover drives, the bridge over them, the picture of the tracks."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path

import pytest

from agents.demo.follow import AWAY, Truth, scene
from agents.demo.rover import eight, walk
from agents.demo.tracks import draw
from agents.follower.agent import Follower
from zmav.errors import BadInput
from zmav.sim import World
from zmav.sim.lineup import ROVERS_SOUTH

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_the_rover_is_hidden_for_longer_than_a_prediction_is_flown() -> None:
    world = World(copters=1, rovers=1, spacing_m=AWAY / ROVERS_SOUTH)
    try:
        north, east, _ = world.vehicles[1].status().ned_m
    finally:
        world.close()
    (roof,) = tomllib.loads(scene(True))["roofs"]
    way, hidden, longest = eight(1.0), 0.0, 0.0
    for tick in range(1200):
        a, b = way(0.1 * tick)
        under = all(
            abs(at - middle) < size / 2.0
            for at, middle, size in zip((north + a, east + b), roof["center"], roof["size"], strict=True)
        )
        hidden = hidden + 0.1 if under else 0.0
        longest = max(longest, hidden)
    assert longest > Follower.tunables["coast"].default


def test_a_walk_stays_near_and_is_as_fast_as_it_may() -> None:
    way = walk(1.5, seed=3, seconds=300.0)
    places = [way(0.1 * tick) for tick in range(2990)]
    speeds = [math.dist(a, b) / 0.1 for a, b in itertools.pairwise(places)]
    assert max(math.hypot(*place) for place in places) < 25.0
    assert 1.0 < max(speeds) <= 1.5 + 1e-6


def test_tracks_are_drawn_or_it_is_said_why_not(tmp_path: Path) -> None:
    truth = Truth([(0.1 * k, 0.1 * k, 0.0, 5.0 if k < 40 else 0.0, 0.1 * k, 0.5, "track") for k in range(50)])
    truth.rows.append((5.0, 4.9, 0.0, 0.0, 4.9, 0.3, "land"))
    draw(truth, tmp_path / "tracks.png", "a test")
    assert (tmp_path / "tracks.png").read_bytes().startswith(b"\x89PNG")
    assert truth.touched() == pytest.approx(0.3)
    with pytest.raises(BadInput, match=r"cannot draw .*\.xyz"):
        draw(truth, tmp_path / "tracks.xyz", "a test")
    with pytest.raises(BadInput, match="cannot write"):
        draw(truth, tmp_path / "no" / "tracks.png", "a test")
