"""Planes: Dubins ways against OMPL's, flown within every limit, apart from each other and from what stands or moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.model import verify
from agents.planner.model.deadline import Deadline
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import PLANE, Floats, Motion, MovingObstacle, problem_of
from agents.planner.model.scene import Bounds, Box, Fence, Obstacle, Point, Scene, Vehicle
from agents.planner.model.separation import separation
from agents.planner.model.world import world_of
from agents.planner.solve.paths import flight
from agents.planner.solve.paths.flight import Wings, fly
from agents.planner.solve.planes import plan_planes
from tests.agents.planner import generate

WINGS = Wings(radius=3.0, vmin=12.0, vmax=22.0, amax=5.0, climb=3.0, descend=3.0)


def plane(name: str, start: Point, goal: Point, heading: float = 0.0) -> Vehicle:
    return Vehicle(
        id=name,
        type="plane",
        start=start,
        goal=goal,
        radius=3.0,
        vmax=22.0,
        amax=5.0,
        vmin=12.0,
        vz_up=3.0,
        vz_down=3.0,
        start_heading_deg=heading,
    )


def arena(*vehicles: Vehicle, obstacles: tuple[Obstacle, ...] = (), fence: Fence | None = None) -> Scene:
    bounds = Bounds(min=(-200.0, -200.0, 0.0), max=(200.0, 200.0, 120.0))
    return Scene(vehicles=list(vehicles), obstacles=list(obstacles), bounds=bounds, geofence=fence, downwash=1.5)


@pytest.mark.parametrize("height", [50.0, 60.0])
def test_a_plane_that_is_at_its_goal_flies_a_circle(height: float) -> None:
    """The way of a word without a circle had no legs there, and its plan ended with a ValueError."""
    (motion,) = planned(arena(plane("p", (0.0, 0.0, 50.0), (0.0, 0.0, height)))).values()
    assert np.linalg.norm(motion[:, 1:3], axis=1).max() > 12.0
    assert np.linalg.norm(motion[-1, 1:] - [0.0, 0.0, height]) < 0.5


def planned(scene: Scene, movers: tuple[MovingObstacle, ...] = ()) -> dict[str, Motion]:
    """The planes' motions; the verifier finds no fault in them."""
    problem = problem_of(scene, movers=movers)
    planes = np.flatnonzero(problem.kind == PLANE).tolist()
    motions = plan_planes(problem, world_of(scene), planes, np.random.default_rng(0))
    tracks = {problem.ids[i]: motion for i, motion in zip(planes, motions, strict=True)}
    alone = Scene(
        vehicles=[v for v in scene.vehicles if v.type == "plane"],
        obstacles=scene.obstacles,
        bounds=scene.bounds,
        geofence=scene.geofence,
        downwash=scene.downwash,
    )
    report = verify.verify(alone, tracks, movers)
    assert report.ok, report.faults
    return tracks


def test_where_a_mover_was_before_does_not_count() -> None:
    here = (-150.0, 0.0, 50.0)
    gone = MovingObstacle("gone", np.array([[-60.0, *here], [-1.0, 0.0, 150.0, 50.0], [9.0, 0.0, 150.0, 50.0]]), 3.0)
    planned(arena(plane("p", here, (150.0, 0.0, 50.0))), (gone,))


def ends(pose: tuple[float, float, float], legs: Floats) -> tuple[float, float, float]:
    for curvature, length in legs:
        pose = flight.advance(*pose, curvature, length)
    return pose


def test_ways_to_a_place_lead_there_and_are_as_short_as_ompls_of_all_headings() -> None:
    base = pytest.importorskip("ompl").base
    rng = np.random.default_rng(2)
    space = base.DubinsStateSpace(1.0)
    one, other = space.allocState(), space.allocState()
    legs = np.empty((2, 2))
    for _ in range(40):
        x, y, h0 = rng.uniform((-4.0, -4.0, -3.1), (4.0, 4.0, 3.1)).tolist()
        best = math.inf
        for word in range(flight.WORDS):
            length = flight.to_point(0.0, 0.0, h0, x, y, 1.0, word, legs)
            if math.isfinite(length):
                best = min(best, length)
                assert ends((0.0, 0.0, h0), legs)[:2] == pytest.approx((x, y), abs=1e-6)
        least = math.inf
        for heading in np.linspace(0.0, math.tau, 361).tolist():
            for state, (px, py, yaw) in ((one, (0.0, 0.0, h0)), (other, (x, y, heading))):
                state.setX(px)
                state.setY(py)
                state.setYaw(math.remainder(yaw, math.tau))
            least = min(least, space.distance(one, other))
        assert -1e-9 < least - best < 0.05


def test_a_way_is_flown_as_fast_as_turns_and_climbs_allow() -> None:
    turn = WINGS.turn(14.0)
    legs = np.array([[0.0, 150.0, 0.0], [1.0 / turn, 60.0, 10.0], [0.0, 150.0, -10.0]])
    motion = fly(np.array([0.0, 0.0, 50.0, 0.0]), legs, WINGS, WINGS.vmax)
    vel = np.diff(motion[:, 1:], axis=0) / np.diff(motion[:, 0])[:, None]
    speed = np.linalg.norm(vel, axis=1)
    acc = np.diff(vel, axis=0) / np.diff((motion[1:, 0] + motion[:-1, 0]) / 2.0)[:, None]
    assert speed.min() > 13.9 and speed.max() < 14.1
    assert np.linalg.norm(acc, axis=1).max() <= WINGS.amax * 1.02
    assert np.abs(vel[:, 2]).max() <= WINGS.climb
    pose = (0.0, 0.0, 0.0)
    for curvature, length, _ in legs:
        pose = flight.advance(*pose, curvature, length)
    assert motion[-1, 1:] == pytest.approx((*pose[:2], 50.0), abs=1e-6)
    assert np.diff(motion[:, 0]).max() <= 0.2


