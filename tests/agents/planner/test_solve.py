"""From a scene to a plan: every class of scene is solved, and an independent checker finds nothing."""

from __future__ import annotations

import math
import time
from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from agents.planner.model.deadline import Deadline
from agents.planner.model.errors import PlanError
from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan
from agents.planner.model.problem import MovingObstacle
from agents.planner.model.scene import Bounds, Box, Obstacle, Scene, Vehicle
from agents.planner.model.separation import separation
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.verify import verify
from agents.planner.solve.pipeline import solve
from tests.agents.planner.checker import check
from tests.agents.planner.generate import CLASSES, as_json


def faults(scene: Scene, plan: Plan) -> Any:
    return check(as_json(scene), msgspec.to_builtins(plan))


@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("swap_circle", 16),
        ("swap_sphere", 12),
        ("shuffle", 36),
        ("crowd", 20),
        ("formation", 40),
        ("forest", 12),
        ("gate", 8),
        ("gate_opposing", 8),
        ("city", 12),
        ("fence", 8),
        ("mixed", 10),
    ],
)
def test_every_class_of_scene_is_solved(name: str, n: int) -> None:
    scene = CLASSES[name](n, 3)
    plan = solve(scene, seed=1)
    assert plan.status == "ok"
    assert list(plan.trajectories) == [v.id for v in scene.vehicles]
    assert not faults(scene, plan)


@pytest.mark.parametrize(("name", "n", "seconds"), [("windows", 16, 12.0), ("swap_circle", 200, 6.0)])
def test_crowds_are_solved_in_seconds(name: str, n: int, seconds: float) -> None:
    """In a queue through windows; round each other, all in one sense, where all cross in one place."""
    scene = CLASSES[name](n, 0)
    used = time.thread_time()
    plan = solve(scene)
    assert time.thread_time() - used < seconds
    assert plan.status == "ok" and list(plan.trajectories) == [v.id for v in scene.vehicles]
    assert not faults(scene, plan)


@pytest.mark.parametrize(("vmin", "vmax", "amax"), [(4.0, 8.0, 8.0), (3.0, 5.0, 10.0)])
def test_a_plane_that_turns_quickly_leaves_on_its_heading(vmin: float, vmax: float, amax: float) -> None:
    bounds = Bounds(min=(-200.0, -200.0, 0.0), max=(200.0, 200.0, 60.0))
    plane = Vehicle(
        id="p",
        type="plane",
        start=(0.0, 0.0, 20.0),
        goal=(-100.0, 30.0, 20.0),
        radius=0.5,
        vmin=vmin,
        vmax=vmax,
        amax=amax,
        start_heading_deg=10.0,
    )
    motion = solve(Scene(vehicles=[plane], bounds=bounds)).motions()["p"]
    east, north = motion[1, 1:3] - motion[0, 1:3]
    assert math.degrees(math.atan2(north, east)) == pytest.approx(10.0, abs=1.1)


def test_the_same_seed_gives_the_same_plan() -> None:
    scene = CLASSES["swap_circle"](10, 0)
    one, two = solve(scene, seed=5), solve(scene, seed=5)
    assert one.trajectories == two.trajectories
    assert solve(scene, seed=6).trajectories != one.trajectories


def test_a_margin_is_kept_in_flight_where_starts_leave_room() -> None:
    scene = CLASSES["swap_circle"](8, 0)
    plan = solve(scene, margin=0.5)
    report = verify(scene, plan.trajectories)
    assert report.ok
    assert report.clearance >= 0.5 - 1e-3
    assert verify(scene, solve(scene).trajectories).clearance < 0.4


def window(beyond: float) -> Scene:
    """Six that change sides of a wall with a narrow window; one may go round it where ``beyond`` is below 20."""
    walls: list[Obstacle] = [
        Box(min=(-1.0, -20.0, 0.0), max=(1.0, -1.2, 20.0)),
        Box(min=(-1.0, 1.2, 0.0), max=(1.0, beyond, 20.0)),
    ]
    vehicles = [
        Vehicle(id=f"v{y}{x}", type="copter", start=(x, y, 5.0), goal=(-x, y, 5.0), radius=1.0, vmax=5.0, amax=2.5)
        for y in (-4.0, 0.0, 4.0)
        for x in (-10.0, 10.0)
    ]
    bounds = Bounds(min=(-30.0, -20.0, 0.0), max=(30.0, 20.0, 20.0))
    return Scene(vehicles=vehicles, obstacles=walls, bounds=bounds)


