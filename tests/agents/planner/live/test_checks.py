"""What the network brings: each fault is named, and nothing bad gets in."""

from __future__ import annotations

import math
import random
from typing import Any

import msgspec
import pytest

from agents.planner.live.checks import MOST_VEHICLES, OBSTACLE_BYTES, check_goal, check_obstacle, read_obstacle
from zmav import wire
from zmav.errors import BadInput
from zmav.wire import swarm

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
BAD_GOALS: list[tuple[swarm.Goal, str]] = [
    (swarm.Hold(vehicles=[]), "goal.vehicles"),
    (swarm.Hold(vehicles=["Quad 1"]), "goal.vehicles"),
    (swarm.Hold(vehicles=["a"] * (MOST_VEHICLES + 1)), "goal.vehicles"),
    (swarm.GoTo(vehicles=["a"], to=[]), "goal.to"),
    (swarm.GoTo(vehicles=["a", "b"], to=[(0.0, 0.0, -10.0)]), "goal.to"),
    (swarm.GoTo(vehicles=["a"], to=[(0.0, 0.0, -10.0)] * 2, labelled=False), "goal.to"),
    (swarm.GoTo(vehicles=["a"], to=[(0.0, math.nan, 0.0)]), "goal.to[0][1]"),
    (swarm.GoTo(vehicles=["a"], to=[(0.0, 1e9, 0.0)]), "goal.to[0][1]"),
    (swarm.Formation(vehicles=["a"], shape="line", at=(0.0, 0.0, math.inf)), "goal.at[2]"),
    (swarm.Formation(vehicles=["a"], shape="line", at=(0.0, 0.0, 0.0), spacing=0.0), "goal.spacing"),
    (swarm.Formation(vehicles=["a"], shape="line", at=(0.0, 0.0, 0.0), spacing=math.nan), "goal.spacing"),
    (
        swarm.Formation(vehicles=["a"], shape="line", at=(0.0, 0.0, 0.0), via=[(0.0, 0.0, 0.0), (math.nan, 0.0, 0.0)]),
        "goal.via[1][0]",
    ),
    (swarm.Follow(vehicles=["a"], leader="b", offsets=[(math.nan, 0.0, 0.0)]), "goal.offsets[0][0]"),
    (swarm.Land(vehicles=["a", "b"], at=[(0.0, math.inf)] * 2), "goal.at[0][1]"),
    (swarm.TakeOff(vehicles=["a"], height=-3.0), "goal.height"),
    (swarm.TakeOff(vehicles=["a"], height=math.nan), "goal.height"),
    (swarm.Search(vehicles=["a"], polygon=SQUARE[:2], height=10.0), "goal.polygon"),
]


@pytest.mark.parametrize(("goal", "field"), BAD_GOALS, ids=[f"{type(g).__name__} {f}" for g, f in BAD_GOALS])
def test_bad_goals_are_named(goal: swarm.Goal, field: str) -> None:
    with pytest.raises(BadInput) as caught:
        check_goal(goal)
    assert caught.value.detail["field"] == field


def test_good_goals_pass() -> None:
    check_goal(swarm.GoTo(vehicles=["a", "b"], to=[(0.0, 0.0, -10.0)] * 2))
    check_goal(swarm.Search(vehicles=["a"], polygon=SQUARE, height=20.0))


BAD_SHAPES: list[tuple[Any, str]] = [
    (swarm.Box(low=(0.0, 0.0, 0.0), high=(0.0, 1.0, 1.0)), "obstacle.what"),
    (swarm.Ball(center=(0.0, 0.0, 0.0), radius=0.0), "obstacle.what.radius"),
    (swarm.Ball(center=(0.0, 0.0, 0.0), radius=1.0, velocity=(math.nan, 0.0, 0.0)), "obstacle.what.velocity[0]"),
    (swarm.Cylinder(center=(0.0, 0.0), radius=1.0, floor=5.0, ceiling=5.0), "obstacle.what.floor"),
    (swarm.NoFly(polygon=SQUARE[:2], floor=0.0, ceiling=5.0), "obstacle.what.polygon"),
    (swarm.NoFly(polygon=[SQUARE[i] for i in (0, 2, 1, 3)], floor=0.0, ceiling=5.0), "obstacle.what.polygon"),
    (swarm.NoFly(polygon=[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], floor=0.0, ceiling=5.0), "obstacle.what.polygon"),
    (swarm.Geofence(polygon=SQUARE * 200, floor=0.0, ceiling=5.0), "obstacle.what.polygon"),
]


@pytest.mark.parametrize(("what", "field"), BAD_SHAPES, ids=[f"{type(w).__name__} {f}" for w, f in BAD_SHAPES])
def test_bad_obstacles_are_named(what: Any, field: str) -> None:
    with pytest.raises(BadInput) as caught:
        check_obstacle(swarm.Obstacle(name="x", t=1.0, what=what))
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize(("name", "t", "ttl"), [("a b", 1.0, None), ("a", math.nan, None), ("a", 1.0, -1.0)])
def test_bad_headings_of_obstacles_are_refused(name: str, t: float, ttl: float | None) -> None:
    with pytest.raises(BadInput):
        check_obstacle(swarm.Obstacle(name=name, t=t, what=None, ttl=ttl))


def test_too_much_is_not_read() -> None:
    told = swarm.Obstacle(name="x", t=1.0, what=swarm.NoFly(polygon=SQUARE * 5000, floor=0.0, ceiling=1.0))
    data = wire.encode(told)
    assert len(data) > OBSTACLE_BYTES
    with pytest.raises(BadInput, match="is not read"):
        read_obstacle(data)


def test_noise_is_never_more_than_bad_input() -> None:
    chance = random.Random(8)
    good = wire.encode(swarm.Obstacle(name="x", t=1.0, what=swarm.Box(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0))))
    for _ in range(2000):
        data = bytearray(good)
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        try:
            check_obstacle(read_obstacle(bytes(data)))
        except BadInput:
            continue
        assert msgspec.json.decode(bytes(data))["name"].isascii()
