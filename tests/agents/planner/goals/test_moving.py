"""Formations on their way: in shape where there is room, always within the limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.goals import formation
from agents.planner.goals.moving import FormationMembers, move
from agents.planner.goals.timing import Limits
from agents.planner.model.geometry import world_of
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.scene import Scene, Vehicle
from agents.planner.model.verify import verify
from tests.agents.planner.goals.team import DOWNWASH, GATE, ground, point, shape_error
from zmav import wire
from zmav.wire.swarm import Shape

RIGID = 0.02
"""m that a shape may be off outside of narrow places"""


def team(shape: Shape, count: int, speed: float = 5.0) -> FormationMembers:
    goal = wire.swarm.Formation(vehicles=[f"v{i}" for i in range(count)], shape=shape, at=(0.0, 0.0, 0.0))
    one = np.ones(count)
    limits = Limits(speed * one, 2.5 * one, 2.0 * one, 1.5 * one)
    return FormationMembers(formation.offsets_of(goal, count), one, limits)


def judged(moved: list[Motion] | None, who: FormationMembers, world: Scene) -> Floats:
    """(T,) the error of the shape, of a flight that the verifier has nothing against."""
    assert moved is not None
    vehicles = []
    for i, motion in enumerate(moved):
        start, goal = point(motion[0, 1:]), point(motion[-1, 1:])
        vehicles.append(
            Vehicle(
                id=f"v{i}",
                type="copter",
                start=start,
                goal=goal,
                radius=1.0,
                vmax=float(who.limits.speed[i]),
                amax=2.5,
                vz_up=2.0,
                vz_down=1.5,
            )
        )
    scene = Scene(vehicles=vehicles, obstacles=world.obstacles, bounds=world.bounds, downwash=DOWNWASH)
    report = verify(scene, {f"v{i}": motion for i, motion in enumerate(moved)})
    assert report.ok, report.faults[:3]
    return shape_error(who.offsets, np.stack(moved, axis=1)[:, :, 1:])


@pytest.mark.parametrize(("shape", "count"), [("vee", 9), ("line", 5), ("circle", 12), ("grid", 16)])
def test_a_shape_goes_where_there_is_room_and_nowhere_else(shape: Shape, count: int) -> None:
    who, world = team(shape, count), ground(GATE)
    past = np.array([[-90.0, -90.0, 20.0], [-90.0, 90.0, 20.0]])
    moved = move(past, (0.0, 1.0), who, world_of(world))
    assert judged(moved, who, world).max() < RIGID
    through = np.array([[-90.0, 0.0, 20.0], [0.0, 0.0, 10.0], [90.0, 0.0, 20.0]])
    assert move(through, (0.0, 0.0), who, world_of(world)) is None


def test_a_shape_turns_with_its_way_and_ends_as_it_is_told() -> None:
    who, world = team("vee", 9), ground()
    path = np.array([[-40.0, -20.0, 10.0], [-40.0, 40.0, 10.0], [20.0, 40.0, 15.0], [20.0, -20.0, 15.0]])
    moved = move(path, (math.pi / 2.0, 0.0), who, world_of(world))
    assert judged(moved, who, world).max() < RIGID
    assert moved is not None
    last = np.array([motion[-1, 1:] for motion in moved])
    assert last == pytest.approx(formation.placed(who.offsets, path[-1], 0.0), abs=1e-5)
    outer = np.linalg.norm(np.diff(moved[8][:, 1:], axis=0), axis=1).sum()
    middle = np.linalg.norm(np.diff(moved[0][:, 1:], axis=0), axis=1).sum()
    assert outer > 1.1 * middle, "the wing goes the longer way around"


def test_a_shape_turns_where_it_stands() -> None:
    who, world = team("line", 7), ground()
    there = np.array([[0.0, 0.0, 20.0]])
    moved = move(there, (0.0, 2.5), who, world_of(world))
    assert judged(moved, who, world).max() < RIGID
    assert moved is not None
    assert moved[0][-1, 0] > 15.0 * 2.5 / 5.0, "the outermost goes 2.5 rad around at 15 m"


def test_it_is_as_fast_as_its_slowest() -> None:
    who, world = team("column", 4), ground()
    who.limits.speed[2] = 2.0
    moved = move(np.array([[0.0, 0.0, 10.0], [60.0, 0.0, 10.0]]), (0.0, 0.0), who, world_of(world))
    assert judged(moved, who, world).max() < RIGID
    assert moved is not None and 30.0 < moved[0][-1, 0] < 33.0


def test_no_way_through_is_none() -> None:
    world = world_of(ground(GATE))
    through_the_wall = np.array([[-60.0, 30.0, 10.0], [60.0, 30.0, 10.0]])
    assert move(through_the_wall, (0.0, 0.0), team("vee", 5), world) is None