def test_too_tight_a_turn_is_not_flown() -> None:
    legs = np.array([[1.0 / (0.9 * WINGS.tightest), 60.0, 0.0]])
    assert len(fly(np.zeros(4), legs, WINGS, WINGS.vmax)) == 0


def test_a_plane_flies_on_from_its_heading_and_leaves() -> None:
    motion = planned(arena(plane("p", (-150.0, 0.0, 70.0), (150.0, 20.0, 80.0), heading=90.0)))["p"]
    assert motion[0, 1:] == pytest.approx((-150.0, 0.0, 70.0), abs=1e-6)
    assert motion[-1, 1:] == pytest.approx((150.0, 20.0, 80.0), abs=1e-5)
    north = math.atan2(motion[1, 2] - motion[0, 2], motion[1, 1] - motion[0, 1])
    assert north == pytest.approx(math.pi / 2.0, abs=0.05)


def test_a_steep_climb_is_made_in_circles() -> None:
    motion = planned(arena(plane("p", (-40.0, 0.0, 20.0), (40.0, 0.0, 110.0))))["p"]
    assert motion[-1, 0] > 90.0 / 3.0, "it climbs 3 m/s at most"


def test_planes_head_on_pass_each_other_without_delay() -> None:
    scene = arena(
        plane("east", (-150.0, 0.0, 70.0), (150.0, 0.0, 70.0)),
        plane("west", (150.0, 0.0, 70.0), (-150.0, 0.0, 70.0), heading=180.0),
    )
    assert all(motion[-1, 0] < 1.15 * 300.0 / 22.0 for motion in planned(scene).values())


@pytest.mark.parametrize("count", [8, 20])
def test_many_planes_at_once(count: int) -> None:
    rng = np.random.default_rng(count)
    vehicles = []
    for k in range(count):
        angle = math.tau * k / count
        start = (170.0 * math.cos(angle), 170.0 * math.sin(angle), float(rng.uniform(60.0, 90.0)))
        goal = (-start[0], -start[1], float(rng.uniform(60.0, 90.0)))
        vehicles.append(plane(f"p{k}", start, goal, heading=math.degrees(angle) + 180.0))
    motions = planned(arena(*vehicles))
    assert max(motion[-1, 0] for motion in motions.values()) < 2.0 * 340.0 / 22.0


def test_planes_without_time_are_a_timeout() -> None:
    scene = arena(plane("p", (-150.0, 0.0, 70.0), (150.0, 0.0, 70.0)))
    rng = np.random.default_rng(0)
    with pytest.raises(PlanError, match="allow more time") as failed:
        plan_planes(problem_of(scene), world_of(scene), [0], rng, Deadline.after(-1.0))
    assert (failed.value.kind, failed.value.ids) == ("timeout", ["p"])


def test_over_a_ridge() -> None:
    ridge = (Box(min=(-20.0, -200.0, 0.0), max=(20.0, 200.0, 90.0)),)
    motion = planned(arena(plane("p", (-180.0, -50.0, 80.0), (180.0, 60.0, 70.0)), obstacles=ridge))["p"]
    assert motion[:, 3].max() > 93.0


def test_within_an_l_shaped_fence() -> None:
    corners = [(-190.0, -190.0), (190.0, -190.0), (190.0, -40.0), (-40.0, -40.0), (-40.0, 190.0), (-190.0, 190.0)]
    fence = Fence(polygon=corners, floor=40.0, ceiling=110.0)
    planned(arena(plane("p", (150.0, -110.0, 70.0), (-110.0, 150.0, 80.0), heading=180.0), fence=fence))


def test_planes_keep_off_those_that_stand_and_those_that_move() -> None:
    copter = Vehicle(
        id="c", type="copter", start=(0.0, 0.0, 70.0), goal=(60.0, 0.0, 70.0), radius=1.0, vmax=5.0, amax=2.5
    )
    scene = arena(plane("p", (-150.0, 0.0, 70.0), (150.0, 0.0, 70.0)), copter)
    motion = planned(scene)["p"]
    for place in (copter.start, copter.goal):
        assert place is not None
        stands = np.array([[0.0, *place], [1.0, *place]])
        assert separation(motion, stands, 1.5, a_leaves=True)[0] >= 4.0
    crossing = MovingObstacle("m", np.array([[0.0, 0.0, -60.0, 70.0], [12.0, 0.0, 60.0, 70.0]]), 20.0)
    planned(arena(scene.vehicles[0]), (crossing,))


def test_a_plane_that_cannot_turn_away_is_named() -> None:
    scene = arena(
        plane("free", (-150.0, 100.0, 60.0), (150.0, 100.0, 60.0)),
        plane("doomed", (-20.0, 0.0, 60.0), (150.0, 0.0, 60.0)),
        obstacles=(Box(min=(0.0, -90.0, 0.0), max=(10.0, 90.0, 120.0)),),
    )
    with pytest.raises(PlanError) as raised:
        planned(scene)
    assert (raised.value.kind, raised.value.ids) == ("unreachable", ["doomed"])


def test_a_turn_of_all_that_it_may_is_made_where_no_other_is_left() -> None:
    """12 m/s and 5 m/s² turn within 28.8 m, and there are 29."""
    planned(arena(plane("p", (171.0, 0.0, 70.0), (0.0, 0.0, 70.0), 0.0)))


@pytest.mark.parametrize("seed", [0, 1])
def test_planes_of_a_mixed_fleet(seed: int) -> None:
    planned(generate.mixed(60, seed, planes=10, rovers=10))
