"""The demo ``follow``: the ways that its rover drives, and the roof over them."""

from __future__ import annotations

import itertools
import math
import sys

from click.testing import CliRunner

from agents.demo.story import find
from agents.follower.agent import Follower
from deploy.demos.drive import eight, walk
from zmav.cli.agent import command
from zmav.sim.fleetfile import load_simulated

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_the_rover_is_hidden_for_longer_than_a_prediction_is_flown() -> None:
    path = find("follow").path
    (rover,) = (spec for spec in load_simulated(path).vehicles if spec.name == "rover1")
    assert rover.start_ned_m is not None
    north, east, _ = rover.start_ned_m
    (roof,) = tomllib.loads((path.parent / "scenes" / "field.toml").read_text())["roofs"]
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


def test_its_driver_is_an_agent_with_settings() -> None:
    told = CliRunner().invoke(command, ["about", str(find("follow").path.parent / "drive.py")])
    assert told.exit_code == 0, told.output
    assert ["way", '"eight"'] in [line.split() for line in told.output.splitlines()]


def test_a_walk_stays_near_and_is_as_fast_as_it_may() -> None:
    way = walk(1.5, seed=3, seconds=300.0)
    places = [way(0.1 * tick) for tick in range(2990)]
    speeds = [math.dist(a, b) / 0.1 for a, b in itertools.pairwise(places)]
    assert max(math.hypot(*place) for place in places) < 25.0
    assert 1.0 < max(speeds) <= 1.5 + 1e-6