def test_ways_are_found_with_the_margin_that_they_are_held_to() -> None:
    """Through a window, or round the wall where the margin does not fit through the window."""
    scene, begun = window(14.0), time.thread_time()
    wide = verify(scene, solve(scene, margin=0.5).motions())
    assert time.thread_time() - begun < 5.0
    assert wide.ok and wide.clearance >= 0.5 - 1e-3 and wide.obstacle_clearance >= 0.25 - 1e-3
    assert verify(scene, solve(scene).motions()).makespan < 0.8 * wide.makespan


@pytest.mark.usefixtures("hasty")
def test_a_margin_that_fits_through_no_window_is_said() -> None:
    scene = window(20.0)
    del scene.vehicles[2:]
    with pytest.raises(PlanError, match=r"with 0.25 m more than its radius; allow less margin") as caught:
        solve(scene, margin=0.5)
    assert caught.value.kind == "unreachable"


def test_a_budget_is_of_the_processor_and_has_an_end_by_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine that is busy otherwise a plan gets as much of the processor as on an idle one."""
    clock, scene = time.monotonic, CLASSES["tunnel"](8, 0)
    begun = clock()
    monkeypatch.setattr(time, "monotonic", lambda: begun + 3.0 * (clock() - begun))  # it gets a third of the processor
    used = time.thread_time()
    assert solve(scene, seconds=(idle := 30.0)).status == "ok"
    used = time.thread_time() - used
    assert used < idle
    monkeypatch.setattr(time, "monotonic", lambda: begun + 1000.0 * (clock() - begun))  # it gets hardly any
    used = time.thread_time()
    with pytest.raises(PlanError, match=r"of the processor \(.* s by the clock\)") as caught:
        solve(CLASSES["tunnel"](16, 0), seconds=60.0)
    assert caught.value.kind == "timeout" and time.thread_time() - used < 30.0


def test_movers_are_kept_clear_of() -> None:
    scene = CLASSES["swap_circle"](6, 0)
    height = scene.vehicles[0].start[2]
    rock = MovingObstacle("rock", np.array([[0.0, 3.0, 0.0, height]]), 2.0)
    plan = solve(scene, movers=[rock], seed=2)
    assert verify(scene, plan.trajectories, [rock]).ok
    for samples in plan.trajectories.values():
        assert separation(np.array(samples), rock.motion, scene.downwash)[0] >= 2.0 + scene.vehicles[0].radius - 0.01


@pytest.mark.parametrize(("first", "last", "kind"), [(0.0, 50.0, "starts_overlap"), (50.0, 0.0, "goals_overlap")])
def test_a_mover_on_a_start_or_a_goal_is_named(first: float, last: float, kind: str) -> None:
    scene = CLASSES["swap_circle"](6, 0)
    x, y, z = scene.vehicles[1].start if kind == "starts_overlap" else scene.vehicles[1].goal or (0.0, 0.0, 0.0)
    block = MovingObstacle("block", np.array([[0.0, x, y, z + first], [9.0, x, y, z + last]]), 0.5)
    with pytest.raises(PlanError) as caught:
        solve(scene, movers=[block])
    assert (caught.value.kind, caught.value.ids) == (kind, [scene.vehicles[1].id])


def test_where_a_mover_was_before_does_not_count() -> None:
    """Who is on its way home has begun before the plan: its first place was taken for where it is."""
    scene = CLASSES["swap_circle"](4, 0)
    (x, y, z), up = scene.vehicles[1].start, scene.bounds.max[2] + 50.0
    gone = MovingObstacle("gone", np.array([[-60.0, x, y, z], [-1.0, x, y, up], [9.0, x, y, up]]), 0.5)
    plan = solve(scene, movers=[gone])
    assert verify(scene, plan.trajectories, [gone]).ok


def test_a_wait_for_the_compiler_does_not_count_by_the_clock() -> None:
    assert Deadline(1.0, 4.0).later(30.0) == Deadline(1.0, 34.0)


def test_a_map_from_before_is_used_again() -> None:
    scene = CLASSES["city"](8, 1)
    static = StaticMap(world_of(scene))
    first = solve(scene, static=static)
    assert solve(scene, static=static).trajectories == first.trajectories


@pytest.mark.usefixtures("hasty")
def test_a_goal_behind_walls_is_named() -> None:
    scene = CLASSES["swap_circle"](16, 0)
    inside = scene.vehicles[2].start[2]
    scene.vehicles[2].goal = (0.0, 0.0, inside)
    for axis in range(3):
        for side in (-1.0, 1.0):
            low, high = np.array([-3.0, -3.0, inside - 3.0]), np.array([3.0, 3.0, inside + 3.0])
            (low if side > 0 else high)[axis] = (0.0, 0.0, inside)[axis] + 2.0 * side
            scene.obstacles = [*scene.obstacles, Box(min=tuple(low.tolist()), max=tuple(high.tolist()))]
    with pytest.raises(PlanError) as caught:
        solve(scene)
    assert (caught.value.kind, caught.value.ids) == ("unreachable", [scene.vehicles[2].id])


@pytest.mark.usefixtures("hasty")
def test_a_goal_behind_walls_goes_to_who_is_there() -> None:
    walls: list[Obstacle] = [
        Box(min=(-6.0, -6.0, 0.0), max=(6.0, -5.0, 6.0)),
        Box(min=(-6.0, 5.0, 0.0), max=(6.0, 6.0, 6.0)),
        Box(min=(-6.0, -5.0, 0.0), max=(-5.0, 5.0, 6.0)),
        Box(min=(5.0, -5.0, 0.0), max=(6.0, 5.0, 6.0)),
    ]
    starts = [(-3.0, 0.0, 3.0), (8.0, 0.0, 3.0), (8.0, 6.0, 3.0)]
    vehicles = [
        Vehicle(id=f"v{i}", type="copter", start=at, radius=1.0, vmax=5.0, amax=2.5) for i, at in enumerate(starts)
    ]
    goals = [(-8.0, 0.0, 3.0), (9.0, 9.0, 3.0), (3.0, 0.0, 3.0)]
    bounds = Bounds(min=(-11.0, -11.0, 0.0), max=(11.0, 11.0, 6.0))  # small: all of it is looked at
    scene = Scene(vehicles=vehicles, assignment="unlabelled", goals=goals, obstacles=walls, bounds=bounds)
    plan = solve(scene)
    assert not faults(scene, plan)
    assert plan.trajectories["v0"][-1][1:] == (3.0, 0.0, 3.0)
    scene.goals = [goals[0], (1.0, 3.0, 3.0), goals[2]]
    with pytest.raises(PlanError) as caught:
        solve(scene)
    assert caught.value.kind == "unreachable"


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_a_plan_that_no_memory_holds_is_refused(kind: Literal["copter", "plane"]) -> None:
    """Its samples were counted by the way and the speed alone: of this one, 80 GB and more."""
    wings = {"vmin": 0.01, "start_heading_deg": 0.0} if kind == "plane" else {}
    snail = Vehicle(
        id="v1", type=kind, start=(-5e6, 0.0, 9.0), goal=(5e6, 0.0, 9.0), radius=1.0, vmax=0.02, amax=2.5, **wings
    )
    scene = Scene(vehicles=[snail], bounds=Bounds(min=(-6e6, -50.0, 0.0), max=(6e6, 50.0, 20.0)))
    with pytest.raises(PlanError, match="samples") as caught:
        solve(scene)
    assert (caught.value.kind, caught.value.ids) == ("invalid_scene", ["v1"])


def test_a_spent_budget_is_said_with_the_vehicles() -> None:
    scene = CLASSES["tunnel"](16, 0)
    begun = time.monotonic()
    with pytest.raises(PlanError) as caught:
        solve(scene, seconds=0.0)
    assert caught.value.kind == "timeout"
    assert set(caught.value.ids) <= {v.id for v in scene.vehicles}
    assert caught.value.ids
    assert time.monotonic() - begun < 60.0
